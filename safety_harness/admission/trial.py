"""Run admitted scenarios in a world, and judge their traces.

``run_trial`` can run any controller.  ``run_many`` uses the controllers of the scenarios.
"""

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
    EditedProgramError,
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
    """Run an admitted scenario in a world, tick by tick, and return its trace.

    The function always closes the world at the end, even after an exception.

    Args:
        admitted: The admitted scenario, as ``admit`` returns it.
        world: The world.
        controller: A controller that replaces the scenario's own.  None means that ``admitted`` makes a new
            controller.
        detector: A hand detector for rendered images that replaces our own.
        recorded: An earlier trace of the scenario.  If the wall clock measured its decision times, the new
            run repeats these times.
        on_tick: A function that is called after each tick with the number of finished ticks.

    Raises:
        NoAnswerError: The avoider did not answer in time.
        InadmissibleError: The scenario needs rendered images, and the world renders none.
        InstallationError: The engine of the world is missing.

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
    """Run an admitted scenario in the kinematic world and return its trace.

    Args:
        admitted: The admitted scenario, as ``admit`` returns it.
        controller: A controller that replaces the scenario's own.  None means that ``admitted`` makes a new
            controller.
        recorded: An earlier trace of the scenario.  If the wall clock measured its decision times, the new
            run repeats these times.
        on_tick: A function that is called after each tick with the number of finished ticks.

    Raises:
        NoAnswerError: The avoider did not answer in time.
        InadmissibleError: The scenario needs rendered images.

    """
    return run_trial(admitted, world=KINEMATIC, controller=controller, recorded=recorded, on_tick=on_tick)


def run_many(
    scenarios: Iterable[Admitted], *, world: WorldEntry = KINEMATIC, ticks_at_once: int = TICKS_AT_ONCE
) -> Iterator[Trace]:
    """Yield the trace of every scenario in order.

    Each trace equals the result of ``run_trial``.  The episodes run in chunks, so that memory stays bounded
    if the caller drops the traces.  Within a chunk, every episode runs until it needs its next decision.  If
    the avoider has ``propose_many``, it then answers the questions of all episodes in one call, otherwise one
    by one.

    Args:
        scenarios: Admitted scenarios.
        world: A world that can run many episodes at once.
        ticks_at_once: The largest total number of ticks in a chunk.  An episode with more ticks forms its own
            chunk.

    Raises:
        NoAnswerError: An avoider did not answer in time.
        InadmissibleError: A scenario charges wall-clock time for decisions, and therefore needs
            ``run_trial``.

    """
    for run in _runs(scenarios, world, ticks_at_once):
        if isinstance(run, Exception):
            raise run
        yield run


def run_all(admitted: Sequence[Admitted], world: WorldEntry) -> Iterator[Trace | Exception]:
    """Yield a trace for each scenario in order, or the exception with which the run ended.

    If the world can run many episodes at once, the function first tries to run all scenarios together.  If
    this attempt fails, the scenarios run one by one.  If the engine of the world is missing, the function
    raises InstallationError, because this is no failure of a single run.
    """
    # A list, because no trace may be yielded before all runs have succeeded.
    if world.batch and len(admitted) > 1:
        try:
            yield from list(_runs(admitted, world, TICKS_AT_ONCE))
            return
        except Exception:
            pass
    for scenario in admitted:
        yield _attempt(scenario, world)


def _runs(
    scenarios: Iterable[Admitted], world: WorldEntry, ticks_at_once: int
) -> Iterator[Trace | Exception]:
    """Simulate the scenarios in chunks that can run together, and yield the runs.

    If a user's controller raises an exception in an episode, the function yields the exception in place of
    the trace.
    """
    chunk: list[Admitted] = []
    ticks, chunk_driver = 0, None
    for admitted in scenarios:
        refuse_other_type("run_many(scenarios)", admitted, Admitted)
        driver = admitted.driver
        # These run one after another: a driver remembers their order, and a batch stores no view.
        alone = shown_to(admitted.avoider) if driver is None else not (driver.many and world is KINEMATIC)
        beside = admitted.scenario.has_parts_beside
        alone = alone or beside or admitted.answers_later
        if driver is None and not alone:
            refuse_wall_clock(admitted.scenario, InadmissibleError, runs="these runs")
        full = ticks + admitted.scenario.ticks + 1 > ticks_at_once or (driver and len(chunk) == MOST_LANES)
        if chunk and (alone or full or driver is not chunk_driver):
            yield from _run_chunk(chunk, world)
            chunk, ticks = [], 0
        if alone:
            own = driver is None and not beside  # whose errors stop all runs
            yield run_trial(admitted, world=world) if own else _attempt(admitted, world)
            continue
        chunk, chunk_driver = [*chunk, admitted], driver
        ticks += admitted.scenario.ticks + 1
    yield from _run_chunk(chunk, world)


def _attempt(admitted: Admitted, world: WorldEntry) -> Trace | Exception:
    """Return the trace of one run, or the exception with which the run ended."""
    try:
        together = world.batch and admitted.driver is None and not admitted.scenario.has_parts_beside
        return next(run_many([admitted], world=world)) if together else run_trial(admitted, world=world)
    except (InstallationError, EditedProgramError):
        raise
    except Exception as error:  # one run's failure is a finding
        return error


def slower_because(avoider: Avoider) -> str:
    """Return why ``run_many`` cannot send all questions to ``avoider`` in one call.

    The text is empty if it can.
    """
    if avoider.takes_many if isinstance(avoider, OutOfProcessAvoider) else takes_many(avoider):
        return ""
    return f"{avoider.name} gets one question after another: it has no propose_many"


def judge(trace: Trace, *, file: Path | None = None) -> Evaluations:
    """Judge a trace by the claims of its scenario.

    The function neither simulates nor loads the avoider, because it must not execute a user's program.

    Args:
        trace: The trace.
        file: The file of the trace, for error messages.

    Returns:
        The evaluation of each claim, in the order of the claims.

    Raises:
        TraceError: The trace contradicts itself, so no run can have written it.

    """
    refuse_other_type("judge(trace)", trace, Trace)
    refuse_contradictions(trace, file)
    properties = [property_of(claim, trace.scenario) for claim in trace.scenario.claims]
    return Evaluations(claimed.evaluate(trace) for claimed in properties)


def _run_chunk(chunk: list[Admitted], world: WorldEntry) -> Iterator[Trace | Exception]:
    """Simulate the scenarios of a chunk together, and yield their runs."""
    if chunk and chunk[0].driver is not None:
        yield from _drive_chunk(chunk)
        return
    with ExitStack() as opened:
        worlds = [
            opened.enter_context(world.open(run.scenario, run.arm, run.joint_position_rad)) for run in chunk
        ]
        traces = simulate_many(
            [
                Episode(run.scenario, cast(BatchWorld, episode), run.servo())
                for run, episode in zip(chunk, worlds, strict=True)
            ]
        )
    traces.reverse()
    for run in chunk:
        yield _of_avoider(traces.pop(), run)  # a trace that the caller drops frees its memory at once


def _drive_chunk(chunk: list[Admitted]) -> Iterator[Trace | Exception]:
    """Yield the runs of a user's controller.

    Each episode has its own lane, that is, its own controller object.  If the common simulation fails, the
    episodes run one by one, so that only the failing episode is lost.
    """
    driver = chunk[0].driver
    assert driver is not None
    if len(chunk) > 1:
        try:
            with ExitStack() as opened:
                episodes = []
                for number, admitted in enumerate(chunk):
                    world = KINEMATIC.open(admitted.scenario, admitted.arm, admitted.joint_position_rad)
                    episode = cast(KinematicWorld, opened.enter_context(world))
                    episodes.append((admitted.scenario, episode, admitted.driven_by(driver.lane(number))))
                runs = simulate_driven(episodes)
        except ControllerError as error:
            LOGGER.warning("%d episodes side by side broke off and run one by one: %s", len(chunk), error)
        else:
            for admitted, run in zip(chunk, runs, strict=True):
                yield run if isinstance(run, Exception) else _of_avoider(run, admitted)
            return
    for admitted in chunk:
        yield _attempt(admitted, KINEMATIC)


def _of_avoider(trace: Trace, admitted: Admitted) -> Trace:
    """Return the trace with the file hashes of the user's parts added."""
    sha256 = admitted.avoider_sha256 if admitted.driver is None else admitted.driver.sha256
    parts = {"safety_filter": admitted.safety_filter, "predictor": admitted.predictor}
    hashes = {name: part.sha256 for name, part in parts.items() if part is not None}
    return replace(trace, system=trace.system.of_file(sha256).with_hashes(**hashes))
