"""Is a trace one that a run can have written?  What its records say of each other, without the robot.

A hash protects a stored trace against damage; whoever edits one can write the hash anew.  These
checks keep a nonsensical trace from being judged; that a sensible one is true is checked by
repeating the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from safety_harness.scenario.fault_table import TIME_EPS_S
from safety_harness.scenario.faults import AvoiderFault
from safety_harness.scenario.model import MAX_HANDS
from safety_harness.trace.records import DECISION, Check, Limit, Mode, Outcome, Trigger
from safety_harness.trace.trace import Trace, once_a_trace

BOOLEANS = ("hand_present", "object_visible", "track_valid")
LARGEST_CHARACTER, SURROGATES = 0x10FFFF, (0xD800, 0xDFFF)


@dataclass(frozen=True)
class Inconsistency:
    """The first record of a field that no run writes.

    ``what`` is "tick", "decision" or, of the trace as a whole, "trace"; ``index`` counts them from 0.
    """

    field: str
    what: str
    index: int
    expected: str
    got: str

    @property
    def where(self) -> str:
        """Field and record, as errors name them."""
        return self.field if self.what == "trace" else f"{self.field} at {self.what} {self.index}"

    def __str__(self) -> str:
        return f"{self.where}: expected {self.expected}, got {self.got}"


@once_a_trace
def first_inconsistency(trace: Trace) -> Inconsistency | None:
    """The first thing in ``trace`` that contradicts its scenario or itself, or None."""
    checks: tuple[Callable[[Trace], Iterator[Inconsistency]], ...] = (_length, _decisions, _ticks)
    return next((found for check in checks for found in check(trace)), None)


def at_first(
    wrong: NDArray[np.bool_], field: str, what: str, expected: str, values: NDArray[np.generic]
) -> Iterator[Inconsistency]:
    """The first record (n, ...) in which anything is ``wrong``, with the value that stands there."""
    if wrong.any():
        index = int(np.argmax(wrong.any(axis=tuple(range(1, wrong.ndim)))))
        yield Inconsistency(field, what, index, expected, " ".join(str(values[index]).split()))


def _length(trace: Trace) -> Iterator[Inconsistency]:
    """A complete run has every tick of its scenario, one that was cut short not more."""
    most, found = trace.scenario.ticks + 1, len(trace.ticks)
    if found > most or (trace.ended == "complete" and found < most):
        amount = f"{most} of them" if trace.ended == "complete" else f"at most {most} of them"
        yield Inconsistency("ticks", "trace", found, amount, str(found))


def _ticks(trace: Trace) -> Iterator[Inconsistency]:
    ticks, count = trace.ticks, len(trace.ticks)
    time_s = np.arange(count) * trace.scenario.settings.clock.control_period_s
    yield from at_first(ticks["time_s"] != time_s, "time_s", "tick", "tick times the period", ticks["time_s"])
    for name in BOOLEANS:
        raw = np.ascontiguousarray(ticks[name]).view(np.uint8)
        yield from at_first(raw > 1, name, "tick", "0 or 1", raw)
    present = np.broadcast_to(np.arange(MAX_HANDS) < len(trace.scenario.hands), ticks["hand_present"].shape)
    hands = f"the {len(trace.scenario.hands)} hands of the scenario"
    yield from at_first(
        ticks["hand_present"] != present, "hand_present", "tick", hands, ticks["hand_present"]
    )
    capsule = ticks["hand_distance_capsule"]
    yield from at_first(
        (capsule < 0) == present, "hand_distance_capsule", "tick", "a part for each hand, else -1", capsule
    )
    yield from at_first(ticks["sse"] < 0.0, "sse", "tick", "a sum of squares", ticks["sse"])
    yield from _enumerated(ticks["mode"], "mode", "tick", Mode)
    yield from _flags(ticks["limits"], "limits", "tick", Limit)
    yield from _faults(trace)
    made = np.full(count, -1)
    known = (trace.decisions["tick"] >= 0) & (trace.decisions["tick"] < count)
    made[trace.decisions["tick"][known]] = np.flatnonzero(known)
    number = ticks["decision"]
    expected = "the number of the decision made then, else -1"
    yield from at_first(number != made, "decision", "tick", expected, number)


def _decisions(trace: Trace) -> Iterator[Inconsistency]:
    decisions, count = trace.decisions, len(trace.ticks)
    if len(decisions) == 0:
        return
    tick = decisions["tick"]
    wrong = (tick < 0) | (tick >= count)
    yield from at_first(wrong, "tick", "decision", f"one of {count} ticks", tick)
    wrong[1:] |= np.diff(tick) <= 0
    yield from at_first(wrong, "tick", "decision", "a later tick than the decision before", tick)
    time_s = decisions["time_s"]
    at_tick = trace.ticks["time_s"][np.clip(tick, 0, count - 1)] if count else time_s
    yield from at_first(time_s != at_tick, "time_s", "decision", "the time of its tick", time_s)
    yield from _enumerated(decisions["trigger"], "trigger", "decision", Trigger)
    yield from _enumerated(decisions["outcome"], "outcome", "decision", Outcome)
    for name in ("proposed_failed", "opposite_failed"):
        yield from _flags(decisions[name], name, "decision", Check)
    for name in (name for name in DECISION.names or () if DECISION[name].kind == "U"):
        letters = np.ascontiguousarray(decisions[name]).view(np.uint32)
        letters = letters.reshape(len(decisions), DECISION[name].itemsize // 4)
        low, high = SURROGATES
        no_text = (letters > LARGEST_CHARACTER) | ((letters >= low) & (letters <= high))
        yield from at_first(no_text, name, "decision", "text", np.full(len(decisions), "no characters"))


def _faults(trace: Trace) -> Iterator[Inconsistency]:
    """A fault acts within its time; a late avoider keeps the controller waiting until the deadline."""
    scenario, faults = trace.scenario, trace.ticks["faults"]
    time_s, wait_s = trace.ticks["time_s"], scenario.settings.avoidance.decision_deadline_s
    possible = np.zeros(len(faults), np.int64)
    for k, fault in enumerate(scenario.faults):
        end_s = fault.end_s + (wait_s + scenario.settings.clock.control_period_s) * isinstance(
            fault, AvoiderFault
        )
        possible[(time_s >= fault.from_s - TIME_EPS_S) & (time_s < end_s)] |= 1 << k
    yield from at_first((faults & ~possible) != 0, "faults", "tick", "faults of that time", faults)


def _enumerated(
    values: NDArray[np.int64], field: str, what: str, members: type[IntEnum]
) -> Iterator[Inconsistency]:
    codes = [int(member) for member in members]
    wrong = np.ones(len(values), np.bool_)
    for code in codes:
        wrong &= values != code
    yield from at_first(wrong, field, what, f"one of {codes}", values)


def _flags(
    values: NDArray[np.int64], field: str, what: str, members: type[IntFlag]
) -> Iterator[Inconsistency]:
    every = reduce(or_, (int(member) for member in members))
    yield from at_first((values & ~every) != 0, field, what, f"flags within {every}", values)
