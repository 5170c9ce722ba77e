"""Checks of a trace's records against each other.

They find out, without a robot, whether a run can have written the records. A hash protects a stored trace
against damage, but an editor of the file can write a new hash. These checks refuse a nonsensical trace before
any verdict. Only a repetition of the run shows whether a sensible trace is true.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.scenario.fault_table import TIME_EPS_S
from safety_harness.scenario.faults import AvoiderFault, Fault
from safety_harness.scenario.model import Scenario
from safety_harness.trace.known import OF_DECISIONS, Knowledge
from safety_harness.trace.records import DECISION, Check, DecisionOutcome, Limit, Mode, Trigger, as_compiled
from safety_harness.trace.trace import Trace, once_a_trace

BOOLEANS, A_FLAG = ("hand_present", "object_visible", "track_valid"), "0 or 1"
MODES = tuple(int(mode) for mode in Mode)
LIMITS, FAILURES = (reduce(or_, (int(flag) for flag in flags)) for flags in (Limit, Check))  # all of them
CHECKS = 13  # of the ticks
COMPARED = {  # columns that are checked by others
    "predicted_distance_m": ("track_valid", "predicted_hand_in_base_m"),
    "decision": ("decision.tick",),
    "decision.time_s": ("decision.tick",),
    "decision.asked_tick": ("decision.tick",),
    "decision.decision_time_s": ("decision.tick", "decision.asked_tick"),
}
# Unicode's last code point, and its surrogates, which no text file can contain.
LARGEST_CHARACTER, SURROGATES = 0x10FFFF, (0xD800, 0xDFFF)


@dataclass(frozen=True)
class Inconsistency:
    """The first record with an impossible value of ``field``.

    No run can have written such a value. ``what`` is "tick" or "decision" for a record, and "trace" for the
    whole trace. ``index`` is the record's index, counted from 0.
    """

    field: str
    what: str
    index: int
    expected: str
    got: str

    @property
    def where(self) -> str:
        """The field and the record, in the form in which an error states them."""
        return self.field if self.what == "trace" else f"{self.field} at {self.what} {self.index}"

    def __str__(self) -> str:
        return f"{self.where}: expected {self.expected}, got {self.got}"


@once_a_trace
def first_inconsistency(trace: Trace) -> Inconsistency | None:
    """Return the first contradiction of ``trace`` with its scenario or with itself, or None."""
    checks: tuple[Callable[[Trace], Iterator[Inconsistency]], ...] = (
        _length,
        _decisions,
        _ticks,
        _interventions,
        _filtered,
        _predicted,
    )
    flaws = (flaw for check in checks for flaw in check(trace))
    return next((flaw for flaw in flaws if _is_known(trace.known, flaw)), None)


def _is_known(known: Knowledge, flaw: Inconsistency) -> bool:
    """Return whether the wrong field was measured until the tick of ``flaw``.

    The columns with which this field is compared must also have been measured until then. For a decision, it
    is sufficient that the columns are in the trace.
    """
    name = OF_DECISIONS * (flaw.what == "decision") + flaw.field
    names = (name, *COMPARED.get(name, ()))
    gap = known.first_gap(names)
    return not known.missing(names) and (flaw.what != "tick" or gap is None or flaw.index < gap.first)


def at_first(
    bad: NDArray[np.bool_], field: str, kind: str, expected: str, values: NDArray[np.generic]
) -> Iterator[Inconsistency]:
    """Yield an inconsistency for the first record with a ``bad`` element, and the record's value.

    Args:
        bad: True for a wrong element (n, ...).
        field: The field that the error states.
        kind: The kind of record: "tick", "decision" or "trace".
        expected: The expectation that the error states.
        values: The values (n, ...) of the field.

    """
    if bad.any():
        index = int(np.argmax(bad.any(axis=tuple(range(1, bad.ndim)))))
        yield Inconsistency(field, kind, index, expected, " ".join(str(values[index]).split()))


def _length(trace: Trace) -> Iterator[Inconsistency]:
    """Check the number of ticks.

    A complete run must have exactly the ticks of its scenario, and a shorter run must not have more.
    """
    most, count = trace.scenario.ticks + 1, len(trace.ticks)
    if count > most or (trace.ended == "complete" and count < most):
        amount = f"{most} of them" if trace.ended == "complete" else f"at most {most} of them"
        yield Inconsistency("ticks", "trace", count, amount, str(count))


def _ticks(trace: Trace) -> Iterator[Inconsistency]:
    scenario, ticks = trace.scenario, trace.ticks
    first = _first_wrong(
        as_compiled(ticks),
        ticks["object_visible"].view(np.uint8),
        np.array(trace.decisions["tick"]),  # a view's type for numba depends on its length
        scenario.settings.clock.control_period_s,
        len(scenario.hands),
        limits := LIMITS
        & ~(int(Limit.SHIELD) * (scenario.shield is None))
        & ~(int(Limit.SAFETY_FILTER) * (not scenario.safety_filter)),
        np.array([_times_s(scenario, fault) for fault in scenario.faults]).reshape(-1, 2),
    )
    if first.min() >= len(ticks):
        return
    checks = (  # in the order of ``_first_wrong``
        ("time_s", "tick times the period"),
        *((name, A_FLAG) for name in BOOLEANS),
        ("hand_present", f"the {len(scenario.hands)} hands of the scenario"),
        ("hand_distance_capsule", "a part for each hand, else -1"),
        ("tcp_speed_mps", "a speed, which is never negative"),
        ("sse", "a sum of squares"),
        ("predicted_distance_m", "the distance of a hand that is predicted"),
        ("mode", f"one of {list(MODES)}"),
        ("limits", f"flags within {limits}"),
        ("faults", "faults of that time"),
        ("decision", "the number of the decision made then, else -1"),
    )
    for (field, expected), index in zip(checks, first.tolist(), strict=True):
        if index < len(ticks):
            values = ticks[field].view(np.uint8) if expected == A_FLAG else ticks[field]
            yield Inconsistency(field, "tick", index, expected, " ".join(str(values[index]).split()))


def _interventions(trace: Trace) -> Iterator[Inconsistency]:
    """Check that a shield's speed fraction is from 0 to 1, and below 1 exactly where its flag is set."""
    done, ticks = trace.interventions, trace.ticks
    if trace.scenario.shield is None or trace.known.missing(["limits"]):
        return
    if len(done) != len(ticks):
        yield Inconsistency(
            "limits", "trace", len(done), f"interventions of {len(ticks)} ticks", str(len(done))
        )
        return
    flagged, scale = ticks["limits"] & int(Limit.SHIELD) != 0, done["scale"]
    bad = ((scale < 1.0) != flagged) | ~((scale >= 0.0) & (scale <= 1.0))
    yield from at_first(bad, "limits", "tick", "the flag SHIELD where the shield scaled", ticks["limits"])


def _filtered(trace: Trace) -> Iterator[Inconsistency]:
    """Check that the flag of the safety filter is set at each tick whose command it changed."""
    wanted, ticks = trace.filtered, trace.ticks
    if not trace.scenario.safety_filter or trace.known.missing(["limits"]):
        return
    if len(wanted) != len(ticks):
        yield Inconsistency(
            "limits", "trace", len(wanted), f"wanted commands of {len(ticks)} ticks", str(len(wanted))
        )
        return
    flagged = ticks["limits"] & int(Limit.SAFETY_FILTER) != 0
    changed = (wanted["wanted_radps"] != ticks["demanded_joint_velocity_radps"]).any(axis=1)
    expected = "the flag SAFETY_FILTER where the safety filter changed the command"
    yield from at_first(changed & ~flagged, "limits", "tick", expected, ticks["limits"])


def _predicted(trace: Trace) -> Iterator[Inconsistency]:
    """Check that each predicted hand has a set whose matrix is symmetric and positive definite."""
    if not trace.scenario.predictor or trace.known.missing(["track_valid"]):
        return
    sets, there = trace.predicted, trace.ticks["track_valid"]
    if len(sets) != len(there):
        yield Inconsistency("track_valid", "trace", len(sets), f"sets of {len(there)} ticks", str(len(sets)))
        return
    bad = np.asarray((there & ~are_positive_definite(sets["shape_m2"])).any(axis=1))
    yield from at_first(bad, "track_valid", "tick", "a set for each hand", there)


def are_positive_definite(shapes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask (...) of the ``shapes`` (..., 3, 3) that are finite, symmetric and positive definite.

    The test is Sylvester's criterion, which requires that the leading minors are positive; these minors have
    the same bits on each machine.
    """
    s = np.moveaxis(shapes, (-2, -1), (0, 1))
    with np.errstate(all="ignore"):  # a stored trace may have any numbers
        second = s[0, 0] * s[1, 1] - s[0, 1] * s[0, 1]
        third = (
            s[2, 2] * second
            - s[1, 2] * (s[0, 0] * s[1, 2] - s[0, 1] * s[0, 2])
            + s[0, 2] * (s[0, 1] * s[1, 2] - s[0, 2] * s[1, 1])
        )
    symmetric = (s == s.swapaxes(0, 1)).all(axis=(0, 1))
    return np.asarray(symmetric & np.isfinite(third) & (s[0, 0] > 0.0) & (second > 0.0) & (third > 0.0))


def _times_s(scenario: Scenario, fault: Fault) -> tuple[float, float]:
    """Return the begin and the end of the time in which a fault may have an effect.

    A fault of the avoider may act until the decision deadline after its end.
    """
    settings = scenario.settings
    wait_s = settings.avoidance.decision_deadline_s + settings.clock.control_period_s
    return fault.from_s - TIME_EPS_S, fault.end_s + wait_s * isinstance(fault, AvoiderFault)


@compiled
def _first_wrong(
    ticks: NDArray[np.void],  # (n,) ticks ``as_compiled``
    visible: NDArray[np.uint8],  # (n,) ``object_visible``, as its bytes are
    decided: NDArray[np.int64],  # (m,) ticks of the decisions
    period_s: float,
    hands: int,
    limits: int,  # the flags that there can be
    fault_times_s: NDArray[np.float64],  # (f, 2) from and until when each may act
) -> NDArray[np.int64]:
    """Return the first tick that fails each check, shape (13,).

    If no tick fails a check, the entry of this check is n.
    """
    n = ticks.shape[0]
    first = np.full(CHECKS, n)
    made = np.full(n, -1)
    for number in range(decided.shape[0]):
        if 0 <= decided[number] < n:
            made[decided[number]] = number
    # Backwards, so that the entry of each check ends at its first wrong tick.
    for k in range(n - 1, -1, -1):
        tick, possible = ticks[k], 0
        for fault in range(fault_times_s.shape[0]):
            acts = (tick.time_s >= fault_times_s[fault, 0]) & (tick.time_s < fault_times_s[fault, 1])
            possible |= int(acts) << fault
        flaws = int(tick.time_s != k * period_s) | (int(visible[k] > 1) << 2)  # a bit for each check
        for hand in range(tick.hand_present.shape[0]):
            there = hand < hands
            flaws |= int(tick.hand_present[hand] > 1) << 1
            flaws |= int((tick.hand_present[hand] != 0) != there) << 4
            flaws |= int((tick.hand_distance_capsule[hand] < 0) == there) << 5
        for track in range(tick.track_valid.shape[0]):
            flaws |= int(tick.track_valid[track] > 1) << 3
            at = tick.predicted_hand_in_base_m[track]
            somewhere = tick.track_valid[track] != 0 and abs(at[0]) + abs(at[1]) + abs(at[2]) < np.inf
            flaws |= int(somewhere and tick.predicted_distance_m == np.inf) << 8
        flaws |= int(tick.tcp_speed_mps < 0.0) << 6
        flaws |= int(tick.sse < 0.0) << 7
        flaws |= int(tick.predicted_distance_m < 0.0) << 8
        flaws |= int(tick.mode not in MODES) << 9
        flaws |= int(tick.limits & ~limits != 0) << 10
        flaws |= int(tick.faults & ~possible != 0) << 11
        flaws |= int(tick.decision != made[k]) << 12
        if flaws != 0:
            for check in range(CHECKS):
                if (flaws >> check) & 1:
                    first[check] = k
    return first


def _decisions(trace: Trace) -> Iterator[Inconsistency]:
    decisions, count = trace.decisions, len(trace.ticks)
    if len(decisions) == 0:
        return
    tick = decisions["tick"]
    bad = (tick < 0) | (tick >= count)
    yield from at_first(bad, "tick", "decision", f"one of {count} ticks", tick)
    bad[1:] |= np.diff(tick) <= 0
    yield from at_first(bad, "tick", "decision", "a later tick than the decision before", tick)
    time_s = decisions["time_s"]
    at_tick = trace.ticks["time_s"][np.clip(tick, 0, count - 1)] if count else time_s
    yield from at_first(time_s != at_tick, "time_s", "decision", "the time of its tick", time_s)
    yield from _costs(trace)
    for name, members in (("trigger", Trigger), ("outcome", DecisionOutcome)):
        codes = [int(member) for member in members]
        values = decisions[name]
        yield from at_first(
            (values[:, None] != codes).all(axis=1), name, "decision", f"one of {codes}", values
        )
    spread_m = decisions["proposed_spread_m"]
    no_spread = (spread_m < 0.0) | np.isinf(spread_m)  # NaN: none was given
    yield from at_first(no_spread, "proposed_spread_m", "decision", "a spread, which is finite", spread_m)
    for name in ("proposed_failed", "opposite_failed"):
        failed = decisions[name]
        yield from at_first((failed & ~FAILURES) != 0, name, "decision", f"flags within {FAILURES}", failed)
    for name in (name for name in DECISION.names or () if DECISION[name].kind == "U"):
        letters = np.ascontiguousarray(decisions[name]).view(np.uint32)
        letters = letters.reshape(len(decisions), DECISION[name].itemsize // 4)
        low, high = SURROGATES
        no_text = (letters > LARGEST_CHARACTER) | ((letters >= low) & (letters <= high))
        yield from at_first(no_text, name, "decision", "text", np.full(len(decisions), "no characters"))


def _costs(trace: Trace) -> Iterator[Inconsistency]:
    """Check that each question comes after the previous decision, and that each answer is on time.

    An answer must come at the end of its decision time or at the deadline, whichever is earlier. If a fault
    delays answers, an answer may come later.
    """
    decisions, settings = trace.decisions, trace.scenario.settings
    tick, question, cost_s = (decisions[name] for name in ("tick", "asked_tick", "decision_time_s"))
    bad = (question > tick) | (question <= np.concatenate([[-1], tick[:-1]]))
    yield from at_first(bad, "asked_tick", "decision", "a tick after the decision before", question)
    bad = ~((cost_s >= 0.0) & (cost_s < np.inf))
    yield from at_first(bad, "decision_time_s", "decision", "a time", cost_s)
    least_s = np.minimum(cost_s, settings.avoidance.decision_deadline_s)
    waits = np.ceil(least_s / settings.clock.control_period_s - 1e-9)
    delayed = any(isinstance(fault, AvoiderFault) for fault in trace.scenario.faults)
    bad = tick - question < waits if delayed else tick - question != waits
    yield from at_first(bad, "decision_time_s", "decision", "the ticks from question to answer", cost_s)
