"""No claim holds by a value that no run has, whichever column it stands in, nor for want of ticks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import TraceError
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.formula import Comparison, Formula, Relation
from safety_harness.claims.formulas.language import always, eventually, initially, s, stopped, whenever
from safety_harness.claims.formulas.measures import Flag, Measure
from safety_harness.claims.formulas.quantities import Quantity
from safety_harness.claims.formulas.signals import SIGNALS, predicted_hand_distance, tcp_speed
from safety_harness.claims.properties.base import Evaluation, Property
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.signals.signal import Signal
from safety_harness.claims.signals.true_motion import DERIVED
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.records import DECISION, TICK
from safety_harness.trace.trace import Trace

AT = 150  # a tick at which a hand is tracked and the object seen
IMPOSSIBLE = (-np.inf, np.inf, 1e300, -1e300)
NORMS = ("tcp_speed_mps", "sse", "predicted_distance_m", "decision proposed_spread_m")  # never negative
NUMBERS = [n for n in TICK.names or () if TICK[n].base == np.float64 and n != "time_s"]
NUMBERS += [f"decision {n}" for n in DECISION.names or () if DECISION[n].base == np.float64 and n != "time_s"]
ELSEWHERE = ("transform_tcp_to_base 0 3", "transform_tcp_to_base 2 3", "joint_velocity_radps 5")
NUMBERS += ELSEWHERE  # beside the first of each
TRUTH = ("joint_position_rad", *DERIVED, "hand_position_in_base_m", "elbow_position_in_base_m")
Shape = Callable[[Formula], Formula]
SHAPES: dict[str, Shape] = {
    "always": always,
    "always for": lambda one: always(one, window=s(0.008)),
    "eventually": eventually,
    "within": lambda one: eventually(one, window=(s(0.008), s(0.016))),
    "initially": initially,
    "not": lambda one: eventually(~one),
    "until": lambda one: one.until(~one, window=s(0.016)),
    "or": lambda one: always(one | stopped()),
    "whenever": lambda one: whenever(one).then(one),
    "whenever stopped": lambda one: whenever(stopped()).then(one),
}


def with_value(trace: Trace, name: str, value: float) -> Trace:
    """One number of one record is ``value``: the first of a column, or where ``name`` says."""
    of_decision, (column, *where) = name.startswith("decision "), name.removeprefix("decision ").split()
    records = (trace.decisions if of_decision else trace.ticks).copy()
    index = map(int, where or ["0"] * (records[column].ndim - 1))
    records[column][(0 if of_decision else AT, *index)] = value
    return replace(trace, decisions=records) if of_decision else replace(trace, ticks=records)


def same(one: object, other: object) -> bool:
    if isinstance(one, tuple) and isinstance(other, tuple):
        return all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return one == other


def reads(signal: Signal, trace: Trace, name: str) -> bool:
    """Does what the signal is depend on that number?"""
    with np.errstate(invalid="ignore"):
        own, unknown = signal.sample(trace), signal.sample(with_value(trace, name, np.nan))
    return not all(same(getattr(own, part), getattr(unknown, part)) for part in vars(own))


def limits(signal: Measure, trace: Trace) -> Iterator[Formula]:
    """What holds of the signal all the time, and what never does; every other one with the limit itself."""
    one = signal.sample(trace)
    known = one.value[np.isfinite(one.value)]
    least, most = signal.limits
    for k, value in enumerate((least, float(known.min()), float(known.max()), most)):
        for relation in (Relation.BELOW, Relation.AT_LEAST) if k % 2 else (Relation.AT_MOST, Relation.ABOVE):
            yield Comparison(signal, relation, Quantity(value, signal.dimension, f"{value!r}"))


def holds(claim: Property, trace: Trace) -> bool:
    return claim.evaluate(trace).verdict is Verdict.HOLDS


@pytest.mark.parametrize(
    "name",
    [*NUMBERS[:-1], pytest.param(NUMBERS[-1], marks=pytest.mark.long)],  # its first joint is there too
)
def test_no_formula_holds_by_an_impossible_value(name: str, visit: Trace) -> None:
    unknown = with_value(visit, name, np.nan)
    measures = [one for one in SIGNALS if isinstance(one, Measure) and one.words != "elapsed time"]
    for signal in (one for one in measures if reads(one, visit, name)):
        for value in (*IMPOSSIBLE, *([-1.0] if name in NORMS else [])):
            trace = with_value(visit, name, value)
            for atom in limits(signal, visit):
                for shape in SHAPES.values():
                    claim = FormulaClaim(shape(atom))
                    if holds(claim, trace):
                        assert holds(claim, unknown), (claim.sentence, name, value)


@pytest.mark.parametrize("name", NUMBERS)
def test_no_claim_of_the_catalogue_holds_by_an_impossible_value(name: str, visit: Trace) -> None:
    unknown = with_value(visit, name, np.nan)
    for entry in CATALOGUE:
        claim = property_of(Claim(sentence=entry.example, expected=Verdict.HOLDS), visit.scenario)
        if not holds(claim, visit):
            continue
        for value in (*IMPOSSIBLE, *([-1.0] if name in NORMS else [])):
            if holds(claim, with_value(visit, name, value)):
                assert holds(claim, unknown), (entry.example, name, value)


@pytest.mark.parametrize("value", [*IMPOSSIBLE, np.nan, -1.0])
def test_a_trace_with_an_impossible_truth_is_not_judged_at_all(value: float, visit: Trace) -> None:
    judge(visit)
    for name in TRUTH:
        with pytest.raises(TraceError):
            judge(with_value(visit, name, value))


def test_every_signal_that_reads_a_number_is_put_to_this_test(visit: Trace) -> None:
    """Elapsed time is a matter of the ticks' count, and truths are no numbers."""
    read = {signal.words for signal in SIGNALS for n in NUMBERS if reads(signal, visit, n)}
    measures = {signal.words for signal in SIGNALS if isinstance(signal, Measure)}
    assert read == measures - {"elapsed time"}


def test_what_is_impossible_is_said(visit: Trace) -> None:
    claim = FormulaClaim(always(tcp_speed() < tcp_speed_limit()))
    for value, words in ((-np.inf, "tcp_speed_mps at tick 150"), (1e300, "TCP speed 1e+303 mm/s at 1.200 s")):
        evaluation = claim.evaluate(with_value(visit, "tcp_speed_mps", value))
        assert evaluation.verdict is Verdict.INCONCLUSIVE
        assert words in evaluation.reason


def tcp_speed_limit() -> Quantity:
    return Quantity(0.3, tcp_speed.dimension, "300 mm/s")


def test_no_hand_predicted_is_endless_and_a_hand_predicted_is_not(visit: Trace) -> None:
    far = FormulaClaim(
        always(predicted_hand_distance() > Quantity(0.01, predicted_hand_distance.dimension, "10 mm"))
    )
    hidden = with_value(visit, "predicted_distance_m", np.inf)
    assert far.evaluate(visit).verdict is Verdict.HOLDS
    assert far.evaluate(hidden).verdict is Verdict.INCONCLUSIVE
    ticks = hidden.ticks.copy()
    ticks["track_valid"][AT] = False
    assert far.evaluate(replace(hidden, ticks=ticks)).verdict is Verdict.HOLDS


def shortened(trace: Trace, ticks: int, *, complete: bool) -> Trace:
    """The first ``ticks`` of a run, cut short or as the whole of a shorter scenario."""
    made = trace.decisions[trace.decisions["tick"] < ticks]
    scenario = replace(trace.scenario, duration_s=max(ticks - 1, 0) * 0.008) if complete else trace.scenario
    return replace(
        trace,
        scenario=scenario,
        ticks=trace.ticks[:ticks],
        decisions=made,
        decision_latency_s=trace.decision_latency_s[: len(made)],
        ended="complete" if complete else "interrupted by the user",
    )


def honest(evaluation: Evaluation, trace: Trace) -> None:
    assert evaluation.reason
    if evaluation.verdict is not Verdict.INCONCLUSIVE:
        assert evaluation.margin is not None
        assert np.isfinite(evaluation.margin)
        assert evaluation.exercised > 0
    if len(trace.ticks) == 0 or not trace.complete:
        assert evaluation.verdict is not Verdict.HOLDS


@pytest.mark.parametrize("complete", [False, True])
@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_every_signal_under_every_operator_is_judged_on_next_to_no_ticks(
    ticks: int, complete: bool, visit: Trace
) -> None:
    trace = shortened(visit, ticks, complete=complete)
    for signal in SIGNALS:
        atom = next(limits(signal, visit)) if isinstance(signal, Measure) else None
        if isinstance(signal, Flag):
            atom = signal()
        assert atom is not None
        for words, shape in SHAPES.items():
            if complete and words in ("always for", "within", "until"):
                continue  # windows that no run of this scenario has room for are refused
            honest(FormulaClaim(shape(atom)).evaluate(trace), trace)


@pytest.mark.parametrize("complete", [False, True])
@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_every_claim_of_the_catalogue_is_judged_on_next_to_no_ticks(
    ticks: int, complete: bool, visit: Trace
) -> None:
    trace = shortened(visit, ticks, complete=complete)
    for entry in CATALOGUE:
        claim = property_of(Claim(sentence=entry.example, expected=Verdict.HOLDS), visit.scenario)
        honest(claim.evaluate(trace), trace)
