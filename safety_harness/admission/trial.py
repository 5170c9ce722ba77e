"""Trials: admitted scenarios in a world, one with any controller or many with our own; and judging."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import cast

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import (
    ControllerError,
    InadmissibleError,
    InstallationError,
    refuse_other_type,
)
from safety_harness.cell.avoidance.asking import OutOfProcessAvoider, takes_many
from safety_harness.cell.avoidance.avoider import Avoider, shown_to
from safety_harness.cell.controller.controller import Controller
from safety_harness.cell.perception.detector import BoundingBoxDetector
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.simulate import Episode, simulate, simulate_driven, simulate_many
from safety_harness.cell.simulation.world import BatchWorld
from safety_harness.cell.simulation.worlds import KINEMATIC, REFERENCE, WorldEntry
from safety_harness.claims.properties.base import Evaluations
from safety_harness.claims.signals.true_motion import refuse_contradictions
from safety_harness.scenario.decision_times import refuse_wall_clock
from safety_harness.trace.trace import Trace

LOGGER = logging.getLogger("safety_harness.controller")
MOST_LANES = 64  # of a user's controller
TICKS_AT_ONCE = 32_768  # of all episodes under way together: some 24 MB of trace


def run_trial(
    admitted: Admitted,
    *,
    world: WorldEntry = REFERENCE,
    controller: Controller | None = None,
    detector: BoundingBoxDetector | None = None,
    recorded: Trace | None = None,
    on_tick: Callable[[int], None] | None = None,
) -> Trace:
    """Simulate in ``world``, which is closed on every path, tick by tick, with any ``controller``.

    ``detector`` takes the place of our own in a scenario whose hand sensor has rendered images;
    ``recorded`` is an earlier trace of the same scenario, whose times by the wall's clock count again;
    ``on_tick`` is told the number of ticks done.  NoAnswerError for an avoider that hangs; InadmissibleError
    for rendered images in a world that has none, InstallationError for a world whose engine is missing.
    """
    refuse_other_type("run_trial(admitted)", admitted, Admitted)
    start = admitted.scenario, admitted.arm, admitted.joint_position_rad
    with world.open(*start, detector=detector) as episode:
        trace = simulate(
            episode, controller or admitted.controller(recorded), admitted.scenario, on_tick=on_tick
        )
    return _of_avoider(trace, admitted)


def run_kinematic(
    admitted: Admitted,
    *,
    controller: Controller | None = None,
    recorded: Trace | None = None,
    on_tick: Callable[[int], None] | None = None,
) -> Trace:
    """As ``run_trial`` in the kinematic world."""
    return run_trial(admitted, world=KINEMATIC, controller=controller, recorded=recorded, on_tick=on_tick)


def run_many(
    scenarios: Iterable[Admitted], *, world: WorldEntry = KINEMATIC, ticks_at_once: int = TICKS_AT_ONCE
) -> Iterator[Trace]:
    """Every scenario with our own controller, in the order given; the traces are those of ``run_trial``.

    ``world`` is one that takes many.  Episodes run in chunks of ``ticks_at_once`` ticks, one of them at
    least, which bounds the memory as long as the caller lets go of the traces.  Within a chunk all go to
    their next decision together; an avoider with ``propose_many`` is then asked once for all, others in turn.
    NoAnswerError for one that hangs; InadmissibleError for a scenario by the wall's clock, which is for the
    slower loop.
    """
    for run in _runs(scenarios, world, ticks_at_once):
        if isinstance(run, Exception):
            raise run
        yield run


def run_all(admitted: Sequence[Admitted], world: WorldEntry) -> Iterator[Trace | Exception]:
    """One for each, in their order; an Exception stands for a run that could not be carried on.

    All together where the world takes many, and one by one if any of them breaks.  InstallationError for a
    world that is not installed, which is no run's failure.
    """
    if world.batch and len(admitted) > 1:
        try:
            yield from list(_runs(admitted, world, TICKS_AT_ONCE))
            return
        except Exception:
            pass
    for one in admitted:
        yield _attempt(one, world)


def _runs(
    scenarios: Iterable[Admitted], world: WorldEntry, ticks_at_once: int
) -> Iterator[Trace | Exception]:
    """In chunks of those that can run together; an Exception is of a user's controller in its episode."""
    chunk: list[Admitted] = []
    ticks, of = 0, None
    for admitted in scenarios:
        refuse_other_type("run_many(scenarios)", admitted, Admitted)
        driver = admitted.driver
        # one after another: what a driver remembers is in their order, what is seen is not kept in a batch
        alone = shown_to(admitted.avoider) if driver is None else not (driver.many and world is KINEMATIC)
        if driver is None and not alone:
            refuse_wall_clock(admitted.scenario, InadmissibleError, runs="these runs")
        full = ticks + admitted.scenario.ticks + 1 > ticks_at_once or (driver and len(chunk) == MOST_LANES)
        if chunk and (alone or full or driver is not of):
            yield from _run_chunk(chunk, world)
            chunk, ticks = [], 0
        if alone:
            yield run_trial(admitted, world=world) if driver is None else _attempt(admitted, world)
            continue
        chunk, of = [*chunk, admitted], driver
        ticks += admitted.scenario.ticks + 1
    yield from _run_chunk(chunk, world)


def _attempt(one: Admitted, world: WorldEntry) -> Trace | Exception:
    try:
        together = world.batch and one.driver is None
        return next(run_many([one], world=world)) if together else run_trial(one, world=world)
    except InstallationError:
        raise
    except Exception as error:  # one run's failure is a finding
        return error


def slower_because(avoider: Avoider) -> str:
    """What keeps ``run_many`` from asking an avoider for all decisions at once; empty if nothing does."""
    if avoider.takes_many if isinstance(avoider, OutOfProcessAvoider) else takes_many(avoider):
        return ""
    return f"{avoider.name} is asked for one decision after another: it has no propose_many"


def judge(trace: Trace, *, file: Path | None = None) -> Evaluations:
    """Judge a trace by its scenario's claims, in their order.

    Nothing is simulated and no avoider is made: a user's own would be executed.  TraceError, naming
    ``file``, if no run can have written the trace.
    """
    refuse_other_type("judge(trace)", trace, Trace)
    refuse_contradictions(trace, file)
    properties = [property_of(claim, trace.scenario) for claim in trace.scenario.claims]
    return Evaluations(one.evaluate(trace) for one in properties)


def _run_chunk(chunk: list[Admitted], world: WorldEntry) -> Iterator[Trace | Exception]:
    if chunk and chunk[0].driver is not None:
        yield from _drive_chunk(chunk)
        return
    with ExitStack() as opened:
        worlds = [
            opened.enter_context(world.open(one.scenario, one.arm, one.joint_position_rad)) for one in chunk
        ]
        traces = simulate_many(
            [
                Episode(one.scenario, cast(BatchWorld, episode), one.servo())
                for one, episode in zip(chunk, worlds, strict=True)
            ]
        )
    traces.reverse()
    for one in chunk:
        yield _of_avoider(traces.pop(), one)  # what the caller has let go of is not kept for the others' sake


def _drive_chunk(chunk: list[Admitted]) -> Iterator[Trace | Exception]:
    """In lanes; one by one where that breaks for all, so that what one does costs its own episode alone."""
    driver = chunk[0].driver
    assert driver is not None
    if len(chunk) > 1:
        try:
            with ExitStack() as opened:
                episodes = []
                for number, one in enumerate(chunk):
                    world = KINEMATIC.open(one.scenario, one.arm, one.joint_position_rad)
                    episode = cast(KinematicWorld, opened.enter_context(world))
                    episodes.append((one.scenario, episode, one.driven_by(driver.lane(number))))
                runs = simulate_driven(episodes)
        except ControllerError as error:
            LOGGER.warning("%d episodes side by side broke off and run one by one: %s", len(chunk), error)
        else:
            for one, run in zip(chunk, runs, strict=True):
                yield run if isinstance(run, Exception) else _of_avoider(run, one)
            return
    for one in chunk:
        yield _attempt(one, KINEMATIC)


def _of_avoider(trace: Trace, admitted: Admitted) -> Trace:
    """The trace with the hash of its avoider's file, or of its controller's."""
    sha256 = admitted.avoider_sha256 if admitted.driver is None else admitted.driver.sha256
    return replace(trace, system=trace.system.of_file(sha256))
