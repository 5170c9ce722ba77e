from __future__ import annotations

from xml.etree import ElementTree

from made_up_evidence import STRATA, evidence

from safety_harness.certification.evidence import ClaimStatus
from safety_harness.certification.folder import junit_xml


def test_only_what_is_shown_passes() -> None:
    one = evidence()
    root = ElementTree.fromstring(junit_xml(one).split("\n", 1)[1])
    assert [suite.get("name") for suite in root] == list(STRATA)
    standings = {claim.sentence: claim.standing for claim in one.claims}
    for suite in root:
        assert int(suite.get("tests", "")) == len(one.claims)
        for case in suite:
            passed = len(case) == 0
            assert passed == (standings[case.get("name", "")] is ClaimStatus.SHOWN)


def test_refuted_is_a_failure_and_what_is_open_an_error() -> None:
    root = ElementTree.fromstring(junit_xml(evidence()).split("\n", 1)[1])
    suite = root[0]
    assert (suite.get("failures"), suite.get("errors"), suite.get("skipped")) == ("1", "3", "1")
    assert [child.tag for case in suite for child in case] == [
        "failure",
        "error",
        "error",
        "error",
        "skipped",
    ]
