"""A trace: the frozen record of one run, enough to judge it without simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from safety_harness.scenario.model import Scenario
from safety_harness.trace.certified import CertifiedDecisions
from safety_harness.trace.known import WHOLLY_KNOWN, Knowledge
from safety_harness.trace.records import INTERVENTION
from safety_harness.trace.system import NOT_NOTED, Line, SystemUnderTest

R = TypeVar("R")


def no_interventions() -> NDArray[np.void]:
    """Return the (0,) INTERVENTION of a run without a shield."""
    return np.zeros(0, INTERVENTION)


def not_recorded() -> NDArray[np.float64]:
    """Return the (0, 0) overshoot of a run whose sub-steps were not recorded."""
    return np.zeros((0, 0))


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """The software that made a trace. ``source_hash`` covers every Python file of the package.

    ``libraries`` are (name, version) pairs, which also state that a library was not loaded. ``files`` are the
    compiled files of these libraries (name, sha256). ``arithmetic`` is the version of the functions that made
    its numbers, ``elementary.ARITHMETIC``; 0 in a trace of an earlier version. ``machine`` is the kind of
    machine, which must not matter: it takes no part in a comparison.
    """

    package_version: Line
    source_hash: Line
    world: Line
    python: Line
    platform: Line
    libraries: tuple[tuple[Line, Line], ...]
    files: tuple[tuple[Line, Line], ...] = ()  # none in a trace of an earlier version
    arithmetic: int = 0
    machine: Line = field(default="", compare=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """The record of one run: ``ticks`` (n,) and ``decisions`` (m,), both read-only.

    ``certified`` has proofs about its decisions that a user requested afterwards, or is None. No verdict
    reads it.

    Args:
        scenario: The scenario of the run.
        ticks: (n,) of ``tick_dtype`` for the scenario's ``hand_slots``. A complete run has ``scenario.ticks``
            + 1, since it records both ends of the duration. A run that was cut short has fewer.
        decisions: (m,) of ``decision_dtype``.
        decision_latency_s: (m,) the wall-clock time of each decision [s]. NaN where several decisions were
            made together, without a time for each. A repetition gives other times, so only reports read it.
            The cost in simulated time is in the decision's own record.
        provenance: The software that made the trace.
        ended: "complete", or the reason why the run was cut short. No property takes a shortened run for a
            safe run.
        known: The columns that were measured, and how well.
        system: The system under test.
        interventions: (n,) INTERVENTION of the shield, one a tick; empty without a shield.
        overshoot_radps: (n, joints) by how much the joints' speeds left the speeds of the two ticks, in an
            engine's sub-steps from each tick to the next. (0, 0) if not recorded.
        answer_s: (k,) the wall-clock time of each answer of a user's controller [s]. It is not stored or
            compared, and only reports read it. Empty where answers have no time of their own.

    """

    scenario: Scenario
    ticks: NDArray[np.void]
    decisions: NDArray[np.void]
    decision_latency_s: NDArray[np.float64]
    provenance: Provenance
    ended: str = "complete"
    known: Knowledge = WHOLLY_KNOWN
    system: SystemUnderTest = NOT_NOTED
    interventions: NDArray[np.void] = field(default_factory=no_interventions)
    certified: CertifiedDecisions | None = None
    overshoot_radps: NDArray[np.float64] = field(default_factory=not_recorded)
    answer_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.ticks.setflags(write=False)
        self.decisions.setflags(write=False)
        self.decision_latency_s.setflags(write=False)
        self.interventions.setflags(write=False)
        self.overshoot_radps.setflags(write=False)
        self.known.refuse_gaps_beyond(self.ticks, len(self.scenario.hands))

    @property
    def complete(self) -> bool:
        """Did the run last as long as its scenario says?"""
        return self.ended == "complete" and len(self.ticks) == self.scenario.ticks + 1

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(n,) the time of each tick."""
        times: NDArray[np.float64] = self.ticks["time_s"]
        return times


def once_a_trace(function: Callable[[Trace], R]) -> Callable[[Trace], R]:
    """Return ``function`` with a cache that keeps each result as long as its trace: traces never change."""
    known: WeakKeyDictionary[Trace, R] = WeakKeyDictionary()

    @wraps(function)
    def kept(trace: Trace) -> R:
        try:
            return known[trace]
        except KeyError:
            return known.setdefault(trace, function(trace))

    return kept


def history(trace: Trace, name: str) -> NDArray[Any]:
    """Return a field (n, ...) of the ticks, read-only, with each component's n values contiguous in memory.

    Numpy operations over all ticks at once are several times quicker on it than on ``trace.ticks[name]``.
    Compiled code goes from tick to tick, and is as quick without a copy.
    """
    known = _histories(trace)
    if name not in known:
        known[name] = np.array(trace.ticks[name], order="F")
        known[name].setflags(write=False)
    return known[name]


@once_a_trace
def _histories(_: Trace) -> dict[str, NDArray[Any]]:
    """Return the fields of the trace that ``history`` has copied so far."""
    return {}
