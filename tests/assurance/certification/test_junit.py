from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

from made_up_evidence import STRATA, evidence

from safety_harness.extensions.assurance.certification.evidence import ClaimStatus
from safety_harness.extensions.assurance.certification.folder import junit_xml


def said(case: ElementTree.Element) -> list[str]:
    """All but what its verdict rests on."""
    return [child.tag for child in case if child.tag != "system-out"]


def test_only_what_is_shown_passes() -> None:
    one = evidence()
    root = ElementTree.fromstring(junit_xml(one).split("\n", 1)[1])
    assert [suite.get("name") for suite in root] == list(STRATA)
    standings = {claim.sentence: claim.standing for claim in one.claims}
    for suite in root:
        assert int(suite.get("tests", "")) == len(one.claims)
        for case in suite:
            passed = not said(case)
            assert passed == (standings[case.get("name", "")] is ClaimStatus.SHOWN)


def test_refuted_is_a_failure_and_what_is_open_an_error() -> None:
    root = ElementTree.fromstring(junit_xml(evidence()).split("\n", 1)[1])
    suite = root[0]
    assert (suite.get("failures"), suite.get("errors"), suite.get("skipped")) == ("2", "3", "0")
    assert [tag for case in suite for tag in said(case)] == [
        "failure",
        "error",
        "error",
        "error",
        "failure",
    ]


def test_without_a_target_a_claim_that_runs_violate_is_a_failure_and_else_skipped() -> None:
    """Nobody said how often it may be violated, and a gate has to see that it is."""
    *others, estimated = (one := evidence()).claims
    assert estimated.standing is ClaimStatus.ESTIMATED
    for violated, tag in ((120, "failure"), (0, "skipped")):
        outcomes = tuple(replace(each, violated=violated) for each in estimated.outcomes)
        found = replace(one, claims=(*others, replace(estimated, outcomes=outcomes)))
        suite = ElementTree.fromstring(junit_xml(found).split("\n", 1)[1])[0]
        assert said(suite[-1]) == [tag]
