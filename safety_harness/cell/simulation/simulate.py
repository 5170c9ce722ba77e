"""Run a world and a controller tick by tick, and record a trace.

The module also runs many episodes in one world. All episodes continue to their next decision. Then one call
of the avoider answers all questions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError
from safety_harness.cell.avoidance.gate import ask_many
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import AvoidingServo, Controller
from safety_harness.cell.controller.driven import DrivenController
from safety_harness.cell.controller.filtered import FilteredController
from safety_harness.cell.robot.robots import arm_model, urdf_sha256_of
from safety_harness.cell.simulation.driving import Lane, drive
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.world import BatchWorld, NamesProgram, ShowsImages, World
from safety_harness.cell.simulation.worlds import libraries_of
from safety_harness.scenario.model import Scenario
from safety_harness.trace.provenance import provenance
from safety_harness.trace.records import Limit, tick_dtype
from safety_harness.trace.system import Component, SystemUnderTest, system_of
from safety_harness.trace.trace import (
    Provenance,
    Trace,
    no_interventions,
    not_filtered,
    not_predicted,
    not_recorded,
)
from safety_harness.trace.unmeasured import knowing

INTERRUPTED = "interrupted by the user"
WITH_USER = DrivenController | FilteredController  # these may see images, and report only a part


def simulate(
    world: World, controller: Controller, scenario: Scenario, *, on_tick: Callable[[int], None] | None = None
) -> Trace:
    """Run a scenario to its end, and return the trace.

    The trace has a tick at both ends of the duration. Ctrl-C between ticks ends the run early. The trace then
    states the interruption, so that no property can pass on it.

    Args:
        world: The open world.
        controller: The controller.
        scenario: The scenario for which world and controller were created.
        on_tick: A function that receives the number of finished ticks, to show progress.

    """
    ticks = no_ticks(scenario)
    done, ended = 0, "complete"
    if isinstance(controller, DrivenController) and type(world) is KinematicWorld:
        lane = Lane(world, controller, ticks)
        try:
            drive([lane], on_tick)
        except KeyboardInterrupt:
            ended = INTERRUPTED
        return trace_of(scenario, world, controller, ticks[: lane.done], ended)
    if isinstance(controller, WITH_USER) and isinstance(world, ShowsImages):
        controller.sees_images_of(world.image)
    try:
        for k in range(len(ticks)):
            tick = ticks[k : k + 1]
            world.true_state(tick)
            command = controller.step(world.observe())
            controller.report(tick)
            if k < scenario.ticks:
                braking = world.step(command)
                if braking:
                    tick["limits"] |= int(Limit.BRAKING)
            tick["faults"] |= world.acted_faults
            done = k + 1
            if on_tick is not None:
                on_tick(done)
    except KeyboardInterrupt:
        ended = INTERRUPTED
    # without a copy of the ticks, whose padding between fields would be arbitrary
    return trace_of(scenario, world, controller, ticks[:done], ended)


def simulate_driven(
    episodes: Sequence[tuple[Scenario, KinematicWorld, DrivenController]],
) -> list[Trace | ControllerError]:
    """Run many episodes with users' controllers in parallel lanes, until each episode ends or fails.

    Each trace equals the trace of ``simulate`` bit for bit. Raise ``ControllerError`` if an error stops all
    episodes.
    """
    lanes = [Lane(world, controller, no_ticks(scenario)) for scenario, world, controller in episodes]
    kinds: dict[object, list[Lane]] = {}
    for lane in lanes:
        kinds.setdefault(lane.kind, []).append(lane)
    for alike in kinds.values():
        drive(alike)
    return [
        lane.failed or trace_of(scenario, lane.world, lane.controller, lane.ticks)
        for lane, (scenario, _, _) in zip(lanes, episodes, strict=True)
    ]


def no_ticks(scenario: Scenario) -> NDArray[np.void]:
    """Return zero records TICK (n,) that suit a scenario's duration, hands and arm."""
    joints = len(arm_model(scenario.robot).joint_names)
    return np.zeros(scenario.ticks + 1, tick_dtype(scenario.hand_slots, joints))


def trace_of(
    scenario: Scenario, world: World, controller: Controller, ticks: NDArray[np.void], ended: str = "complete"
) -> Trace:
    """Return the trace of a run.

    Args:
        scenario: The scenario.
        world: The world of the run, with its provenance and measurements.
        controller: The controller of the run, with its decisions.
        ticks: The records TICK of the run, shape (n,).
        ended: A phrase that states how the run ended.

    """
    decisions = controller.decisions
    decisions = decisions[decisions["tick"] < len(ticks)]  # without the decision of an interrupted tick
    trace = Trace(
        scenario=scenario,
        ticks=ticks,
        decisions=decisions,
        decision_latency_s=controller.decision_latencies_s[: len(decisions)],
        provenance=_provenance(world, scenario),
        ended=ended,
        system=_system(scenario, controller),
        interventions=_interventions(scenario, controller)[: len(ticks)].copy(),
        filtered=_filtered(scenario, controller)[: len(ticks)].copy(),
        predicted=_predicted(scenario, controller)[: len(ticks)].copy(),
        overshoot_radps=getattr(world, "overshoot_radps", not_recorded())[: len(ticks)].copy(),
        answer_s=np.array(getattr(controller, "answers_took_s", ())),
    )
    return knowing(trace, controller.known) if isinstance(controller, WITH_USER) else trace


def _provenance(world: World, scenario: Scenario) -> Provenance:
    """Return the provenance of a run.

    If the world is a user's program, the provenance states the program.
    """
    made = provenance(world.name, libraries_of(world.name, scenario))
    return world.provenance_of(made) if isinstance(world, NamesProgram) else made


def _interventions(scenario: Scenario, controller: Controller) -> NDArray[np.void]:
    """Return the shield's interventions, as records INTERVENTION of the shape (n,).

    Raise ``ControllerError`` if the controller bypasses the shield.
    """
    interventions: NDArray[np.void] = getattr(controller, "interventions", no_interventions())
    if scenario.shield is not None and len(interventions) == 0:
        raise ControllerError(f"{controller.name!r} drives the arm past the shield of its scenario")
    return interventions


def _filtered(scenario: Scenario, controller: Controller) -> NDArray[np.void]:
    """Return the filter's records FILTERED, shape (n,).

    Raise ``ControllerError`` if the controller bypasses the filter.
    """
    if isinstance(controller, FilteredController):
        return controller.filtered
    if scenario.safety_filter:
        raise ControllerError(f"{controller.name!r} drives the arm past the safety filter of its scenario")
    return not_filtered()


def _predicted(scenario: Scenario, controller: Controller) -> NDArray[np.void]:
    """Return the predictor's sets, as records PREDICTED of the shape (n,).

    Raise ``ControllerError`` if the controller bypasses the predictor.
    """
    servo = controller.pilot if isinstance(controller, FilteredController) else controller
    predicted: NDArray[np.void] = getattr(servo, "predicted", not_predicted())
    if scenario.predictor and len(predicted) == 0:
        raise ControllerError(f"{controller.name!r} does not ask the predictor of its scenario")
    return predicted


def _system(scenario: Scenario, controller: Controller) -> SystemUnderTest:
    """Return the system under test of a run.

    The code that reads a user's file adds the hash of the file.
    """
    part, by_filter = Component(name=controller.name), None
    if isinstance(controller, FilteredController):
        by_filter, controller = Component(name=controller.calls.name), controller.pilot
    asks = isinstance(controller, AvoidingServo | ControllerWrapper)
    own: dict[str, Component | None] = {"avoider" if asks else "controller": part, "safety_filter": by_filter}
    servo = controller.pilot if isinstance(controller, ControllerWrapper) else controller
    if isinstance(servo, AvoidingServo) and servo.predictor is not None:
        own["predictor"] = Component(name=servo.predictor.name)
    return system_of(scenario, robot_sha256=urdf_sha256_of(scenario.robot), **own)


@dataclass(eq=False)
class Episode:
    """A running scenario, with a world and a controller of its own."""

    scenario: Scenario
    world: BatchWorld
    controller: AvoidingServo
    ticks: NDArray[np.void] = field(init=False)  # (n,) TICK
    observation: NDArray[np.void] | None = field(init=False, default=None)  # of the pending decision

    def __post_init__(self) -> None:
        self.ticks = no_ticks(self.scenario)

    def advance(self) -> bool:
        """Continue to the next decision or to the end.

        Return True at a decision, and False at the end.
        """
        decided = self.observation is not None
        self.observation = self.world.advance(self.controller.records, self.ticks, decided)
        return self.observation is not None

    def trace(self) -> Trace:
        """Return the trace of the finished run."""
        return trace_of(self.scenario, self.world, self.controller, self.ticks)


def simulate_many(episodes: Sequence[Episode]) -> list[Trace]:
    """Run all episodes to their ends.

    Each trace equals the trace of ``simulate`` bit for bit, except for the latency. The latency is NaN for
    batched decisions, because ``ask_many`` does not measure their times.
    """
    under_way = list(episodes)
    while under_way:
        under_way = [episode for episode in under_way if episode.advance()]
        pilots = [episode.controller for episode in under_way]
        queries = [run.controller.query(run.observation) for run in under_way if run.observation is not None]
        answers = ask_many([pilot.answerer() for pilot in pilots], queries)
        for pilot, query, answer in zip(pilots, queries, answers, strict=True):
            pilot.decide(query, pilot.gate.rule_on(answer, query))
    return [episode.trace() for episode in episodes]
