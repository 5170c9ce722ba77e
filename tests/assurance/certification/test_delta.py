"""What got worse between two reports is found, each kind of it; what did not change is not told."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from markupsafe import escape

from safety_harness.extensions.assurance.campaign.identity import SYSTEM, Identity
from safety_harness.extensions.assurance.certification.delta import EvidenceDelta, Paired, delta_between
from safety_harness.extensions.assurance.certification.delta_page import render
from safety_harness.extensions.assurance.certification.evidence import (
    CertifiedClaim,
    CertifiedProofs,
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    OpenFinding,
)
from tests.assurance.certification.made_up_evidence import HASH, STRATA, bound, evidence

WHEN = datetime(2026, 11, 24, tzinfo=UTC)
SHOWN = "moves away from the hand"
PARTS = (
    ("the file plan.yaml", "1"),
    ("the file spaces/nominal.yaml", "1"),
    (f"{SYSTEM} in seen", "1"),
    ("the network x", HASH),
)


def delta(
    before: Evidence, after: Evidence, *, paired: Paired | None = None, now: dict[str, str] | None = None
) -> EvidenceDelta:
    later = Identity(tuple((dict(PARTS) | (now or {})).items()))
    return delta_between(
        before, after, names=("old", "new"), identities=(Identity(PARTS), later), paired=paired or {}
    )


def with_claim(found: Evidence, change: Callable[[ClaimEvidence], ClaimEvidence]) -> Evidence:
    claims = (change(one) if one.sentence == SHOWN else one for one in found.claims)
    return replace(found, claims=tuple(claims))


def with_outcome(found: Evidence, change: Callable[[ClaimResult], ClaimResult]) -> Evidence:
    """In the first stratum only."""

    def changed(claim: ClaimEvidence) -> ClaimEvidence:
        return replace(claim, outcomes=(change(claim.outcomes[0]), *claim.outcomes[1:]))

    return with_claim(found, changed)


PROVEN = CertifiedProofs(
    network_sha256=HASH,
    claims=(
        CertifiedClaim(claim="leads away", region="near", verdict="proven", confirmed="", maps=(), gates=()),
    ),
)
OPENED = OpenFinding(text="seen: 3 of 40 runs could not be carried on", place="strata")


def no_longer_shown(found: Evidence) -> Evidence:
    return with_outcome(found, lambda one: replace(one, standing=ClaimStatus.NOT_SHOWN))


def without_the_claim(found: Evidence) -> Evidence:
    return replace(found, claims=tuple(one for one in found.claims if one.sentence != SHOWN))


def without_the_stratum(found: Evidence) -> Evidence:
    return with_claim(found, lambda one: replace(one, outcomes=one.outcomes[1:]))


def refuted(found: Evidence) -> Evidence:
    return with_outcome(found, lambda one: replace(one, standing=ClaimStatus.REFUTED))


def in_another_space(found: Evidence) -> Evidence:
    first, *others = found.strata
    return replace(found, strata=(replace(first, space_sha256="0" * 64), *others))


@pytest.mark.parametrize(
    ("exchanged", "told"),
    [
        (without_the_stratum, "the stratum is not in the plan"),
        (without_the_claim, "the claim is not in the plan"),
        (in_another_space, "its space changed"),
    ],
)
def test_what_was_refuted_and_is_not_asked_any_more_got_worse(
    exchanged: Callable[[Evidence], Evidence], told: str
) -> None:
    """With its question gone a refutation is not mended; in the same space it is."""
    found = delta(refuted(evidence()), exchanged(evidence()))
    assert f"{SHOWN}, seen: refuted before, and dropped since: {told}" in found.regressions
    assert not any(SHOWN in text for text in found.closed)
    assert not delta(refuted(evidence()), evidence()).regressions


def worse(found: Evidence) -> Evidence:
    return with_outcome(found, lambda one: replace(one, bound=bound(0.01, 0.09)))


def for_a_larger_target(found: Evidence) -> Evidence:
    larger = with_claim(found, lambda one: replace(one, target=0.1))
    return with_outcome(larger, lambda one: replace(one, bound=bound(0.0, 0.09)))


def with_less_confidence(found: Evidence) -> Evidence:
    return replace(found, plan=replace(found.plan, confidence=0.9))


def with_a_finding(found: Evidence) -> Evidence:
    return replace(found, findings=(*found.findings, OPENED))


def rated(found: Evidence, asked_an_hour: float) -> Evidence:
    return replace(found, hazards=(replace(found.hazards[0], asked_an_hour=asked_an_hour),))


def without_the_hazard(found: Evidence) -> Evidence:
    return replace(found, hazards=())


def with_more_asked_of_the_hazard(found: Evidence) -> Evidence:
    return rated(found, 1e-12)


def without_the_proof(found: Evidence) -> Evidence:
    return replace(found, proven=None)


@pytest.mark.parametrize(
    ("planted", "told"),
    [
        (no_longer_shown, f"{SHOWN}, seen: shown before, now not shown"),
        (without_the_claim, f"{SHOWN}, seen: shown before, now the claim is not in the plan any more"),
        (without_the_stratum, f"{SHOWN}, seen: shown before, now the stratum is not in the plan any more"),
        (worse, f"{SHOWN}, seen: 0 % to 0.16 % before, 1 % to 9 % now"),
        (for_a_larger_target, f"{SHOWN}, seen: shown for a larger target, not for 0.2 %"),
        (with_less_confidence, "the bounds hold with 90 % confidence, 95 % before"),
        (with_a_finding, f"a finding was opened: {OPENED.text}"),
        (without_the_proof, "leads away, near: proven before, now no proof is given"),
        (
            without_the_hazard,
            "crushed hand: rare enough before, the hazard is not in the plan any more",
        ),
        (with_more_asked_of_the_hazard, "crushed hand: rare enough before, not shown to be now"),
    ],
)
def test_each_kind_of_regression_is_caught(planted: Callable[[Evidence], Evidence], told: str) -> None:
    before = rated(replace(evidence(), proven=PROVEN), 1e6)
    found = delta(before, planted(before))
    assert any(text.startswith(told) for text in found.regressions), found.regressions
    assert not found.empty


@pytest.mark.parametrize("only_shown", [True, False])
def test_between_two_that_are_the_same_nothing_changed(only_shown: bool) -> None:
    found = delta(evidence(only_shown=only_shown), evidence(only_shown=only_shown))
    assert found.empty
    assert found.regressions == ()
    assert all(one.carries for one in found.carried)
    assert len(found.carried) >= len(STRATA)


def test_the_other_way_round_a_regression_is_an_improvement() -> None:
    before = evidence()
    for planted in (no_longer_shown, worse, with_a_finding):
        found = delta(planted(before), before)
        assert found.regressions == ()
        assert not found.empty
    assert delta(with_a_finding(before), before).closed == (OPENED.text,)


def test_a_bound_is_worse_only_where_it_is_shown_to_be() -> None:
    before = evidence()
    overlapping = with_outcome(before, lambda one: replace(one, bound=bound(0.001, 0.09)))
    (found,) = delta(before, overlapping).bounds
    assert (found.worse, found.better) == (False, False)
    key = (SHOWN, "seen")
    (paired,) = delta(before, overlapping, paired={key: (0.002, 0.01, 0.99)}).bounds
    assert paired.worse
    assert "paired by episode" in paired.how
    (unsure,) = delta(before, worse(before), paired={key: (-0.001, 0.01, 0.99)}).bounds
    assert not unsure.worse


def test_a_finding_whose_numbers_changed_is_neither_opened_nor_closed() -> None:
    before = with_a_finding(evidence())
    more = replace(OPENED, text="seen: 30 of 40 runs could not be carried on")
    other = replace(OPENED, text="unseen hand: 3 of 40 runs could not be carried on")
    after = replace(before, findings=(*before.findings[:-1], more))
    assert delta(before, after).reworded == ((OPENED.text, more.text),)
    assert delta(before, replace(before, findings=(*before.findings[:-1], other))).opened == (other.text,)
    named = [OpenFinding(f"the seeded fault 'late by {k} ticks' survived", "tools") for k in (1, 2)]
    first, second = (replace(before, findings=(one,)) for one in named)
    assert delta(first, second).opened == (named[1].text,)


def test_a_claim_that_stands_graver_opens_a_finding_and_one_less_grave_does_not() -> None:
    before = evidence()
    number = next(one.number for one in before.claims if one.standing is ClaimStatus.NOT_SHOWN)

    def turned(to: ClaimStatus) -> Evidence:
        claims = (replace(one, standing=to) if one.number == number else one for one in before.claims)
        finding = OpenFinding(f"protective separation kept is {to.value}", f"claim-{number}")
        return replace(before, claims=tuple(claims), findings=(finding,))

    refuted, open_yet = turned(ClaimStatus.REFUTED), turned(ClaimStatus.NOT_SHOWN)
    assert delta(open_yet, refuted).opened == (refuted.findings[0].text,)
    assert delta(refuted, open_yet).opened == ()


@pytest.mark.parametrize(
    ("now", "again"),
    [
        ({"the file plan.yaml": "2"}, set()),
        ({"the file spaces/nominal.yaml": "2"}, {*STRATA}),
        ({f"{SYSTEM} in seen": "2"}, {"seen"}),
        ({"the source of this package": "2"}, {*STRATA}),
    ],
)
def test_what_a_stratum_hangs_on_says_whether_its_runs_carry_over(
    now: dict[str, str], again: set[str]
) -> None:
    found = delta(evidence(), evidence(), now=now)
    runs = {one.what.partition(" of ")[2]: one for one in found.carried if "runs of" in one.what}
    assert {name for name, one in runs.items() if not one.carries} == again
    assert all(one.why for one in found.carried)


def test_another_seed_or_a_new_claim_carries_no_run_over() -> None:
    before = evidence()
    for after in (
        replace(before, plan=replace(before.plan, seed=2)),
        with_claim(before, lambda one: replace(one, sentence="servos to the object")),
    ):
        assert not any(one.carries for one in delta(before, after).carried if "runs of" in one.what)


def test_training_distance_and_coverage_that_are_others_are_told_and_what_only_the_earlier_tried() -> None:
    before = evidence()
    assert before.learned is not None
    first, *rest = before.learned.strata
    farther = replace(first, share_outside=0.75, largest_outside_m=0.9)
    fewer = replace(before.coverage, cells=before.coverage.cells[1:])
    found = delta(
        before,
        replace(before, learned=replace(before.learned, strata=(farther, *rest)), coverage=fewer),
    )
    told = {(one.part, one.name): one for one in found.parts}
    assert "75 % of" in told["training", first.stratum].after
    assert "900 mm at most" in told["training", first.stratum].after
    assert told["coverage", "cells of which only the earlier report has runs"].before == "1"
    assert told["coverage", "cells"].before != told["coverage", "cells"].after
    assert found.regressions == ()


def test_the_page_and_the_json_say_it_all() -> None:
    before = with_a_finding(replace(evidence(), proven=PROVEN))
    found = delta(before, without_the_proof(no_longer_shown(worse(evidence()))))
    page = render(found, command="safety-harness certify delta old new", generated_at=WHEN)
    texts = {*found.regressions, *found.closed, *(one.why for one in found.carried)}
    assert len(texts) > 4
    assert [text for text in texts if escape(text) not in page] == []
    assert json.loads(found.as_text())["regressions"] == [*found.regressions]
