"""Every claim declares all columns that it reads, and says nothing of a run in which one was not measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from broken import (
    BROKEN,
    never_answers,
    proposes_far_away,
    sees_no_hand,
    uses_what_it_doubts,
)
from examples import VISIT, hand, run, scenario
from test_catalogue import IDS, OWN, claim, shipped
from test_no_evidence import truncated
from test_unexercised import IDLE

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.base import Evaluation, Property, unreadable
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import columns_read_by
from safety_harness.claims.properties.reaction import GIVES_WAY_TO_TRUE_HAND
from safety_harness.claims.properties.servoing import (
    CONVERGED,
    GAIN_SWITCH,
    GAIN_SWITCH_ITERATIONS,
    GAIN_SWITCH_WITHIN,
)
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.scenario.faults import HandSensorBlind
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import Wait
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    OF_DECISIONS,
    PER_HAND,
    Gap,
    Measurement,
    Source,
)
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing, until

SEED = 20261123
UNDONE = (GAIN_SWITCH, GAIN_SWITCH_WITHIN, GAIN_SWITCH_ITERATIONS, CONVERGED)


@cache
def broken(sentence: str) -> Trace:
    return BROKEN[sentence]()


@cache
def traces_for(entry: CatalogueEntry) -> tuple[Trace, ...]:
    """One that exercises a claim, one that breaks it, some that do neither, one cut short, faults."""
    own = shipped(entry.scenario)
    faulty = ("fault-avoider-late", "fault-avoider-answers-nan", "fault-false-hand", "second-hand")
    return (
        own,
        broken(entry.example),
        truncated(own, 2 * len(own.ticks) // 3),
        *(now.trace() for now in IDLE.values()),
        *(shipped(name) for name in faulty),
        *(make() for make in (never_answers, proposes_far_away, sees_no_hand)),
        untracked(own),
        untracked(uses_what_it_doubts()),
        spoilt(own),
    )


def untracked(trace: Trace) -> Trace:
    """The hands were lost while the avoider was thinking."""
    ticks = trace.ticks.copy()
    ticks["track_valid"][trace.decisions["tick"]] = False
    return replace(trace, ticks=ticks)


def spoilt(trace: Trace) -> Trace:
    """Something is no number in the last tick and in every decision."""
    ticks, decisions = trace.ticks.copy(), trace.decisions.copy()
    ticks["hand_position_in_base_m"][-1] = decisions["joint_position_rad"] = np.nan
    return replace(trace, ticks=ticks, decisions=decisions)


@cache
def cases(entry: CatalogueEntry) -> list[tuple[Property, Trace, Evaluation]]:
    """Each trace, and what is said of it while all of it is known."""
    found = []
    for trace in traces_for(entry):
        prop = property_of(claim(entry), trace.scenario)
        found.append((prop, trace, prop.evaluate(trace)))
    return found


@cache  # of a column of some length: most traces are asked of every claim
def garbage(column: str, shape: tuple[int, ...], kind: str, seed: int) -> Any:
    """No number, or numbers near what is real, or words, as the ``kind`` of the column has it."""
    rng = np.random.default_rng([SEED, seed, *column.encode()])
    if kind == "f":
        return rng.normal(scale=3.0, size=shape) if seed else np.inf
    return "anything" if kind == "U" else rng.integers(0, 2 if kind == "b" else 16 * seed + 2, shape)


def of_garbage(trace: Trace, columns: Iterable[str], seed: int) -> Trace:
    """``columns`` were not measured, and hold anything instead of blanks."""
    unknown = knowing(trace, dict.fromkeys(columns, NOT_MEASURED))
    for records in (unknown.ticks, unknown.decisions):
        records.setflags(write=True)
    for column in columns:
        records = unknown.decisions if column.startswith(OF_DECISIONS) else unknown.ticks
        values = records[column.removeprefix(OF_DECISIONS)]
        values[...] = garbage(column, values.shape, values.dtype.kind, seed)
    for records in (unknown.ticks, unknown.decisions):
        records.setflags(write=False)
    return unknown


def undeclared(prop: Property) -> list[str]:
    return [column for column in COLUMNS_OF_A_TRACE if column not in (columns_read_by(prop) or ())]


def without_words(found: Evaluation) -> Evaluation:
    return replace(found, reason="")


@pytest.mark.parametrize("entry", OWN, ids=IDS)
def test_what_a_claim_does_not_declare_may_hold_anything(entry: CatalogueEntry) -> None:
    """Words on what would have exercised it may be fewer, but have nothing of what was not measured."""
    for prop, trace, whole in cases(entry):
        one, other = (prop.evaluate(of_garbage(trace, undeclared(prop), seed)) for seed in range(2))
        assert one == other
        assert without_words(one) == without_words(whole)


@pytest.mark.parametrize("entry", OWN, ids=IDS)
def test_what_a_claim_declares_and_nobody_measured_makes_it_inconclusive(entry: CatalogueEntry) -> None:
    for prop, trace, whole in cases(entry)[:2]:
        for column in columns_read_by(prop) or ():
            found = prop.evaluate(knowing(trace, {column: NOT_MEASURED}))
            if column in (*PER_HAND, "limits") and found.verdict is whole.verdict:
                continue  # by the hands that were measured, or whether the arm brakes or not
            assert found.verdict is Verdict.INCONCLUSIVE, column
            assert found.unmeasured == (column,), column
            assert found.reason.startswith("not measured: "), column


class Watched(np.ndarray):
    """Records that know which of their fields were asked for."""

    asked: set[str]

    def __array_finalize__(self, other: Any) -> None:
        self.asked = getattr(other, "asked", set())

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            self.asked.add(key)
        found = super().__getitem__(key)
        return found.view(np.ndarray) if isinstance(key, str) else found


@pytest.mark.parametrize("entry", OWN, ids=IDS)
def test_a_claim_touches_no_column_that_it_does_not_declare(entry: CatalogueEntry) -> None:
    """The views of all true motion are made at once, whoever asks for one: they are no reading."""
    for prop, trace, whole in cases(entry):
        known = knowing(trace, dict.fromkeys(undeclared(prop), NOT_MEASURED))
        watched = replace(known, ticks=known.ticks.view(Watched), decisions=known.decisions.view(Watched))
        assert unreadable(watched, ()) == unreadable(trace, ())  # looks at everything, and is not asked again
        true_motion(watched)
        watched.ticks.asked.clear(), watched.decisions.asked.clear()
        assert without_words(prop.evaluate(watched)) == without_words(whole)
        asked = watched.ticks.asked | {f"{OF_DECISIONS}{name}" for name in watched.decisions.asked}
        assert asked - {"time_s"} <= set(columns_read_by(prop) or ())


@pytest.mark.parametrize("entry", UNDONE, ids=[entry.example for entry in UNDONE])
def test_what_later_ticks_may_undo_is_not_said_of_a_part_of_a_run(entry: CatalogueEntry) -> None:
    """Nothing is done, whatever mode is reported; what the arm does at the end could undo it."""
    trace = broken(entry.example)
    prop, end = property_of(claim(entry), trace.scenario), len(trace.ticks)
    ticks = trace.ticks.copy()
    ticks["mode"][-100:] = Mode.REPULSING
    whole = replace(trace, ticks=ticks)
    cut = prop.evaluate(until(whole, end - 100, "cut short"))
    assert (cut.verdict, "cut short" in cut.reason) == (Verdict.INCONCLUSIVE, True)
    assert cut.margin is not None
    assert cut.margin < 0.0
    assert prop.evaluate(whole).verdict is Verdict.VIOLATED
    gap = Measurement(source=Source.LOG, gaps=(Gap(first=end - 100, after=end),))
    found = prop.evaluate(knowing(whole, {"transform_tcp_to_base": gap}))
    assert (found.verdict, found.unmeasured) == (Verdict.INCONCLUSIVE, ("transform_tcp_to_base",))


OTHER = hand(Wait(duration_s=9.0), at=(1.1, 0.9, 0.4), name="left")


def test_what_the_measured_hand_violates_is_violated_whatever_the_other_did() -> None:
    """The right hand comes and is not answered; the left one rests far away."""
    trace = run(replace(scenario(VISIT, OTHER), faults=(HandSensorBlind(),)))
    prop, verdicts = property_of(claim(GIVES_WAY_TO_TRUE_HAND), trace.scenario), []
    assert prop.evaluate(trace).verdict is Verdict.VIOLATED
    for unseen in range(2):
        gap = Measurement(source=Source.SENSOR, gaps=(Gap(first=0, after=len(trace.ticks), hand=unseen),))
        verdicts.append(prop.evaluate(knowing(trace, {"hand_position_in_base_m": gap})).verdict)
    assert verdicts == [Verdict.INCONCLUSIVE, Verdict.VIOLATED]
