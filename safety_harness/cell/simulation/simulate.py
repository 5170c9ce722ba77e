"""The whole system on one page: a world and a controller, tick by tick, into a trace.

Or many episodes in one world: all of them to their next decision, then the avoider once for all.
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
from safety_harness.cell.robot.robots import arm_model, urdf_sha256_of
from safety_harness.cell.simulation.driving import Lane, drive
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.world import BatchWorld, ShowsImages, World
from safety_harness.cell.simulation.worlds import libraries_of
from safety_harness.scenario.model import Scenario
from safety_harness.trace.provenance import provenance
from safety_harness.trace.records import Limit, tick_dtype
from safety_harness.trace.system import Component, SystemUnderTest, system_of
from safety_harness.trace.trace import Trace, no_interventions, not_recorded
from safety_harness.trace.unmeasured import knowing

INTERRUPTED = "interrupted by the user"


def simulate(
    world: World, controller: Controller, scenario: Scenario, *, on_tick: Callable[[int], None] | None = None
) -> Trace:
    """Run ``scenario`` to its end; both ends of its duration are recorded.

    ``on_tick`` is told the number of ticks done, for progress.  Ctrl-C between ticks ends the run
    early: the trace then says that it was interrupted, and no property takes it for a safe one.
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
    if isinstance(controller, DrivenController) and isinstance(world, ShowsImages):
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
    # no copy of the ticks: that would fill the padding between fields with anything
    return trace_of(scenario, world, controller, ticks[:done], ended)


def simulate_driven(
    episodes: Sequence[tuple[Scenario, KinematicWorld, DrivenController]],
) -> list[Trace | ControllerError]:
    """Run many with users' controllers in lanes, to their ends or to what broke them off.

    Each trace is that of ``simulate``, bit for bit.  ControllerError for what hinders all of them together.
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
    """(n,) TICK of its hands and its arm, to be filled."""
    joints = len(arm_model(scenario.robot).joint_names)
    return np.zeros(scenario.ticks + 1, tick_dtype(scenario.hand_slots, joints))


def trace_of(
    scenario: Scenario, world: World, controller: Controller, ticks: NDArray[np.void], ended: str = "complete"
) -> Trace:
    """What happened in ``ticks`` (n,) TICK."""
    decisions = controller.decisions
    decisions = decisions[decisions["tick"] < len(ticks)]  # not one of a tick that Ctrl-C cut short
    trace = Trace(
        scenario=scenario,
        ticks=ticks,
        decisions=decisions,
        decision_latency_s=controller.decision_latencies_s[: len(decisions)],
        provenance=provenance(world.name, libraries_of(world.name, scenario)),
        ended=ended,
        system=_system(scenario, controller),
        interventions=_interventions(scenario, controller)[: len(ticks)].copy(),
        overshoot_radps=getattr(world, "overshoot_radps", not_recorded())[: len(ticks)].copy(),
        answer_s=np.array(getattr(controller, "answers_took_s", ())),
    )
    return knowing(trace, controller.known) if isinstance(controller, DrivenController) else trace


def _interventions(scenario: Scenario, controller: Controller) -> NDArray[np.void]:
    """(n,) INTERVENTION of a controller that admission made; ControllerError for one past the shield."""
    found: NDArray[np.void] = getattr(controller, "interventions", no_interventions())
    if scenario.shield is not None and len(found) == 0:
        raise ControllerError(f"{controller.name!r} drives the arm past the shield of its scenario")
    return found


def _system(scenario: Scenario, controller: Controller) -> SystemUnderTest:
    """Of the run; the hash of a user's file is for whoever has read it."""
    part = Component(name=controller.name)
    asks = isinstance(controller, AvoidingServo | ControllerWrapper)
    own = {"avoider" if asks else "controller": part}
    return system_of(scenario, robot_sha256=urdf_sha256_of(scenario.robot), **own)


@dataclass(eq=False)
class Episode:
    """A scenario under way, with a world and a controller of its own."""

    scenario: Scenario
    world: BatchWorld
    controller: AvoidingServo
    ticks: NDArray[np.void] = field(init=False)  # (n,) TICK
    observation: NDArray[np.void] | None = field(init=False, default=None)  # to be decided on

    def __post_init__(self) -> None:
        self.ticks = no_ticks(self.scenario)

    def advance(self) -> bool:
        """On to the next decision (True) or to the end (False)."""
        decided = self.observation is not None
        self.observation = self.world.advance(self.controller.records, self.ticks, decided)
        return self.observation is not None

    def trace(self) -> Trace:
        """What happened, when it has come to its end."""
        return trace_of(self.scenario, self.world, self.controller, self.ticks)


def simulate_many(episodes: Sequence[Episode]) -> list[Trace]:
    """Run them all to their ends; each trace is that of ``simulate`` in the same world, bit for bit.

    But for their latency: that of decisions that are made together is NaN, not timed (``ask_many``).
    """
    under_way = list(episodes)
    while under_way:
        under_way = [episode for episode in under_way if episode.advance()]
        pilots = [episode.controller for episode in under_way]
        queries = [one.controller.query(one.observation) for one in under_way if one.observation is not None]
        answers = ask_many([pilot.asked() for pilot in pilots], queries)
        for pilot, query, answer in zip(pilots, queries, answers, strict=True):
            pilot.decide(query, pilot.gate.rule_on(answer, query))
    return [episode.trace() for episode in episodes]
