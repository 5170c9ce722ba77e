"""The claims as JUnit XML, for machines that gate on tests: one suite a stratum, one case a claim.

Only a claim that is *shown* passes.  Refuted is a failure; everything else is an error or, where the plan set
no target, skipped: nothing that is open is ever green.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

from safety_harness.certification.evidence import ClaimEvidence, ClaimResult, ClaimStatus, Evidence

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(evidence: Evidence) -> str:
    """The whole document."""
    name = evidence.plan.name + (f"; {evidence.fallback}" if evidence.fallback else "")
    root = ElementTree.Element("testsuites", name=_text(name))
    for stratum in evidence.strata:
        suite = ElementTree.SubElement(root, "testsuite", name=_text(stratum.name))
        pairs = [
            (claim, outcome)
            for claim in evidence.claims
            for outcome in claim.outcomes
            if outcome.stratum == stratum.name
        ]
        for claim, outcome in pairs:
            _case(suite, claim, outcome)
        tags = [child.tag for case in suite for child in case]
        for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            suite.set(name, str(tags.count(tag)))
        suite.set("tests", str(len(pairs)))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _case(suite: ElementTree.Element, claim: ClaimEvidence, outcome: ClaimResult) -> None:
    case = ElementTree.SubElement(
        suite, "testcase", classname=_text(outcome.stratum), name=_text(claim.sentence)
    )
    if outcome.standing is ClaimStatus.SHOWN:
        return
    tag = {ClaimStatus.REFUTED: "failure", ClaimStatus.ESTIMATED: "skipped"}.get(outcome.standing, "error")
    said = ElementTree.SubElement(case, tag, message=_text(f"{outcome.standing.value}: {outcome.why}"))
    if tag != "skipped":
        said.set("type", outcome.standing.value)


def _text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
