"""Every signal declares the columns that it reads, and a claim on it says nothing without one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.formula import Comparison, Formula, Relation
from safety_harness.claims.formulas.language import always, elapsed_time, eventually, s, whenever
from safety_harness.claims.formulas.measures import Measure
from safety_harness.claims.formulas.quantities import Quantity
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.claims.properties.measured import columns_read_by
from safety_harness.claims.signals.signal import Signal
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    OF_DECISIONS,
    PRESENCE,
    Gap,
    Measurement,
    Source,
)
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

SCENARIOS = Path(__file__).parents[3] / "scenarios"
SEED = 20261123
RUNS = {  # between them every branch of every signal, and for how long
    "between-two-hands": 4.0,
    "hand-follows-the-tcp": 4.0,
    "recorded-handover": 8.0,
    "fault-hand-sensor-late": 4.0,
    "object-lost-and-found": 2.0,
    "servoing-alone": 0.4,
}
WORDS = [signal.words for signal in SIGNALS]
BY_WORDS = {signal.words: signal for signal in SIGNALS}


@cache
def ran(name: str) -> Trace:
    return run_kinematic(admit(replace(read_scenario(SCENARIOS / f"{name}.yaml"), duration_s=RUNS[name])))


def of_garbage(trace: Trace, column: str, seed: int) -> Trace:
    """``column`` was not measured, and holds anything instead of blanks."""
    rng = np.random.default_rng([SEED, seed])
    unknown = knowing(trace, {column: NOT_MEASURED})
    records = unknown.decisions if column.startswith(OF_DECISIONS) else unknown.ticks
    records.setflags(write=True)
    values = records[column.removeprefix(OF_DECISIONS)]
    if values.dtype.kind == "f":
        values[...] = rng.choice([rng.normal(scale=3.0, size=values.shape), np.full(values.shape, np.inf)])
    elif values.dtype.kind == "U":
        values[...] = "anything"
    elif column in (f"{OF_DECISIONS}tick", "decision"):  # which number records
        values[...] = rng.permutation(values)
    else:
        values[...] = rng.integers(0, 2 if values.dtype.kind == "b" else 5, values.shape)
    records.setflags(write=False)
    return unknown


@np.errstate(invalid="ignore", over="ignore")
def says(signal: Signal, trace: Trace) -> list[Any]:
    """All that a signal is, but for words that are told of wholly known traces only."""
    one = signal.sample(trace)
    words = (one.absent.startswith("never exercised"), bool(one.absent), bool(one.untried))
    return [one.value, one.low, one.high, *(one.tried or ()), one.comes, *words]


def same(one: list[Any], other: list[Any]) -> bool:
    pairs = zip(one, other, strict=True)
    return all(np.array_equal(a, b, equal_nan=isinstance(a, np.ndarray)) for a, b in pairs)


@pytest.mark.parametrize("words", WORDS)
def test_a_signal_depends_on_the_columns_that_it_declares_and_on_no_others(words: str) -> None:
    signal, changing = BY_WORDS[words], set()
    for number, name in enumerate(RUNS):
        trace = ran(name)
        whole = says(signal, trace)
        for column in COLUMNS_OF_A_TRACE:
            if column.startswith(OF_DECISIONS) and len(trace.decisions) == 0:
                continue  # and nothing of them to be changed
            if column not in changing and not same(says(signal, of_garbage(trace, column, number)), whole):
                changing.add(column)
    # whether a hand is there is read with all that is of hands: one that is not known to be absent counts
    assert changing | ({PRESENCE} & {*signal.reads}) == {*signal.reads}
    assert (PRESENCE in signal.reads) == any(name.startswith("hand_") for name in signal.reads)


class Watched(np.ndarray):
    """Records that know which of their fields were asked for."""

    asked: set[str]

    def __array_finalize__(self, other: Any) -> None:
        self.asked = getattr(other, "asked", set())

    def copy(self, order: Any = "C") -> Any:
        """Not watched: another trace, of which views of everything are made again."""
        return np.array(self, order=order)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            self.asked.add(key)
        found = super().__getitem__(key)
        return found.view(np.ndarray) if isinstance(key, str) else found


@pytest.mark.parametrize("words", WORDS)
def test_a_signal_touches_no_column_that_it_does_not_declare(words: str) -> None:
    signal = BY_WORDS[words]
    for name in RUNS:
        trace = knowing(ran(name), {"gain": NOT_MEASURED})  # the words of wholly known traces tell of others
        watched = replace(trace, ticks=trace.ticks.view(Watched), decisions=trace.decisions.view(Watched))
        true_motion(watched)  # views of all of it
        watched.ticks.asked.clear(), watched.decisions.asked.clear()
        assert same(says(signal, watched), says(signal, trace))
        asked = watched.ticks.asked | {f"{OF_DECISIONS}{field}" for field in watched.decisions.asked}
        assert asked - {"time_s"} <= {*signal.reads}, name


def atom(signal: Signal, trace: Trace) -> Formula:
    if not isinstance(signal, Measure):
        return signal()  # type: ignore[operator, no-any-return]
    value = signal.sample(trace).value
    value = value[np.isfinite(value)]
    limit = float(np.median(value)) if len(value) else 1.0
    return Comparison(signal, Relation.ABOVE, Quantity(limit, signal.dimension, repr(limit)))


LATER = elapsed_time() > s(1)
SHAPES: dict[str, Callable[[Formula], Formula]] = {
    "always": always,
    "not": lambda one: eventually(~one),
    "or": lambda one: always(one | LATER) if not isinstance(one, Comparison) else always(one | ~one),
    "trigger": lambda one: whenever(one).then(LATER),
    "response": lambda one: whenever(LATER).then(one),
    "until": lambda one: one.until(~one),
}


@pytest.mark.parametrize("words", WORDS)
def test_what_a_claim_reads_and_nobody_measured_makes_it_inconclusive(words: str) -> None:
    trace, signal = ran("between-two-hands"), BY_WORDS[words]
    for shape in SHAPES.values():
        claim = FormulaClaim(shape(atom(signal, trace)))
        assert (columns_read_by(claim) or ()) == signal.reads
        for column in signal.reads:
            found = claim.evaluate(knowing(trace, {column: NOT_MEASURED}))
            assert found.verdict is Verdict.INCONCLUSIVE, (claim.sentence, column)
            assert (found.reason, found.unmeasured) == (f"not measured: {column}", (column,))


@pytest.mark.parametrize("words", [words for words in WORDS if BY_WORDS[words].reads])
def test_what_a_claim_reads_and_was_not_always_measured_is_unknown_there(words: str) -> None:
    trace, signal = ran("between-two-hands"), BY_WORDS[words]
    if signal.sample(trace).absent:
        trace = ran("fault-hand-sensor-late")
    for column in signal.reads:
        if column.startswith(OF_DECISIONS):
            continue
        gap = Measurement(source=Source.LOG, gaps=(Gap(first=0, after=len(trace.ticks)),))
        never = FormulaClaim(always(atom(signal, trace))).evaluate(knowing(trace, {column: gap}))
        assert never.verdict is Verdict.INCONCLUSIVE, column
        assert never.unmeasured == (column,), never
        assert never.reason.startswith(f"not measured: {column}"), never


def test_of_several_parts_each_says_what_it_lacks() -> None:
    trace = ran("between-two-hands")
    claim = FormulaClaim(always(atom(BY_WORDS["TCP height"], trace)) & ~BY_WORDS["stopped"]())  # type: ignore
    assert claim.reads == ("transform_tcp_to_base", "tcp_speed_mps", "mode")
    unknown = knowing(trace, dict.fromkeys(("mode", "tcp_speed_mps"), NOT_MEASURED))
    found = claim.evaluate(unknown)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.unmeasured == ("tcp_speed_mps", "mode")
    stopped = claim.evaluate(knowing(trace, {"tcp_speed_mps": NOT_MEASURED}))
    assert [part.unmeasured for part in stopped.parts] == [("tcp_speed_mps",), ()]
