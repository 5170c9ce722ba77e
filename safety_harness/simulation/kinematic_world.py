"""The second world: the joints do exactly what the drives are told, and nothing has mass.

Everything but the motion of the arm is the reference world's own compiled steps.  There the velocity
motors reach what they are told within the first physics sub-step, to 1e-9 rad/s, unless their torque
limit holds them back, so that over a tick each joint turns by its set point times the period: here it
always does.  Joints have no stops, and the arm meets neither the table nor itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import njit_no_nrt
from safety_harness.controller.cycle import ControllerRecords, act, look, report
from safety_harness.exceptions import InadmissibleError
from safety_harness.robot.description import ArmModel
from safety_harness.scenario.model import Scenario
from safety_harness.settings import DetectorKind, ImageSource
from safety_harness.simulation.records import WorldRecords, world_records
from safety_harness.simulation.steps import Floats, Records, drive_on, move_on, now_s, sense
from safety_harness.trace.records import TICK_COMPILED, Limit

BRAKING = int(Limit.BRAKING)


class KinematicWorld:
    """One scenario without an engine; InadmissibleError for one whose images are rendered.

    For any controller, tick by tick, as a ``World``; ``advance`` is the same with our own, compiled.
    """

    name = "kinematic"

    def __init__(self, scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64]) -> None:
        refuse_rendered(scenario)
        self.records = world_records(scenario, arm, joint_position_rad)

    @property
    def time_s(self) -> float:
        """The start of the coming control tick."""
        return now_s(self.records.clock)

    @property
    def acted_faults(self) -> int:
        """Bits of the scenario's faults that have acted on this tick's pictures and, after it, its step."""
        return int(self.records.clock[0]["acted_faults"])

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth part of ``tick``; the rest is the controller's to fill."""
        tick.view(TICK_COMPILED)[0] = self.records.truth[0]

    def observe(self) -> NDArray[np.void]:
        """Let the cameras take what is due and deliver what has arrived; encoders are exact."""
        sense(*self.records.for_sense)
        return self.records.observation

    def step(self, command: NDArray[np.void]) -> bool:
        """Drives, joints and hands for one control period."""
        records = self.records
        return step(*(records.for_motion + (records.drives, records.faults, command)))


def refuse_rendered(scenario: Scenario) -> None:
    """InadmissibleError for what only the world with a renderer can do."""
    settings = scenario.settings
    rendered = {
        "camera.source": settings.camera.source is ImageSource.RENDERED,
        "hand sensor.detector": settings.hand_sensor.detector is DetectorKind.RENDERED,
    }
    for field, asked in rendered.items():
        if asked:
            raise InadmissibleError(
                place=scenario.place(field),
                expected="exact or raster images in the kinematic world, which has no renderer",
                got="rendered",
                hint="the PyBullet world renders",
            )


@njit_no_nrt
def step(
    clocks: Records,
    hands: Records,
    moves: Records,
    samples: Floats,
    arms: Records,
    capsule_link: NDArray[np.int64],
    capsule_start_in_link: Floats,
    capsule_end_in_link: Floats,
    capsule_radius_m: Floats,
    placed: Floats,
    truths: Records,
    drives: Records,
    faults: Records,
    commands: Records,
) -> bool:
    """One control period with a command (1,) COMMAND; True while the brakes act."""
    told, joints = clocks[0].commanded_radps, clocks[0].joint_position_rad
    truth, period_s = truths[0], clocks[0].control_period_s
    braking = drive_on(clocks, drives, faults, truths, commands, told)
    for i in range(6):
        joints[i] = truth.joint_position_rad[i] + told[i] * period_s
    move_on(
        clocks,
        hands,
        moves,
        samples,
        arms,
        capsule_link,
        capsule_start_in_link,
        capsule_end_in_link,
        capsule_radius_m,
        placed,
        truths,
        joints,
        told,
    )
    return braking


@njit_no_nrt
def advance(
    world: WorldRecords,
    controller: ControllerRecords,
    ticks: Records,  # (n,) TICK_COMPILED, those from now on written
    decided: bool,
) -> bool:
    """On to the next decision (True) or the end of the run (False): the loop of ``simulate``, compiled.

    ``decided``: the run stands at a decision, and the controller's answer has it.
    """
    (
        clocks,
        arms,
        link,
        start,
        end,
        radius,
        placed,
        hands,
        moves,
        samples,
        sensors,
        object_frames,
        hand_frames,
        polygon,
        normals,
        uniforms,
        drives,
        faults,
        observations,
        truths,
    ) = world
    (
        parameters,
        filter_parameters,
        states,
        tracks,
        answers,
        commands,
        questions,
        avoider_faults,
        decision_times_s,
    ) = controller
    last = ticks.shape[0] - 1
    k = clocks[0].tick
    while True:
        tick = ticks[k : k + 1]
        if not decided:
            ticks[k] = truths[0]
            sense(
                clocks,
                sensors,
                object_frames,
                hand_frames,
                polygon,
                normals,
                uniforms,
                hands,
                placed,
                radius,
                faults,
                truths,
                observations,
            )
            if look(
                parameters,
                filter_parameters,
                states,
                tracks,
                questions,
                avoider_faults,
                decision_times_s,
                observations,
            ):
                return True
        decided = False
        act(parameters, states, answers, commands, questions, observations)
        report(states, commands, questions, tick)
        if k < last and step(
            clocks,
            hands,
            moves,
            samples,
            arms,
            link,
            start,
            end,
            radius,
            placed,
            truths,
            drives,
            faults,
            commands,
        ):
            tick[0].limits |= BRAKING
        tick[0].faults |= clocks[0].acted_faults
        if k == last:
            return False
        k += 1
