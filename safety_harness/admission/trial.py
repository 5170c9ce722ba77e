"""One trial: an admitted scenario in the PyBullet world, judged by its own claims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.perception.detector import BoundingBoxDetector
from safety_harness.properties.base import Evaluation
from safety_harness.properties.consistency import refuse_contradictions
from safety_harness.simulation.pybullet_world import PyBulletWorld
from safety_harness.simulation.simulate import simulate
from safety_harness.trace.trace import Trace


def run_trial(
    admitted: Admitted,
    *,
    detector: BoundingBoxDetector | None = None,
    recorded: Trace | None = None,
    on_tick: Callable[[int], None] | None = None,
) -> Trace:
    """Simulate; the world is closed on every path.

    ``detector`` takes the place of our own in a scenario whose hand sensor has rendered images;
    ``recorded`` is an earlier trace of the same scenario, whose times by the wall's clock count again;
    ``on_tick`` is told the number of ticks done.  NoAnswerError for an avoider that hangs.
    """
    with PyBulletWorld(
        admitted.scenario, admitted.arm, admitted.joint_position_rad, detector=detector
    ) as world:
        trace = simulate(world, admitted.controller(recorded), admitted.scenario, on_tick=on_tick)
    return replace(trace, provenance=replace(trace.provenance, avoider_sha256=admitted.avoider_sha256))


def judge(trace: Trace, *, file: Path | None = None) -> tuple[Evaluation, ...]:
    """Judge a trace by its scenario's claims, in their order.

    Nothing is simulated and no avoider is made: a user's own would be executed.  TraceError, naming
    ``file``, if no run can have written the trace.
    """
    refuse_contradictions(trace, file)
    return tuple(property_of(claim, trace.scenario).evaluate(trace) for claim in trace.scenario.claims)
