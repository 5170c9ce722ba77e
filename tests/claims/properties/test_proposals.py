"""Claims about proposals: what the avoider said before the gate, against arithmetic written out once more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import pytest
from broken import IN_DOUBT, seeks_the_hand
from examples import VISIT, Displaced, Raising, TowardsTheHand, run, scenario
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import InadmissibleError, InputError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.claims.properties.base import Property, Unit
from safety_harness.claims.properties.giving_way import MovesAway
from safety_harness.claims.properties.proposals import (
    FewOverruled,
    NearOptimum,
    NeverSureAndOff,
    ProposalsLeadAway,
    WithinSpread,
)
from safety_harness.scenario.faults import AvoiderLate, AvoiderNaN, AvoiderSilent
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.records import DecisionOutcome
from safety_harness.trace.trace import Trace

AWAY = ProposalsLeadAway(tolerance_m=0.01)
NEAR = NearOptimum(within_m=0.06)
SPREAD = WithinSpread(spreads=3.0, allowance_m=0.03)
SURE = NeverSureAndOff(within_m=0.06)
FEW = FewOverruled(most=0.5)
ABOUT_POSITIONS = (AWAY, NEAR, SPREAD, SURE)
ALL: tuple[Property, ...] = (*ABOUT_POSITIONS, FEW)
HAND, TCP = (1.0, 0.25, 0.25), (0.5, 0.25, 0.25)  # sums and differences of these have no rounding
AXIS = np.subtract(
    DEFAULTS.cell.desired_tcp_position_in_base_m, DEFAULTS.avoidance.nominal_hand_position_in_base_m
)
A_POSITION = arrays(np.float64, 3, elements=st.floats(-1.5, 1.5))
SPREADS = arrays(np.float64, 3, elements=st.floats(0.0, 0.1))


@dataclass(frozen=True)
class Said:
    """One answer, and what came of it."""

    proposed: NDArray[np.float64] | tuple[float, ...]
    hand: NDArray[np.float64] | tuple[float, ...] = HAND
    tcp: NDArray[np.float64] | tuple[float, ...] = TCP
    spread: NDArray[np.float64] | tuple[float, ...] = (0.01, 0.01, 0.01)
    threshold: float = 0.02
    outcome: DecisionOutcome = DecisionOutcome.PROPOSED
    fault: str = ""


@lru_cache
def visited() -> Trace:
    return run(scenario(VISIT))


def saying(*answers: Said) -> Trace:
    """A run in which the avoider gave these answers."""
    visit = visited()
    decisions, ticks = np.resize(visit.decisions[:1], len(answers)), visit.ticks.copy()
    ticks["decision"] = -1
    for number, answer in enumerate(answers):
        one, tick = decisions[number], 10 * (number + 1)
        ticks["decision"][tick] = number
        one["tick"] = one["asked_tick"] = tick
        one["time_s"] = ticks["time_s"][tick]
        one["proposed_position_in_base_m"], one["proposed_spread_m"] = answer.proposed, answer.spread
        one["hand_position_in_base_m"], one["tcp_position_in_base_m"] = answer.hand, answer.tcp
        one["spread_threshold_m"], one["outcome"], one["fault"] = (
            answer.threshold,
            answer.outcome,
            answer.fault,
        )
    return replace(visit, ticks=ticks, decisions=decisions, decision_latency_s=np.zeros(len(answers)))


def judged(prop: Property, trace: Trace) -> tuple[Verdict, float | None, int]:
    evaluation = prop.evaluate(trace)
    return evaluation.verdict, evaluation.margin, evaluation.exercised


def claimed(sentence: str) -> Property:
    return property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), scenario())


def optimum(hand: NDArray[np.float64], tcp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Eq. 13 by hand: the point of the cap nearest to the desired position, and a twentieth of t - h."""
    avoidance = DEFAULTS.avoidance
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    axis = AXIS / np.sqrt((AXIS**2).sum())
    wanted = (desired - tcp) / np.sqrt(((desired - tcp) ** 2).sum())
    angle = np.arccos(np.clip(axis @ wanted, -1.0, 1.0))
    if angle > avoidance.candidate_cone_rad:  # turn the axis by the cone's angle towards what is wanted
        aside = wanted - (axis @ wanted) * axis
        aside = aside / np.sqrt((aside**2).sum())
        cone = avoidance.candidate_cone_rad
        wanted = np.cos(cone) * axis + np.sin(cone) * aside
    found: NDArray[np.float64] = tcp + avoidance.radius_m * wanted + avoidance.hand_pull * (tcp - hand)
    return found


def one_is_nearest(tcp: NDArray[np.float64]) -> bool:
    """Is one point of the cap clearly nearer to the desired position than all others?"""
    wanted = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) - tcp
    return bool(np.linalg.norm(np.cross(wanted, AXIS)) > 1e-3)


@given(
    st.lists(
        st.builds(
            Said,
            proposed=A_POSITION,
            hand=A_POSITION,
            tcp=A_POSITION,
            spread=SPREADS,
            threshold=st.sampled_from([0.02, 0.05, np.nan]),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_margins_are_what_arithmetic_by_hand_says(answers: list[Said]) -> None:
    trace = saying(*answers)
    away, near, spread, sure = [], [], [], []
    for one in answers:
        apart = np.asarray(one.tcp) - one.hand
        way = np.asarray(one.proposed) - one.tcp
        distance = np.sqrt((apart**2).sum())
        assume(distance > 1e-3)
        assume(one_is_nearest(np.asarray(one.tcp)))
        error = np.abs(one.proposed - optimum(np.asarray(one.hand), np.asarray(one.tcp)))
        off = np.sqrt((error**2).sum())
        away.append((way * apart).sum() / distance + 0.01)
        near.append(0.06 - off)
        spread.append(min(3.0 * s + 0.03 - e for s, e in zip(one.spread, error, strict=True)))
        if np.isnan(one.threshold) or all(s <= one.threshold for s in one.spread):
            sure.append(0.06 - off)
    if all(np.isnan(one.threshold) for one in answers) and not any(np.any(one.spread) for one in answers):
        spread = []
    for prop, margins in zip(ABOUT_POSITIONS, (away, near, spread, sure), strict=True):
        evaluation = prop.evaluate(trace)
        assert evaluation.exercised == len(margins)
        if margins:
            assert evaluation.margin == pytest.approx(min(margins), abs=1e-9)
            assert evaluation.verdict is (Verdict.VIOLATED if evaluation.margin < 0.0 else Verdict.HOLDS)
        else:
            assert evaluation.verdict is Verdict.INCONCLUSIVE


def test_what_is_exactly_at_the_limit_holds_and_a_hair_more_is_violated() -> None:
    nearer = (np.nextafter(0.5625, 1.0), 0.25, 0.25)
    lead = claimed("proposals lead away to within 62.5 mm")
    assert judged(lead, saying(Said((0.5625, 0.25, 0.25)))) == (Verdict.HOLDS, 0.0, 1)
    assert judged(lead, saying(Said(nearer)))[0] is Verdict.VIOLATED
    question = np.array([HAND]), np.array([TCP])
    error_m = float(np.linalg.norm(question[1] - optimum_in_base_m(DEFAULTS, *question)))
    for kind in (NearOptimum, NeverSureAndOff):
        assert judged(kind(within_m=error_m), saying(Said(TCP))) == (Verdict.HOLDS, 0.0, 1)
        less = kind(within_m=float(np.nextafter(error_m, 0.0)))
        assert judged(less, saying(Said(TCP)))[0] is Verdict.VIOLATED


@pytest.mark.parametrize(("share", "of"), [("99.5 %", 200), ("50 %", 8), ("0.1 %", 1000), ("12.5%", 8)])
def test_a_share_that_is_reached_exactly_holds_and_one_more_is_violated(share: str, of: int) -> None:
    prop = claimed(f"at most {share} of proposals overruled")
    limit = round(float(share.rstrip("% ")) * of / 100)
    for count, verdict in ((limit, Verdict.HOLDS), (limit + 1, Verdict.VIOLATED)):
        decisions = np.resize(visited().decisions[:1], of)
        decisions["outcome"] = DecisionOutcome.PROPOSED
        decisions["outcome"][:count] = DecisionOutcome.OPPOSITE
        long = long_enough(of, decisions)
        evaluation = prop.evaluate(long)
        assert (evaluation.verdict, evaluation.exercised) == (verdict, of)
        if count == limit:
            assert evaluation.margin == 0.0


def long_enough(count: int, decisions: NDArray[np.void]) -> Trace:
    """A run with a decision at each of its ticks but the last."""
    visit = visited()
    period_s = visit.scenario.settings.clock.control_period_s
    ticks = np.resize(visit.ticks[:1], count + 1)
    ticks["time_s"] = np.arange(count + 1) * period_s
    ticks["decision"] = np.append(np.arange(count), -1)
    decisions["tick"] = decisions["asked_tick"] = np.arange(count)
    decisions["time_s"] = ticks["time_s"][:count]
    return replace(
        visit,
        scenario=replace(visit.scenario, duration_s=count * period_s),
        ticks=ticks,
        decisions=decisions,
        decision_latency_s=np.zeros(count),
    )


@given(A_POSITION, st.floats(1e-4, 0.5), st.floats(1e-4, 0.5))
def test_a_larger_allowance_is_as_much_more_margin(
    proposed: NDArray[np.float64], first_m: float, second_m: float
) -> None:
    trace = saying(Said(proposed))

    def margin(prop: Property) -> float:
        found = prop.evaluate(trace).margin
        assert found is not None
        return found

    kinds: tuple[Callable[[float], Property], ...] = (
        lambda length_m: ProposalsLeadAway(tolerance_m=length_m),
        lambda length_m: NearOptimum(within_m=length_m),
        lambda length_m: WithinSpread(spreads=2.0, allowance_m=length_m),
        lambda length_m: NeverSureAndOff(within_m=length_m),
    )
    for kind in kinds:
        change_m = margin(kind(second_m)) - margin(kind(first_m))
        assert change_m == pytest.approx(second_m - first_m, abs=1e-12)


@given(A_POSITION, A_POSITION)
def test_the_optimum_itself_keeps_all_claims_about_it(
    hand: NDArray[np.float64], tcp: NDArray[np.float64]
) -> None:
    trace = saying(Said(optimum(hand, tcp), hand, tcp))
    assume(one_is_nearest(tcp))
    for prop in (NEAR, SPREAD, SURE):
        assert prop.evaluate(trace).verdict is Verdict.HOLDS


def test_an_answer_in_doubt_is_not_held_against_who_is_sure_elsewhere() -> None:
    doubt, good = (
        Said((3.0, 0.0, 0.0), spread=(0.0, 0.021, 0.0)),
        Said(optimum(np.array(HAND), np.array(TCP))),
    )
    assert judged(SURE, saying(doubt, good))[0] is Verdict.HOLDS
    assert judged(SURE, saying(doubt, good))[2] == 1
    assert judged(SURE, saying(doubt))[0] is Verdict.INCONCLUSIVE
    assert judged(SURE, saying(replace(doubt, spread=(0.02, 0.02, 0.02))))[0] is Verdict.VIOLATED
    assert judged(SURE, saying(replace(doubt, threshold=np.nan)))[0] is Verdict.VIOLATED


def test_an_avoider_without_any_spread_says_nothing_of_it_but_one_that_is_always_sure_does() -> None:
    far = Said((3.0, 0.0, 0.0), spread=(0.0, 0.0, 0.0), threshold=np.nan)
    evaluation = SPREAD.evaluate(saying(far))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert evaluation.reason.startswith("never exercised: the avoider gives no spread")
    assert judged(SPREAD, saying(replace(far, threshold=0.02)))[0] is Verdict.VIOLATED
    assert judged(SPREAD, saying(far, replace(far, spread=(0.0, 0.0, 1e-6))))[0] is Verdict.VIOLATED


@pytest.mark.parametrize("prop", ALL, ids=lambda prop: prop.sentence)
def test_no_answer_is_no_proposal(prop: Property) -> None:
    good = Said(optimum(np.array(HAND), np.array(TCP)))
    silent = (Said((np.nan,) * 3), replace(good, fault="ZeroDivisionError"))
    assert judged(prop, saying(*silent))[0] is Verdict.INCONCLUSIVE
    assert judged(prop, saying())[0] is Verdict.INCONCLUSIVE
    assert judged(prop, saying(silent[0], good, silent[1]))[::2] == (Verdict.HOLDS, 1)
    raising = run(scenario(VISIT, duration_s=1.5), avoider=Raising())
    assert len(raising.decisions) > 0
    assert judged(prop, raising)[0] is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("prop", ABOUT_POSITIONS, ids=lambda prop: prop.sentence)
def test_a_question_that_is_nowhere_is_no_evidence(prop: Property, value: float) -> None:
    good = Said(optimum(np.array(HAND), np.array(TCP)))
    for broken in (replace(good, hand=(value, 0.0, 0.0)), replace(good, tcp=(0.5, value, 0.0))):
        assert judged(prop, saying(good, broken))[0] is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("prop", ABOUT_POSITIONS, ids=lambda prop: prop.sentence)
def test_a_proposal_far_beyond_everything_is_violated(prop: Property) -> None:
    assert judged(prop, saying(Said((1e90, 0.0, 0.0))))[0] is Verdict.VIOLATED


def test_the_worst_proposal_is_named_with_its_moment() -> None:
    towards = [Said((0.5 + by, 0.25, 0.25)) for by in (0.015625, 0.03125, 0.0)]
    trace = saying(*towards)
    evaluation = AWAY.evaluate(trace)
    assert evaluation.margin == 0.01 - 0.03125
    assert evaluation.worst_time_s == trace.time_s[20]
    assert evaluation.reason == "-31.2 mm away from the hand, worst of 3"


@dataclass(frozen=True, eq=False)
class Noting:
    """An avoider that keeps every question it is asked; right for its question, wrong for any other."""

    questions: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=list)
    name: str = "noting"

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        self.questions.append((hand_position_in_base_m, tcp_position_in_base_m))
        return Proposal(optimum(hand_position_in_base_m, tcp_position_in_base_m))


def test_an_answer_that_a_fault_delays_is_judged_by_the_question_that_was_asked() -> None:
    late = replace(scenario(VISIT, duration_s=2.0), faults=(AvoiderLate(delay_s=0.08),))
    avoider = Noting()
    trace = run(late, avoider=avoider)
    decision = trace.decisions[0]
    assert decision["tick"] - decision["asked_tick"] == 10
    assert np.linalg.norm(decision["hand_position_in_base_m"] - avoider.questions[0][0]) > 0.02
    exact = NearOptimum(within_m=1e-5)
    assert judged(exact, trace)[0] is Verdict.HOLDS
    asked_now = trace.decisions.copy()
    asked_now["asked_tick"] = asked_now["tick"]
    stale = replace(trace, decisions=asked_now, scenario=replace(late, faults=()))
    stale.ticks.setflags(write=True)
    stale.ticks["faults"] = 0
    assert judged(exact, stale)[0] is Verdict.VIOLATED  # by the hand of when it counts it would be


def test_an_answer_to_a_question_that_the_trace_does_not_tell_is_not_judged() -> None:
    late = replace(scenario(VISIT, duration_s=2.0), faults=(AvoiderLate(delay_s=0.08),))
    trace = run(late, avoider=TowardsTheHand())
    assert judged(AWAY, trace)[0] is Verdict.VIOLATED
    ticks = trace.ticks.copy()
    ticks["track_valid"][trace.decisions["asked_tick"]] = False
    assert judged(AWAY, replace(trace, ticks=ticks))[::2] == (Verdict.INCONCLUSIVE, 0)


@pytest.mark.parametrize("fault", [AvoiderNaN(), AvoiderSilent()], ids=lambda fault: type(fault).__name__)
def test_what_a_fault_of_the_scenario_suppresses_is_no_proposal(fault: AvoiderNaN | AvoiderSilent) -> None:
    trace = run(replace(scenario(VISIT, duration_s=1.5), faults=(fault,)), avoider=TowardsTheHand())
    assert len(trace.decisions) > 0
    for prop in ALL:
        assert judged(prop, trace)[::2] == (Verdict.INCONCLUSIVE, 0)


def test_the_gate_hides_nothing_and_no_hand_is_nobodys_fault() -> None:
    """The full gate refuses what heads for the hand: the arm is safe, and the avoider is not."""
    gated = run(scenario(VISIT), avoider=TowardsTheHand())
    assert MovesAway().evaluate(gated).verdict is Verdict.HOLDS
    for prop in (AWAY, NEAR, SURE, FEW):
        assert prop.evaluate(gated).verdict is Verdict.VIOLATED
    assert judged(FEW, seeks_the_hand())[0] is Verdict.HOLDS  # behind a gate that passes everything


def test_who_is_always_in_doubt_is_always_overruled() -> None:
    evaluation = FewOverruled(most=0.99).evaluate(run(scenario(VISIT), avoider=IN_DOUBT))
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin == pytest.approx(-0.01)
    assert "uncertain" in evaluation.reason
    assert evaluation.unit is Unit.FRACTION
    used = FewOverruled(most=0.0).evaluate(run(scenario(VISIT), avoider=Displaced((0.0, 0.05, 0.08))))
    assert (used.verdict, used.margin) == (Verdict.HOLDS, 0.0)


@pytest.mark.parametrize(
    ("sentence", "prop"),
    [
        ("proposals lead away to within 1 cm", AWAY),
        ("proposals within 0.06 m of the optimum", NEAR),
        ("Proposals within 6 cm of the optimum", NEAR),
        ("proposals within 3 spreads and 30 mm of the optimum", SPREAD),
        (
            "proposals within 1 spread and 0.5 mm of the optimum",
            WithinSpread(spreads=1.0, allowance_m=0.0005),
        ),
        ("proposals within 2.5 spreads and 3 cm of the optimum", WithinSpread(spreads=2.5, allowance_m=0.03)),
        ("proposals never sure and more than 60 mm from the optimum", SURE),
        ("at most 50 % of proposals overruled", FEW),
        ("at most 0.5 of proposals overruled", FEW),
        ("at most 99.5 % of proposals overruled", FewOverruled(most=0.995)),
        ("at most 99.99995 % of proposals overruled", FewOverruled(most=0.9999995)),
        ("at most 0 % of proposals overruled", FewOverruled(most=0.0)),
        ("repulsion moves away from every hand", MovesAway()),
        ("repulsion moves away from every hand to within 5 mm", MovesAway(tolerance_m=0.005)),
        ("repulsion moves away from every hand nearer than 60 cm", MovesAway(nearer_m=0.6)),
        (
            "repulsion moves away from every hand nearer than 600 mm to within 5 mm",
            MovesAway(nearer_m=0.6, tolerance_m=0.005),
        ),
    ],
)
def test_a_sentence_is_understood_and_writes_itself_again(sentence: str, prop: Property) -> None:
    assert claimed(sentence) == prop
    assert claimed(prop.sentence) == prop


@pytest.mark.parametrize(
    "sentence",
    [
        "proposals lead away to within 0 mm",
        "proposals lead away to within 10",
        "proposals within 60 of the optimum",
        "proposals within 3 spreads of the optimum",
        "proposals within 0 spreads and 30 mm of the optimum",
        "proposals within 3 mm and 30 mm of the optimum",
        "proposals within 3 spreads and 30 % of the optimum",
        "proposals never sure and more than -1 mm from the optimum",
        "at most 100 % of proposals overruled",
        "at most 50 of proposals overruled",
        "at most -1 % of proposals overruled",
        "repulsion moves away from every hand to within 0 mm",
    ],
)
def test_what_says_nothing_or_is_no_quantity_is_refused(sentence: str) -> None:
    with pytest.raises(InputError):
        claimed(sentence)


def test_shares_that_anything_keeps_are_told_why() -> None:
    with pytest.raises(InadmissibleError, match="at least 0 % and less than 100 %"):
        claimed("at most 100 % of proposals overruled")


def test_a_tolerance_forgives_the_planned_way_by_as_much_and_nothing_else() -> None:
    strict = MovesAway().evaluate(seeks_the_hand())
    lenient = MovesAway(tolerance_m=0.005).evaluate(seeks_the_hand())
    assert strict.reason.startswith("planned way")
    assert strict.margin is not None
    assert lenient.margin == pytest.approx(strict.margin + 0.005, abs=1e-12)
    visit = visited()
    decisions = visit.decisions.copy()
    decisions["chosen_position_in_base_m"] = decisions["tcp_position_in_base_m"]
    still = replace(visit, decisions=decisions)
    assert judged(MovesAway(tolerance_m=0.02), still) == judged(MovesAway(), still)  # it arrived nowhere
    assert judged(MovesAway(), still)[0] is Verdict.VIOLATED


def test_a_hand_that_is_far_away_counts_only_without_a_limit() -> None:
    trace = seeks_the_hand()
    tick = trace.ticks[trace.decisions["tick"]]
    apart_m = np.linalg.norm(
        tick["hand_position_in_base_m"][:, 0] - tick["transform_tcp_to_base"][:, :3, 3], axis=1
    )
    beyond, short = float(np.nextafter(apart_m.max(), 1.0)), float(apart_m.min())
    assert judged(MovesAway(nearer_m=beyond), trace) == judged(MovesAway(), trace)
    assert judged(MovesAway(nearer_m=short), trace) == (Verdict.INCONCLUSIVE, None, 0)
