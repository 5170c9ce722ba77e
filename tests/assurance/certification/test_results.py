"""From rows that are made up to bounds, checked against scipy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.certification.evidence import Bound, ClaimStatus
from safety_harness.extensions.assurance.certification.results import (
    bounds,
    claims_of,
    refuse_hopeless,
    strata_of,
)
from safety_harness.extensions.assurance.certification.stored import Stored
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

MARGIN = {EpisodeOutcome.HOLDS: 0.05, EpisodeOutcome.VIOLATED: -0.02}


def row(
    stratum: int, episode: int, first: EpisodeOutcome, second: EpisodeOutcome = EpisodeOutcome.HOLDS
) -> Row:
    judgements = tuple(
        ClaimJudgement(
            outcome,
            MARGIN.get(outcome, np.nan) + 1e-6 * episode,
            exercised=int(outcome is not EpisodeOutcome.UNTESTED),
        )
        for outcome in (first, second)
    )
    return Row(
        stratum=stratum,
        episode=episode,
        seed=episode,
        judgements=judgements,
        draws=2,
        decisions=1,
        proposed=1,
        cell="right, at rest, to 50 mm, seen, proposed position",
    )


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path)


@pytest.fixture
def ledger(tmp_path: Path, plan: Plan) -> Iterator[Ledger]:
    with ledger_in(tmp_path, plan) as made:
        yield made


def filled(ledger: Ledger, *, inconclusive: int = 0) -> None:
    ledger.record(row(0, k, EpisodeOutcome.VIOLATED if k < 3 else EpisodeOutcome.HOLDS) for k in range(30))
    ledger.record(
        row(
            1,
            k,
            EpisodeOutcome.INCONCLUSIVE if k < inconclusive else EpisodeOutcome.HOLDS,
            EpisodeOutcome.UNTESTED,
        )
        for k in range(20)
    )


def test_bounds_are_exact_at_their_share_of_the_plans_confidence(plan: Plan, ledger: Ledger) -> None:
    filled(ledger)
    first, second = claims_of(plan, ledger)[0].outcomes
    chance = (1.0 - plan.confidence) / bounds(plan)
    assert bounds(plan) == 8  # two ends for each of two claims in each of two strata
    assert first.bound is not None
    assert second.bound is not None
    assert first.bound.upper == pytest.approx(scipy.stats.beta.ppf(1.0 - chance, 4, 27))
    assert first.bound.lower == pytest.approx(scipy.stats.beta.ppf(chance, 3, 28))
    assert second.bound.upper == pytest.approx(1.0 - chance ** (1.0 / 20.0))
    assert second.bound.lower == 0.0
    assert first.bound.confidence == pytest.approx(1.0 - 2.0 * chance)
    assert first.bound.of_one_end == pytest.approx(1.0 - chance)


def test_what_is_shown_as_an_interval_covers_as_often_as_is_said_beside_it(
    tmp_path: Path, plan: Plan
) -> None:
    """Every count of violations in 20 runs enumerated, at the truths where intervals end."""
    shown: list[Bound] = []
    for violated in range(21):
        with ledger_in(tmp_path / str(violated), plan) as ledger:
            ledger.record(
                row(1, k, EpisodeOutcome.VIOLATED if k < violated else EpisodeOutcome.HOLDS)
                for k in range(20)
            )
            found = claims_of(plan, ledger)[0].outcomes[1].bound
            assert found is not None
            shown.append(found)
    low, high = (np.array([getattr(one, end) for one in shown]) for end in ("lower", "upper"))
    truths = np.concatenate([np.linspace(0.01, 0.99, 99), low + 1e-9, high - 1e-9])
    chances = scipy.stats.binom.pmf(np.arange(21), 20, truths[:, None])
    covered = np.where((low <= truths[:, None]) & (truths[:, None] <= high), chances, 0.0).sum(axis=1)
    assert covered.min() >= shown[0].confidence - 1e-9
    missed = len(plan.claims) * len(plan.strata) * (1.0 - covered.min())
    assert missed <= 1.0 - plan.confidence + 1e-9  # all four intervals together


def test_a_ledger_whose_rows_contradict_themselves_has_no_bound_and_says_why(
    plan: Plan, ledger: Ledger
) -> None:
    filled(ledger, inconclusive=1)
    relabelled = f"UPDATE judgement SET outcome = {int(EpisodeOutcome.UNTESTED)} WHERE outcome = "
    ledger.connection.execute(relabelled + str(int(EpisodeOutcome.INCONCLUSIVE)))
    claim = claims_of(plan, ledger)[0]
    assert claim.outcomes[1].standing is ClaimStatus.INCOMPLETE
    assert claim.outcomes[1].bound is None
    assert "no occasion in an untested run" in claim.outcomes[1].why
    ledger.connection.execute("UPDATE episode SET seed = seed % 10 WHERE stratum = 0")
    assert "a seed of its own" in claims_of(plan, ledger)[0].outcomes[0].why


def test_inconclusive_runs_count_against_the_claim_and_leave_doubt(plan: Plan, ledger: Ledger) -> None:
    filled(ledger, inconclusive=1)
    claim = claims_of(plan, ledger)[0]
    chance = (1.0 - plan.confidence) / bounds(plan)
    doubted = claim.outcomes[1]
    assert doubted.bound is not None
    assert doubted.bound.upper == pytest.approx(scipy.stats.beta.ppf(1.0 - chance, 2, 19))
    assert doubted.standing is ClaimStatus.DOUBTED
    assert "1 had no verdict; they count as violations" in doubted.why


def test_in_pybullet_a_run_without_a_verdict_is_what_leaves_doubt(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.replace("world: kinematic", "world: PyBullet"))
    for inconclusive, standing in ((0, ClaimStatus.SHOWN), (1, ClaimStatus.DOUBTED)):
        with ledger_in(tmp_path / str(inconclusive), plan) as ledger:
            filled(ledger, inconclusive=inconclusive)
            claim = claims_of(plan, ledger)[0]
            assert [outcome.standing for outcome in claim.outcomes] == [ClaimStatus.SHOWN, standing]
            assert claim.standing is standing


def test_a_bound_of_the_kinematic_world_is_of_the_model_only(plan: Plan, ledger: Ledger) -> None:
    filled(ledger)
    shown = claims_of(plan, ledger)[0].outcomes[1]
    assert shown.standing is ClaimStatus.DOUBTED
    assert "model only" in shown.why


def test_a_claim_that_was_not_put_to_the_test_has_no_bound(plan: Plan, ledger: Ledger) -> None:
    filled(ledger)
    second = claims_of(plan, ledger)[1]
    assert second.outcomes[1].bound is None
    assert second.outcomes[1].standing is ClaimStatus.UNTESTED
    assert second.standing is ClaimStatus.UNTESTED


def test_why_names_the_kept_run_whose_hand_came_nearest_and_what_it_lacked(
    tmp_path: Path,
) -> None:
    plan = plan_in(tmp_path, PLAN.replace("joint speeds within limits", "repulsive poses reachable"))
    ledger = ledger_in(tmp_path, plan)
    filled(ledger)
    assert "; the ledger keeps no trace" in claims_of(plan, ledger)[1].outcomes[1].why
    far = plan.strata[1].space.simplest
    far = replace(far, duration_s=0.1, hands=(replace(far.hands[0], shift_in_base_m=(0.0, -2.0, 0.0)),))
    none, of_another = replace(far, hands=()), plan.strata[0].space.simplest
    runs = [
        Stored(stratum, k, run_kinematic(admit(replace(one, duration_s=0.1))))
        for k, (stratum, one) in enumerate([(1, none), (1, far), (0, of_another)], start=4)
    ]
    said = claims_of(plan, ledger, runs)[1].why
    ledger.close()
    assert (
        "not one of 20 runs put it to the test; in run 5, which of 2 kept runs has the nearest hand, never"
        in said
    )
    assert "exercised: the nearest predicted hand came to" in said
    assert "within 400 mm exercises it" in said


def test_while_runs_are_missing_there_is_no_bound(plan: Plan, ledger: Ledger) -> None:
    ledger.record(row(0, k, EpisodeOutcome.HOLDS) for k in range(29))
    ledger.record(row(1, k, EpisodeOutcome.HOLDS) for k in range(20))
    first, second = claims_of(plan, ledger)[0].outcomes
    assert (first.standing, first.bound, first.runs) == (ClaimStatus.INCOMPLETE, None, 29)
    assert second.bound is not None  # and it is no tighter for what is missing elsewhere
    chance = (1.0 - plan.confidence) / bounds(plan)
    assert second.bound.upper == pytest.approx(1.0 - chance ** (1.0 / 20.0))


def test_margins_ascend_to_all_runs(plan: Plan, ledger: Ledger) -> None:
    filled(ledger)
    first = claims_of(plan, ledger)[0].outcomes[0]
    assert list(first.margins_si) == sorted(first.margins_si)
    assert first.shares[-1] == 1.0
    assert first.shares[2] == pytest.approx(3 / 30)
    assert first.least_margin_si == pytest.approx(-0.02)


def test_the_strata_say_what_was_run(plan: Plan, ledger: Ledger) -> None:
    filled(ledger)
    first, second = strata_of(plan, ledger)
    assert (first.made, first.planned, first.refused_draws) == (30, 30, 30)
    assert dict(second.decisions) == {"proposed positions": 20}
    assert len(first.space_sha256) == 64


def test_a_target_that_the_runs_cannot_show_is_refused_with_the_number_that_would_do(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.replace("50 %", "1 %"))
    with pytest.raises(StatisticsError) as refused:
        refuse_hopeless(plan)
    chance = (1.0 - plan.confidence) / bounds(plan)
    needed = int(np.ceil(np.log(chance) / np.log(1.0 - 0.01)))
    assert f"at least {needed} runs" in refused.value.expected
    assert refused.value.got == "30"
    refuse_hopeless(plan_in(tmp_path / "enough", PLAN))
