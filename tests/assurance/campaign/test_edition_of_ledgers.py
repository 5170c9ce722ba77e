"""A ledger that tells no edition of its claims is of the first."""

from __future__ import annotations

from pathlib import Path

from safety_harness.extensions.assurance.campaign.identity import CLAIMS, Identity, edition_of
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.scenario.model import EDITION

ROOT = Path(__file__).parents[3]


def test_a_ledger_that_tells_no_edition_is_of_the_first() -> None:
    file = ROOT / "plans/certify-in-a-minute.yaml"
    now, then = read_plan(file), read_plan(file, 1)
    assert [edition_of(one.identity) for one in (now, then)] == [EDITION, 1]
    assert {one.claim.edition for one in then.claims} == {1}
    assert then.identity.changes(now.identity) == [f"{CLAIMS} is new"]
    assert edition_of(Identity(((CLAIMS, "edition of a forger"),))) == EDITION
