"""The second world: the joints do exactly what the drives are told, and nothing has mass.

Everything but the motion of the arm is the reference world's own compiled steps.  There the velocity
motors reach what they are told within the first physics sub-step, to 1e-9 rad/s, unless their torque
limit holds them back, so that over a tick each joint turns by its set point times the period: here it
always does.  Joints have no stops, and the arm meets neither the table nor itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.controller.cycle import ControllerRecords, act, look, report
from safety_harness.exceptions import InadmissibleError
from safety_harness.robot.description import ArmModel
from safety_harness.scenario.model import Scenario
from safety_harness.settings import DetectorKind, ImageSource
from safety_harness.simulation.records import WorldRecords, world_records
from safety_harness.simulation.steps import drive_on, move_on, now_s, observe_truth, sense
from safety_harness.trace.records import TICK_COMPILED, Limit

BRAKING = int(Limit.BRAKING)


class KinematicWorld:
    """One scenario without an engine; InadmissibleError for one whose images are rendered.

    For any controller, tick by tick, as a ``World``; ``advance`` is the same with our own, compiled.
    """

    name = "kinematic"

    def __init__(self, scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64]) -> None:
        refuse_rendered(scenario)
        self.records = world_records(scenario, arm)
        observe_truth(self.records, np.array(joint_position_rad, dtype=np.float64), np.zeros(6))

    @property
    def time_s(self) -> float:
        """The start of the coming control tick."""
        return now_s(self.records)

    @property
    def acted_faults(self) -> int:
        """Bits of the scenario's faults that have acted on this tick's pictures and, after it, its step."""
        return int(self.records.clock[0]["acted_faults"])

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth part of ``tick``; the rest is the controller's to fill."""
        tick.view(TICK_COMPILED)[0] = self.records.truth[0]

    def observe(self) -> NDArray[np.void]:
        """Let the cameras take what is due and deliver what has arrived; encoders are exact."""
        sense(self.records)
        return self.records.observation

    def step(self, command: NDArray[np.void]) -> bool:
        """Drives, joints and hands for one control period."""
        return step(self.records, command)


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


@compiled
def step(w: WorldRecords, commands: NDArray[np.void]) -> bool:
    """One control period with a command (1,) COMMAND; True while the brakes act."""
    told, joints = np.empty(6), np.empty(6)
    braking = drive_on(w, commands, told)
    for i in range(6):
        joints[i] = w.truth[0].joint_position_rad[i] + told[i] * w.clock[0].control_period_s
    move_on(w, joints, told)
    return braking


@compiled
def advance(
    w: WorldRecords,
    c: ControllerRecords,
    ticks: NDArray[np.void],  # (n,) TICK_COMPILED, those from now on written
    decided: bool,
) -> bool:
    """On to the next decision (True) or the end of the run (False): the loop of ``simulate``, compiled.

    ``decided``: the run stands at a decision, and ``c.answer`` has it.
    """
    last = ticks.shape[0] - 1
    k = w.clock[0].tick
    while True:
        if not decided:
            ticks[k] = w.truth[0]
            sense(w)
            if look(c, w.observation):
                return True
        decided = False
        act(c, w.observation)
        report(c, ticks[k : k + 1])
        if k < last and step(w, c.command):
            ticks[k].limits |= BRAKING
        ticks[k].faults |= w.clock[0].acted_faults
        if k == last:
            return False
        k += 1
