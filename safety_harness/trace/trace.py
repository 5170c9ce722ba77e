"""A trace: everything that happened in one run, frozen, enough to judge it without simulating."""

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
    """(0,) INTERVENTION: of a run without a shield."""
    return np.zeros(0, INTERVENTION)


def not_recorded() -> NDArray[np.float64]:
    """(0, 0): of a run in which nobody looked at the sub-steps."""
    return np.zeros((0, 0))


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Which software made a trace.  ``source_hash`` covers every Python file of the package.

    ``libraries`` are (name, version) of what was loaded, and say so of what was not; ``files`` are the
    compiled files of theirs (name, sha256).
    """

    package_version: Line
    source_hash: Line
    world: Line
    python: Line
    platform: Line
    libraries: tuple[tuple[Line, Line], ...]
    files: tuple[tuple[Line, Line], ...] = ()  # none in a trace of an earlier version


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """``ticks`` (n,) of the scenario's ``hand_slots``, ``decisions`` (m,) of dtype DECISION, both read-only.

    A run that was cut short has fewer ticks than ``scenario.ticks`` + 1 (both ends of the
    duration are recorded) and ``ended`` says why; no property takes it for a safe one.
    ``decision_latency_s`` (m,) is the wall-clock time that each decision took, NaN for one that was not
    timed since it was made together with others: the one thing here that a repetition does not give
    again, and nothing but reports reads it (by the wall's clock each decision's own record has it).
    ``known`` says which columns were measured, and how well; of a simulated run all are known.
    ``certified`` is what was proven of its decisions afterwards, if anybody asked; no verdict reads it.
    ``system`` is what was tested.  ``interventions`` (n,) INTERVENTION are those of the shield, one a tick;
    empty where the scenario has none.  ``overshoot_radps`` (n, joints) is by how much the joints' speeds left
    those of the two ticks in the sub-steps of an engine, from each tick to the next; (0, joints) where nobody
    recorded it.  ``answer_s`` (k,) is the wall-clock time of each answer of a user's controller: it is not
    stored, nobody compares it, and only reports read it; empty where nobody timed them one by one.
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
    """``function``, whose result is kept as long as the trace is: traces never change."""
    known: WeakKeyDictionary[Trace, R] = WeakKeyDictionary()

    @wraps(function)
    def kept(trace: Trace) -> R:
        try:
            return known[trace]
        except KeyError:
            return known.setdefault(trace, function(trace))

    return kept


def history(trace: Trace, name: str) -> NDArray[Any]:
    """A field (n, ...) of the ticks, read-only, with every component's n values side by side in memory.

    What numpy makes of all ticks at once is several times quicker with it than with ``trace.ticks[name]``.
    Compiled code goes from tick to tick, and is as quick without a copy.
    """
    known = _histories(trace)
    if name not in known:
        known[name] = np.array(trace.ticks[name], order="F")
        known[name].setflags(write=False)
    return known[name]


@once_a_trace
def _histories(_: Trace) -> dict[str, NDArray[Any]]:
    """Those that somebody has asked for."""
    return {}
