"""A trace: the frozen record of one run, which suffices to judge the run without simulation."""

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
from safety_harness.trace.records import INTERVENTION, filtered_dtype, predicted_dtype
from safety_harness.trace.system import NOT_NOTED, Line, SystemUnderTest

R = TypeVar("R")


def no_interventions() -> NDArray[np.void]:
    """Return an empty array (0,) of INTERVENTION.

    It is used for a run without a shield.
    """
    return np.zeros(0, INTERVENTION)


def not_predicted() -> NDArray[np.void]:
    """Return an empty array (0,) of PREDICTED.

    It is used for a run whose scenario has no predictor.
    """
    return np.zeros(0, predicted_dtype(1))


def not_filtered() -> NDArray[np.void]:
    """Return an empty array (0,) of FILTERED.

    It is used for a run without a safety filter.
    """
    return np.zeros(0, filtered_dtype())


def not_recorded() -> NDArray[np.float64]:
    """Return an empty array (0, 0).

    It replaces the overshoot if the sub-steps of a run were not recorded.
    """
    return np.zeros((0, 0))


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """The software that made a trace; ``source_hash`` covers every Python file of the package.

    ``libraries`` are pairs (name, version). The second entry may also state that the library was not loaded.
    ``files`` are the compiled files of these libraries, as pairs (name, sha256). ``arithmetic`` is the
    version of the functions that computed the numbers (``elementary.ARITHMETIC``). It is 0 in traces of
    earlier versions. ``machine`` is the kind of machine. Comparisons ignore the machine, because it must not
    influence the results.
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
    """The record of one run, with read-only ``ticks`` (n,) and ``decisions`` (m,).

    ``certified`` contains proofs about the decisions, which a user may request after the run. Without such a
    request, it is None. No verdict uses these proofs.

    Args:
        scenario: The scenario of the run.
        ticks: (n,) records of the type ``tick_dtype`` for the scenario's ``hand_slots``. A complete run has
            ``scenario.ticks`` + 1, since it records both ends of the duration. A run that was cut short has
            fewer.
        decisions: (m,) of ``decision_dtype``.
        decision_latency_s: (m,) the wall-clock time of each decision [s]. It is NaN where several decisions
            were made together, without a time for each. The times differ when the run is repeated, so only
            reports use them. The cost in simulated time is in the decision's own record.
        provenance: The software that made the trace.
        ended: "complete", or the reason why the run was cut short. No property takes a shortened run for a
            safe run.
        known: Which columns were measured, and how exactly.
        system: The system under test.
        interventions: (n,) INTERVENTION of the shield at each tick. The array is empty if there is no shield.
        filtered: (n,) FILTERED, the commands that the safety filter received. The array is empty if there is
            no filter.
        predicted: (n,) PREDICTED, the sets of the scenario's predictor. The array is empty if there is no
            predictor.
        overshoot_radps: (n, joints) by how much a joint's speed left the range between its speeds at a tick
            and at the next. An engine records it in its sub-steps. (0, 0) if not recorded.
        answer_s: (k,) the wall-clock time of each answer of a user's controller [s]. It is neither stored nor
            compared, and only reports use it. Empty if answers have no times of their own.

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
    filtered: NDArray[np.void] = field(default_factory=not_filtered)
    predicted: NDArray[np.void] = field(default_factory=not_predicted)
    certified: CertifiedDecisions | None = None
    overshoot_radps: NDArray[np.float64] = field(default_factory=not_recorded)
    answer_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.ticks.setflags(write=False)
        self.decisions.setflags(write=False)
        self.decision_latency_s.setflags(write=False)
        self.interventions.setflags(write=False)
        self.filtered.setflags(write=False)
        self.predicted.setflags(write=False)
        self.overshoot_radps.setflags(write=False)
        self.known.refuse_gaps_beyond(self.ticks, len(self.scenario.hands))

    @property
    def complete(self) -> bool:
        """Whether the run lasted as long as its scenario demands."""
        return self.ended == "complete" and len(self.ticks) == self.scenario.ticks + 1

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(n,) the time of each tick."""
        times: NDArray[np.float64] = self.ticks["time_s"]
        return times


def once_a_trace(function: Callable[[Trace], R]) -> Callable[[Trace], R]:
    """Return ``function`` with a cache that keeps each result as long as its trace exists.

    This is correct because a trace never changes.
    """
    known: WeakKeyDictionary[Trace, R] = WeakKeyDictionary()

    @wraps(function)
    def kept(trace: Trace) -> R:
        try:
            return known[trace]
        except KeyError:
            return known.setdefault(trace, function(trace))

    return kept


def history(trace: Trace, name: str) -> NDArray[Any]:
    """Return a read-only copy of the field ``name`` of the ticks of ``trace``, shape (n, ...).

    The n values of each component are contiguous in memory. Numpy operations on all ticks at once are several
    times faster on this copy than on ``trace.ticks[name]``. Compiled code visits the ticks one by one, and is
    equally fast without a copy.
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
