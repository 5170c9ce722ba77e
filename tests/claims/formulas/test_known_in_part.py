"""Of a run that was measured in part nothing is said that the whole run denies; what is known decides."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_signals_measured import ran

from safety_harness.base.exceptions import FormulaError
from safety_harness.claims.formulas.claim import FormulaClaim, judge_part
from safety_harness.claims.formulas.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Not,
    Relation,
    Truth,
    Until,
    conjunction,
    disjunction,
    parts_of,
)
from safety_harness.claims.formulas.language import (
    always,
    hand_distance,
    m,
    ms,
    nearest_hand_to_tcp,
    parse_formula,
)
from safety_harness.claims.formulas.measures import Flag, Measure
from safety_harness.claims.formulas.quantities import Quantity, Span
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.hand_distance import RESOLUTION_M, HandDistance
from safety_harness.claims.signals.signal import Signal
from safety_harness.claims.signals.uncertainty import as_known
from safety_harness.scenario.model import Verdict
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    OF_DECISIONS,
    PER_HAND,
    PRESENCE,
    Gap,
    Measurement,
    Source,
)
from safety_harness.trace.records import DECISION, TICK
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

HOLDS, VIOLATED, INCONCLUSIVE = Verdict.HOLDS, Verdict.VIOLATED, Verdict.INCONCLUSIVE
SEED = 20261123
RUNS = ("between-two-hands", "fault-hand-sensor-late", "recorded-handover", "object-lost-and-found")
POSITIONS = ("hand_position_in_base_m", "elbow_position_in_base_m", "hand_distance_m")


def gap(first: int, after: int, hand: int | None = None) -> Measurement:
    return Measurement(source=Source.SENSOR, gaps=(Gap(first=first, after=after, hand=hand),))


def within(uncertainty: float) -> Measurement:
    return Measurement(source=Source.SENSOR, uncertainty=uncertainty)


def judged(sentence: str, trace: Trace) -> Evaluation:
    return FormulaClaim(parse_formula(sentence)).evaluate(trace)


# --- gaps of ticks


def test_nothing_is_violated_by_more_than_what_was_measured_tells(visit: Trace) -> None:
    sentence = "TCP height <= 364 mm until predicted hand distance < 100 mm"
    whole = judged(sentence, visit)
    found = judged(sentence, knowing(visit, {"predicted_distance_m": gap(10, len(visit.ticks) - 10)}))
    assert whole.verdict is found.verdict is VIOLATED
    assert (whole.margin or 0.0) <= (found.margin or 0.0) < 0.0


def test_what_is_known_elsewhere_still_decides(visit: Trace) -> None:
    repulses = int(np.argmax(visit.ticks["mode"] == 1))
    before, after = (
        knowing(visit, {"mode": gap(*ticks)}) for ticks in ((1, 5), (repulses, len(visit.ticks)))
    )
    assert judged("eventually repulsing", before).verdict is HOLDS
    assert judged("always servoing", before).verdict is VIOLATED
    for sentence in ("eventually repulsing", "always servoing", "not repulsing"):
        unknown = judged(sentence, after)
        assert unknown.verdict is INCONCLUSIVE
        time_s = visit.time_s[repulses]
        words = sentence.split()[-1]
        assert unknown.reason == f"not measured: mode; {words} is not known at {time_s:.3f} s"
        assert unknown.unmeasured == ("mode",)


def test_a_gap_beyond_a_window_is_not_asked(visit: Trace) -> None:
    late = knowing(visit, {"tcp_speed_mps": gap(100, 110)})
    assert judged("always for 0.5 s TCP speed < 260 mm/s", late).verdict is HOLDS
    assert judged("always for 1 s TCP speed < 260 mm/s", late).verdict is INCONCLUSIVE
    beside = judged("always for 792 ms TCP height > 0 mm", late)  # until tick 99, whose cell touches the gap
    assert (beside.verdict, beside.unmeasured) == (INCONCLUSIVE, ("tcp_speed_mps",))
    assert judged("always for 784 ms TCP height > 0 mm", late).verdict is HOLDS


def test_decisions_that_may_have_been_made_in_a_gap_are_in_force_until_the_next_one() -> None:
    trace = ran("hand-follows-the-tcp")
    first, second, third = trace.decisions["tick"][:3].tolist()
    spread = next(signal for signal in SIGNALS if signal.words == "spread")
    falling = next(signal for signal in SIGNALS if signal.words == "falling back")
    unsure = knowing(trace, {"decision": gap(second - 1, second + 1)})
    for signal in (spread, falling):
        whole, known = (signal.sample(one).value for one in (trace, unsure))
        lost = np.isnan(known) & ~np.isnan(whole)
        assert np.array_equal(np.flatnonzero(lost), np.arange(second - 1, third))
        assert np.array_equal(known[~lost], whole[~lost], equal_nan=True)
        assert not np.isnan(known[first])


def test_a_prediction_is_not_known_to_be_wrong_where_the_hand_was_not_measured(visit: Trace) -> None:
    error = next(signal for signal in SIGNALS if signal.words == "prediction error")
    whole = error.sample(visit).value
    known = error.sample(knowing(visit, {"hand_position_in_base_m": gap(200, 210)})).value
    assert np.isnan(known[187:198]).all()  # 12.5 ticks ahead
    kept = np.r_[0:186, 199 : len(whole)]
    assert np.array_equal(known[kept], whole[kept], equal_nan=True)


def test_never_exercised_and_not_measured_are_said_apart(visit: Trace) -> None:
    tried = "whenever stopped then TCP speed < 1 mm/s"
    never = judged(tried, knowing(visit, {"tcp_speed_mps": gap(0, 9)}))
    assert never.reason.startswith('never exercised: "stopped" never holds')
    assert never.unmeasured == ()
    perhaps = judged("whenever stopped then TCP speed < 1 m/s", knowing(visit, {"mode": gap(0, 9)}))
    assert perhaps.reason == "not measured: mode; nothing else tells whether it was exercised"
    assert (perhaps.verdict, perhaps.unmeasured) == (INCONCLUSIVE, ("mode",))
    far = ran("recorded-handover")
    nearest_m = far.ticks["hand_distance_m"].min(axis=1)
    near = np.flatnonzero(nearest_m < far.scenario.settings.avoidance.critical_distance_m)
    assert len(near)
    away = knowing(far, {"hand_distance_m": gap(int(near[0]), int(near[-1]) + 1)})
    unseen = judged("eventually (hand distance > 100 mm and repulsing)", away)
    assert unseen.reason.startswith("not measured: hand_distance_m")


def test_an_occasion_that_goes_on_through_a_gap_counts_once(visit: Trace) -> None:
    sentence = "whenever repulsing then hand distance > 50 mm"
    whole = judged(sentence, visit)
    middle = int(np.flatnonzero(visit.ticks["mode"] == 1)[10])
    assert (whole.verdict, whole.exercised) == (HOLDS, 1)
    holed = judged(sentence, knowing(visit, {"mode": gap(middle, middle + 2)}))
    assert (holed.verdict, holed.exercised) == (HOLDS, 1)


# --- one hand of two


@pytest.mark.parametrize("signal", [hand_distance, nearest_hand_to_tcp], ids=str)
@np.errstate(invalid="ignore")
def test_without_one_of_two_hands_the_nearest_is_at_most_as_far_as_the_other(signal: Measure) -> None:
    trace = ran("between-two-hands")
    for columns in (POSITIONS, (PRESENCE,)):
        alone = knowing(trace, dict.fromkeys(columns, gap(100, 300, hand=1)))
        whole, one = (as_known(signal, signal.sample(run), run) for run in (trace, alone))
        assert one.value_low is not None
        assert one.value_high is not None
        assert np.isneginf(one.value_low[100:300]).all()
        assert np.isneginf(one.low[99:300]).all()
        assert np.all(whole.value <= one.value_high)
        assert np.all(whole.high <= one.high)
        assert np.isfinite(one.high).all()
        rest = np.r_[0:99, 300 : len(trace.ticks)]
        assert np.array_equal(one.low[rest], whole.low[rest])
        assert np.array_equal(one.value[rest], whole.value[rest])


def test_a_claim_on_the_nearest_hand_is_decided_by_the_hand_that_was_measured() -> None:
    trace = ran("between-two-hands")
    ticks = len(trace.ticks)
    alone = knowing(trace, dict.fromkeys(POSITIONS, gap(0, ticks, hand=1)))
    least_mm = 1e3 * trace.ticks["hand_distance_m"][:, 0].min()
    assert judged(f"always hand distance > {least_mm + 1:.1f} mm", alone).verdict is VIOLATED
    near = judged(f"eventually hand distance < {least_mm + 1:.1f} mm", alone)
    assert near.verdict is INCONCLUSIVE  # the other hand may have been so near from the beginning
    open_end = judged("always hand distance > 0 mm", alone)
    assert judged("always hand distance > 0 mm", trace).verdict is HOLDS
    assert (open_end.verdict, open_end.unmeasured) == (INCONCLUSIVE, POSITIONS)
    nobody = knowing(trace, dict.fromkeys(POSITIONS, gap(0, ticks)))
    assert judged(f"always hand distance > {least_mm + 1:.1f} mm", nobody).verdict is INCONCLUSIVE


def test_a_hand_that_is_not_known_to_be_absent_may_be_anywhere(visit: Trace) -> None:
    second = knowing(visit, {PRESENCE: gap(50, 60, hand=1)})
    assert judged("always hand distance > 50 mm", visit).verdict is HOLDS
    found = judged("always hand distance > 50 mm", second)
    assert (found.verdict, found.unmeasured) == (INCONCLUSIVE, (PRESENCE,))
    assert judged("always hand distance > 50 mm", knowing(visit, {PRESENCE: NOT_MEASURED})).unmeasured == (
        PRESENCE,
    )


# --- uncertainty


def test_a_claim_says_both_ends_where_the_uncertainty_decides(visit: Trace) -> None:
    least_m = float(hand_distance.sample(visit).low.min())
    known = knowing(visit, {"hand_distance_m": within(0.008)})
    claims = {off: FormulaClaim(always(hand_distance() > m(least_m + off))) for off in (-0.009, -0.007, 0.01)}
    surely, perhaps, never = (claim.evaluate(known) for claim in claims.values())
    assert surely.verdict is HOLDS
    assert surely.margin == pytest.approx(0.001, abs=1e-9)
    assert perhaps.verdict is INCONCLUSIVE
    assert perhaps.unmeasured == ("hand_distance_m",)
    ends = r"between -0\.[89]\d* mm and \+15.\d mm"
    assert re.match(f"{ends}, as hand_distance_m may be that far off: hand distance", perhaps.reason)
    assert never.verdict is VIOLATED
    assert never.margin is not None
    assert -0.010 < never.margin < -0.001
    assert FormulaClaim(always(hand_distance() > m(least_m - 0.007))).evaluate(visit).verdict is HOLDS


def test_it_says_of_an_uncertain_hand_what_the_catalogue_says(visit: Trace) -> None:
    least_m = float(visit.ticks["hand_distance_m"].min())
    known = knowing(visit, {"hand_position_in_base_m": within(0.005), "hand_distance_m": within(0.006)})
    for limit_m in (least_m - 0.01, least_m - 0.003, least_m + 0.01):
        own = FormulaClaim(always(hand_distance() > m(limit_m))).evaluate(known)
        assert own.verdict is HandDistance(minimum_m=limit_m, near_m=0.4).evaluate(known).verdict


def test_an_angle_is_not_judged_by_an_uncertain_pose(visit: Trace) -> None:
    found = judged("angle to desired pose < 90 deg", knowing(visit, {"transform_tcp_to_base": within(1e-3)}))
    assert (found.verdict, found.unmeasured) == (INCONCLUSIVE, ("transform_tcp_to_base",))
    assert found.reason == (
        "known only to within an uncertainty: transform_tcp_to_base; "
        "angle to desired pose is not judged by that"
    )


def test_an_occasion_counts_only_if_it_is_certain(visit: Trace) -> None:
    """The hand comes within 400 mm of the arm's surface, by less than it may be off."""
    short_m = 0.4 - float(visit.ticks["hand_distance_m"].min())
    sentence = "eventually (hand distance > 100 mm and repulsing)"
    assert judged(sentence, knowing(visit, {"hand_distance_m": within(short_m * 0.9)})).exercised == 1
    unsure = judged(sentence, knowing(visit, {"hand_distance_m": within(short_m * 1.1)}))
    assert (unsure.verdict, unsure.exercised) == (INCONCLUSIVE, 0)
    assert unsure.unmeasured == ("hand_distance_m",)
    assert "whether it was exercised" in unsure.reason


# --- against the whole run, at random


def random_formula(rng: np.random.Generator, trace: Trace, depth: int = 2) -> Formula:
    """Any operator over any signal that the run has, limits within its values."""
    if depth == 0:
        signal: Signal = SIGNALS[rng.integers(len(SIGNALS))]
        if isinstance(signal, Flag):
            return Truth(signal)
        assert isinstance(signal, Measure)
        value = signal.sample(trace).value
        value = value[np.isfinite(value)]
        limit = float(rng.choice([*np.quantile(value, [0.02, 0.2, 0.98]), 1e-4, 10.0]) if len(value) else 1.0)
        relation = list(Relation)[rng.integers(4)]
        limit = float(np.clip(limit, *signal.limits))
        return Comparison(signal, relation, Quantity(limit, signal.dimension, repr(limit)))
    one, other = (
        random_formula(rng, trace, depth - int(rng.integers(1, 3)) if depth > 1 else 0) for _ in "ab"
    )
    begin = 8 * int(rng.integers(0, 60))
    span = None if rng.random() < 0.4 else Span(ms(begin), ms(begin + 8 * int(rng.integers(1, 120))))
    kinds = (
        lambda: Not(one),
        lambda: conjunction(one, other),
        lambda: disjunction(one, other),
        lambda: Always(one, span),
        lambda: Eventually(one, span),
        lambda: Until(one, other, span),
    )
    return kinds[rng.integers(len(kinds))]()


def random_claim(rng: np.random.Generator, trace: Trace) -> Formula:
    while True:
        formula = random_formula(rng, trace)
        top = rng.random()
        if top < 0.25:
            formula = Globally(formula, random_formula(rng, trace, 1))
        elif top < 0.35:
            formula = Initially(formula)
        try:
            parts_of(formula)
        except FormulaError:  # margins of two kinds
            continue
        return formula


def read_by(formula: Formula) -> list[str]:
    return list(FormulaClaim(formula).reads)


def random_mask(rng: np.random.Generator, trace: Trace, columns: list[str]) -> dict[str, Measurement]:
    """Of a column or two, and of any other: nothing, not always, not of one hand, or not exactly."""
    mask = {}
    for name in {*rng.choice(columns, 2).tolist(), str(rng.choice(COLUMNS_OF_A_TRACE))} if columns else ():
        kind, (first, length) = rng.random(), (int(rng.integers(len(trace.ticks))), int(rng.integers(1, 200)))
        if name.startswith(OF_DECISIONS) or kind < 0.1:
            mask[name] = NOT_MEASURED
        else:
            hands = 2 if name == PRESENCE else len(trace.scenario.hands)
            hand = int(rng.integers(hands)) if name in PER_HAND and hands and rng.random() < 0.5 else None
            mask[name] = gap(first, min(first + length, len(trace.ticks)), hand)
    return mask


def never_denied(found: Evaluation, whole: Evaluation) -> None:
    assert found.verdict in (whole.verdict, INCONCLUSIVE), (found, whole)
    assert found.exercised <= max(whole.exercised, 1)
    if found.verdict is not whole.verdict:
        assert found.unmeasured, found
        assert found.reason.startswith(("not measured: ", "known only to within", "between ")), found


@pytest.mark.parametrize("name", RUNS)
def test_a_mask_of_columns_changes_a_verdict_only_to_inconclusive(name: str) -> None:
    trace, rng = ran(name), np.random.default_rng([SEED, RUNS.index(name)])
    told = {verdict: [0, 0] for verdict in Verdict}
    for _ in range(75):
        part = parts_of(random_claim(rng, trace))[0]
        whole = judge_part(part, trace)
        found = judge_part(part, knowing(trace, random_mask(rng, trace, read_by(part))))
        never_denied(found, whole)
        told[whole.verdict][found.verdict is whole.verdict] += 1
    for verdict in (HOLDS, VIOLATED):  # the test is not empty: masks hide some, and leave some
        assert all(told[verdict]), told


def off(rng: np.random.Generator, values: Any, name: str, by: float) -> None:
    """Every number of a column is off by at most ``by``, a position by its distance."""
    if name == "transform_tcp_to_base":
        values = values[..., :3, 3]
    if values.shape[-1:] == (3,) and "spread" not in name:
        way = rng.normal(size=values.shape)
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        values += way * by * rng.uniform(0.0, 0.999, (*values.shape[:-1], 1))
    else:
        values += rng.choice([-0.999, 0.0, 0.999], values.shape) * by


def uncertain(rng: np.random.Generator, trace: Trace, columns: list[str]) -> Trace:
    """The run as sensors have it that say how far they may be off."""
    ticks, decisions, known = trace.ticks.copy(), trace.decisions.copy(), {}
    for name in columns:
        record, field = (decisions, DECISION) if name.startswith(OF_DECISIONS) else (ticks, TICK)
        column = name.removeprefix(OF_DECISIONS)
        if field[column].base.kind != "f" or rng.random() < 0.4:
            continue
        known[name] = within(10.0 ** rng.uniform(-6, -1.5))
        before = record[column].copy()
        off(rng, record[column], name, known[name].uncertainty)
        if name in ("tcp_speed_mps", "sse", "predicted_distance_m", "decision.proposed_spread_m"):
            low = np.abs(record[column]) < known[name].uncertainty  # no sensor says less than nothing
            record[column][low] = before[low]
    return knowing(replace(trace, ticks=ticks, decisions=decisions), known)


@pytest.mark.parametrize("name", RUNS)
def test_within_the_uncertainty_the_verdict_is_never_the_opposite_of_the_truth(name: str) -> None:
    trace, rng = ran(name), np.random.default_rng([SEED, 9, RUNS.index(name)])
    decided = 0
    for _ in range(75):
        part = parts_of(random_claim(rng, trace))[0]
        sensed = uncertain(rng, trace, read_by(part))
        truth, found = judge_part(part, trace), judge_part(part, sensed)
        assert {truth.verdict, found.verdict} != {HOLDS, VIOLATED}, (truth, found, sensed.known)
        decided += found.verdict is not INCONCLUSIVE and not sensed.known.whole
    assert decided > 5


@pytest.mark.parametrize("name", RUNS)
def test_the_true_signal_lies_within_the_bounds_of_the_measured_one(name: str) -> None:
    trace, rng = ran(name), np.random.default_rng([SEED, 10, RUNS.index(name)])
    for signal in (one for one in SIGNALS if one.off is not None):
        if signal.sample(trace).absent:
            continue
        for _ in range(5):
            sensed = uncertain(rng, trace, list(signal.reads))
            true, measured = signal.sample(trace), as_known(signal, signal.sample(sensed), sensed)
            if measured.absent:  # a hand that heads for a TCP that is not known exactly
                assert "transform_tcp_to_base" in sensed.known.columns
                continue
            if measured.value_low is None or measured.value_high is None:
                continue  # nothing was off
            near = RESOLUTION_M if "hand_position_in_base_m" in signal.reads else 1e-12
            within = (
                (measured.value_low, true.value, measured.value_high),
                (measured.low, true.low, measured.high),
                (measured.low, true.high, measured.high),
            )
            for low, value, high in within:
                known = ~np.isnan(value)
                assert np.all(low[known] <= value[known] + near), signal.words
                assert np.all(value[known] <= high[known] + near), signal.words
