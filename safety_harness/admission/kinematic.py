"""Trials in the kinematic world: one with any controller, or a great many with our own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from safety_harness.admission.admit import Admitted
from safety_harness.avoidance.asking import OutOfProcessAvoider
from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.batches import takes_many
from safety_harness.controller.controller import Controller
from safety_harness.exceptions import InadmissibleError
from safety_harness.scenario.decision_times import refuse_wall_clock
from safety_harness.simulation.kinematic_world import KinematicWorld
from safety_harness.simulation.simulate import simulate
from safety_harness.simulation.simulate_many import Episode, simulate_many
from safety_harness.trace.trace import Trace

TICKS_AT_ONCE = 32_768  # of all episodes under way together: some 24 MB of trace


def run_kinematic(
    admitted: Admitted,
    *,
    controller: Controller | None = None,
    recorded: Trace | None = None,
    on_tick: Callable[[int], None] | None = None,
) -> Trace:
    """One scenario in the kinematic world, tick by tick: the slower loop, which takes any ``controller``.

    ``recorded`` and ``on_tick`` are as in ``run_trial``.  InadmissibleError for a scenario with rendered
    images.
    """
    world = KinematicWorld(admitted.scenario, admitted.arm, admitted.joint_position_rad)
    trace = simulate(world, controller or admitted.controller(recorded), admitted.scenario, on_tick=on_tick)
    return replace(trace, provenance=replace(trace.provenance, avoider_sha256=admitted.avoider_sha256))


def run_many(scenarios: Iterable[Admitted], *, ticks_at_once: int = TICKS_AT_ONCE) -> Iterator[Trace]:
    """Every scenario with our own controller, in the order given; the traces are those of ``run_kinematic``.

    Episodes run in chunks of ``ticks_at_once`` ticks, one of them at least, which bounds the memory as
    long as the caller lets go of the traces.  Within a chunk all go to their next decision together; an
    avoider with ``propose_many`` is then asked once for all, others in turn.  NoAnswerError for one that
    hangs; InadmissibleError for a scenario by the wall's clock, which is for the slower loop.
    """
    chunk: list[Admitted] = []
    ticks = 0
    for admitted in scenarios:
        refuse_wall_clock(admitted.scenario, InadmissibleError, whose="these runs")
        if chunk and ticks + admitted.scenario.ticks + 1 > ticks_at_once:
            yield from _run_chunk(chunk)
            chunk, ticks = [], 0
        chunk.append(admitted)
        ticks += admitted.scenario.ticks + 1
    yield from _run_chunk(chunk)


def slower_because(avoider: Avoider) -> str:
    """What keeps ``run_many`` from asking an avoider for all decisions at once; empty if nothing does."""
    if avoider.takes_many if isinstance(avoider, OutOfProcessAvoider) else takes_many(avoider):
        return ""
    return f"{avoider.name} is asked for one decision after another: it has no propose_many"


def _run_chunk(chunk: list[Admitted]) -> Iterator[Trace]:
    traces = simulate_many(
        [
            Episode(
                one.scenario, KinematicWorld(one.scenario, one.arm, one.joint_position_rad), one.controller()
            )
            for one in chunk
        ]
    )
    traces.reverse()
    for one in chunk:
        trace = traces.pop()  # what the caller has let go of is not kept for the others' sake
        if one.avoider_sha256:
            trace = replace(trace, provenance=replace(trace.provenance, avoider_sha256=one.avoider_sha256))
        yield trace
