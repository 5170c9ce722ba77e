"""Twelve changes of a cell that no claim about a fallback may mind, and faults of one, small and large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from examples import Displaced
from numpy.typing import NDArray

from safety_harness import Move, Report
from safety_harness.base.settings import DecisionTimes, HandSensorKind, ImageSource
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.robots import Drives, Payload
from safety_harness.seams.contract import Decision, Seen
from safety_harness.trace.records import DecisionOutcome, Mode, Trigger
from tests.cell.robot.test_drives import own

Change = Callable[[Scenario], Scenario]
IN_DOUBT = Displaced((0.0, 0.05, 0.08), spread_m=0.03, spread_threshold_m=0.02)
CERTAIN = Displaced((0.0, 0.05, 0.08), spread_m=0.01, spread_threshold_m=0.02)
# Of the UR10 as a user's own arm: a hair from the default, which is asked for.
POSTURE_RAD = (-0.22, -1.27, 1.98, -2.27, -1.57, -1.7901)


def setting(**parts: dict[str, Any]) -> Change:
    """With these settings, by table."""

    def changed(scenario: Scenario) -> Scenario:
        tables = {name: replace(getattr(scenario.settings, name), **table) for name, table in parts.items()}
        return replace(scenario, settings=replace(scenario.settings, **tables))

    return changed


def driven(folder: Path, **drives: Any) -> Change:
    """With the UR10 as an own arm with these drives; ``folder`` is empty and is given its files."""

    def changed(scenario: Scenario) -> Scenario:
        robot = own(Drives(**drives), folder=folder)
        posed = setting(cell={"preferred_joint_position_rad": POSTURE_RAD})(scenario)
        return replace(posed, robot=robot, settings=replace(posed.settings, braking=robot.braking.settings))

    return changed


def noticed(**sensor: Any) -> Change:
    """With a hand sensor that is not ideal."""
    return setting(hand_sensor={"kind": HandSensorKind.SURROUND, **sensor})


HEAVY = Payload(mass_kg=2.0, centre_m=(0.0, 0.0, 0.05))
HARMLESS: dict[str, Callable[[Path], Change]] = {
    "drives lag": lambda folder: driven(folder, lag_s=0.02),
    "drives lag and wait": lambda folder: driven(folder, dead_time_s=0.008, lag_s=0.02),
    "payload and torque limit": lambda folder: driven(folder, torque_share=0.8, payload=HEAVY),
    "late hands": lambda _: noticed(latency_s=0.04),
    "noisy hands": lambda _: noticed(pixel_noise_px=1.0, depth_noise_per_m=0.0025),
    "30 frames a second": lambda _: noticed(rate_hz=30.0),
    "late images": lambda _: setting(camera={"rate_hz": 30.0, "latency_s": 0.033}),
    "images of pixels": lambda _: setting(camera={"source": ImageSource.RASTER}),
    "calibration": lambda _: setting(camera={"calibration_error_rotation_rad": (0.01, 0.01, 0.0)}),
    "tick of 4 ms": lambda _: setting(clock={"control_period_s": 0.004}),
    "tick of 16 ms": lambda _: setting(clock={"control_period_s": 0.016}),
    "slow decisions": lambda _: setting(avoidance={"decision_time": DecisionTimes(quantiles_s=(0.024,))}),
}


@dataclass(frozen=True, kw_only=True)
class Astray:
    """What is wrong with the motion of a fallback that is reported as one.

    It heads ``off_deg`` off the opposite pose, or goes on as before for ``late`` cycles; ``speed`` is its
    share of the right one; ``aside_m`` is the offset at the end, from 40 mm before it on.
    """

    off_deg: float = 0.0
    late: int = 0
    speed: float = 1.0
    aside_m: float = 0.0

    def target(self, tcp_in_base_m: NDArray[np.float64], opposite_in_base_m: NDArray[np.float64]) -> Any:
        """(3,) where it heads for from the TCP (3,) at the decision."""
        way = opposite_in_base_m - tcp_in_base_m
        off_rad, length_m = np.radians(self.off_deg), np.linalg.norm(way)
        return tcp_in_base_m + np.cos(off_rad) * way + np.sin(off_rad) * length_m * across(way)


SOUND = Astray()


def across(way: NDArray[np.float64]) -> Any:
    """(3,) a unit vector across a way (3,)."""
    sideways = np.cross(way, (0.0, 0.0, 1.0))
    return sideways / np.linalg.norm(sideways)


class Strays(ControllerWrapper):
    """The visual servo, whose fallbacks go astray and say that they do not."""

    def __init__(self, pilot: AvoidingServo, fault: Astray) -> None:
        super().__init__(pilot)
        self._fault, self._left, self._before = fault, 0, np.zeros(0)
        self._way, self._end = np.zeros(3), np.zeros(3)

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        command, state = super().step(observation).copy(), self.pilot.records.state[0]
        tcp_in_base_m = state["transform_tcp_to_base"][:3, 3].copy()
        made = self.pilot.records.question[0]["made_now"]
        if made and self.pilot.decisions[-1]["outcome"] == DecisionOutcome.OPPOSITE:
            self._left, opposite_in_base_m = (
                self._fault.late,
                self.pilot.decisions[-1]["chosen_position_in_base_m"],
            )
            self._way = opposite_in_base_m - tcp_in_base_m
            self._end = self._fault.target(tcp_in_base_m, opposite_in_base_m)
            state["target_in_base_m"] = self._end
        if state["mode"] == Mode.REPULSING:
            if np.linalg.norm(self._end - tcp_in_base_m) < 0.04 and self._fault.aside_m:
                state["target_in_base_m"] = self._end + self._fault.aside_m * across(self._way)
            command["joint_velocity_radps"] *= self._fault.speed
            if self._left > 0:
                self._left -= 1
                command["joint_velocity_radps"] = self._before
        self._before = command[0]["joint_velocity_radps"].copy()
        return command


class Reporting:
    """A user's controller that reports doubt and falls back; its motion is its own."""

    name = "reporting"
    sees = ("joints", "predicted hands")
    reports = ("mode", "decisions", "doubt")

    def __init__(self, fault: Astray = SOUND) -> None:
        self.fault = fault

    def reset(self, *, settings: Any, **_: Any) -> None:
        self.settings, self.target, self.left, self.end = settings, None, 0, np.zeros(3)
        self.way, self.before = np.zeros(3), np.zeros(3)

    def act(self, seen: Seen) -> Move:
        tcp, avoidance = seen.tcp_position_in_base_m, self.settings.avoidance
        hands = [hand.position_in_base_m for hand in seen.predicted_hands]
        near = min(hands, key=lambda hand: float(np.linalg.norm(hand - tcp)), default=np.full(3, np.inf))
        inside = np.linalg.norm(near - tcp) < avoidance.critical_distance_m
        if self.target is not None and np.linalg.norm(self.target - tcp) <= avoidance.arrival_tolerance_m:
            trigger, self.target = Trigger.HAND_STILL_THERE, None
        else:
            trigger = Trigger.HAND_ENTERED
        decision = None
        if self.target is None and inside:
            opposite = tcp + avoidance.radius_m * (tcp - near) / np.linalg.norm(tcp - near)
            self.way, self.left = opposite - tcp, self.fault.late
            self.end = self.target = self.fault.target(tcp, opposite)
            decision = Decision(
                hand_position_in_base_m=near,
                proposed_position_in_base_m=tcp + (0.0, 0.05, 0.08),
                chosen_position_in_base_m=opposite,
                outcome=DecisionOutcome.OPPOSITE,
                trigger=trigger,
                spread_m=np.full(3, 0.03),
                spread_threshold_m=0.02,
            )
        if self.target is None:
            home = 0.4 * (np.array(self.settings.cell.desired_tcp_position_in_base_m) - tcp)
            return self.moves(home, Mode.SERVOING, decision)
        if np.linalg.norm(self.end - tcp) < 0.04:
            self.target = self.end + self.fault.aside_m * across(self.way)
        if self.left > 0:
            self.left -= 1
            return self.moves(self.before, Mode.REPULSING, decision)
        way = self.target - tcp
        left_m = float(np.linalg.norm(way))
        braking = np.sqrt(1.6 * avoidance.repulsion_acceleration_mps2 * left_m)
        mps = min(avoidance.repulsion_speed_mps, braking, left_m / seen.period_s)
        return self.moves(self.fault.speed * mps / max(left_m, 1e-9) * way, Mode.REPULSING, decision)

    def moves(self, velocity: NDArray[np.float64], mode: Mode, decision: Decision | None) -> Move:
        self.before = velocity
        return Move(tcp_velocity_mps=velocity, report=Report(mode=mode, decision=decision))
