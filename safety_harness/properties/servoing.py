"""Servoing gets there once the hands have left: gain switch reached, and converged.

Both are judged against the closed form of eq. 1 with the right interaction matrix: the error
decays as exp(-lambda t), so from an error d the threshold c takes ln(d/c)/lambda seconds.  A run
that ends before the time allowed is no evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.controller.desired import desired_transform_tcp_to_base
from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, time_left_s, unreadable
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.properties.reaction import gives_way
from safety_harness.properties.true_motion import nearest_hand_m, true_motion
from safety_harness.scenario.units import TIME
from safety_harness.settings import CONVERGED_ANGLE_RAD, CONVERGED_POSITION_M
from safety_harness.trace.trace import Trace, history, once_a_trace

ALLOWANCE = 1.25  # times the closed form, for the limits and the other five features
GRACE_S = 1.0  # for getting up to speed


@once_a_trace
def left_at(trace: Trace) -> int | None:
    """The tick from which on no true hand is within the critical distance of the TCP, else None."""
    near = nearest_hand_m(trace) < trace.scenario.settings.avoidance.critical_distance_m
    busy = np.flatnonzero(near | gives_way(trace))
    if len(busy) == 0:
        return 0
    first = int(busy[-1]) + 1
    return first if first < len(near) else None


@once_a_trace
def pose_errors(trace: Trace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) distance [m] and angle [rad] of the TCP from the desired pose at each tick."""
    return position_errors_m(trace), angle_errors_rad(trace, trace.ticks["transform_tcp_to_base"])


@once_a_trace
def position_errors_m(trace: Trace) -> NDArray[np.float64]:
    """(n,) distance of the TCP from the desired position at each tick."""
    return np.sqrt(_squared_m2(trace))


@once_a_trace
def _squared_m2(trace: Trace) -> NDArray[np.float64]:
    """(n,) the square of that."""
    desired = desired_transform_tcp_to_base(trace.scenario.settings)
    return _squared_distances(true_motion(trace).tcp_m, desired[:3, 3])


@compiled
def _squared_distances(
    points: NDArray[np.float64],  # (n, 3)
    place: NDArray[np.float64],  # (3,)
) -> NDArray[np.float64]:
    found = np.zeros(points.shape[0])
    for k in range(points.shape[0]):
        for i in range(3):
            found[k] += (points[k, i] - place[i]) ** 2
    return found


def angle_errors_rad(trace: Trace, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) angle from the desired pose of each of ``poses`` (n, 4, 4)."""
    desired = desired_transform_tcp_to_base(trace.scenario.settings)
    turns = desired[:3, :3].T @ poses[:, :3, :3]
    axis = np.stack(
        [turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]]
    )
    angle: NDArray[np.float64] = np.arctan2(
        np.linalg.norm(axis, axis=0), np.trace(turns, axis1=1, axis2=2) - 1.0
    )
    return angle


def was_off(trace: Trace) -> bool:
    """Was the TCP ever farther from the desired pose than one that has converged?"""
    if np.any(position_errors_m(trace) > CONVERGED_POSITION_M):
        return True
    return bool(np.any(pose_errors(trace)[1] > CONVERGED_ANGLE_RAD))


@dataclass(frozen=True, kw_only=True)
class GainSwitchReached:
    """Eq. 15 falls below the switch within the allowed time after the last hand has left.

    Margin: time left when it does, or minus the time that had been overrun at the end of the run.
    Allowed: ``within_s``, else 1.25 times the closed form ln(|e|/sqrt(c))/lambda plus 1 s.  An
    object that is not seen is not below the switch.

    Exercised when the error is above the switch after the last hand has left: one that is below
    already then has been brought there by something else, by the start or while the hand was near.
    """

    within_s: float | None = None
    unit: Unit = Unit.TIME

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return "gain switch reached" + ("" if self.within_s is None else f" within {self.within_s:g} s")

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the first crossing after the hands have left."""
        problem = unreadable(trace, ("transform_tcp_to_base", "hand_position_in_base_m"))
        if problem is not None:
            return inconclusive(self, problem)
        first = left_at(trace)
        if first is None:
            return inconclusive(self, "a hand is near to the end: servoing was not free to go on")
        servo = trace.scenario.settings.servo
        sse = history(trace, "sse")[first:]
        errors = _errors(trace)[first:]
        allowed_s = self.within_s
        if allowed_s is None:
            ratio = max(float(errors[0]) / servo.gain_switch_sse, 1.0)
            allowed_s = ALLOWANCE * 0.5 * float(np.log(ratio)) / servo.gain_far + GRACE_S
        below = np.flatnonzero(np.isfinite(sse) & (sse < servo.gain_switch_sse))
        above = errors[: below[0] if len(below) else None] >= servo.gain_switch_sse
        if len(below):
            took = int(below[0])  # in ticks
            took_s = float(trace.time_s[took])
            reason = f"reached {took_s:.2f} s after the hands had left; {allowed_s:.2f} s were allowed"
            if not above.any():
                reason = "below the switch already when the hands had left"
        else:
            took = len(trace.ticks) - 1 - first
            took_s = float(trace.time_s[took])
            if time_left_s(trace, allowed_s, took) >= 0.0:
                return inconclusive(
                    self,
                    f"the run ends {took_s:.2f} s after the hands have left; {allowed_s:.2f} s are allowed",
                )
            reason = f"not reached in {took_s:.2f} s; {allowed_s:.2f} s were allowed"
        return judged(
            self,
            trace,
            margin=time_left_s(trace, allowed_s, took),
            worst_time_s=float(trace.time_s[first + took]),
            reason=reason,
            exercised=int(above.any()),
        )


@once_a_trace
def _errors(trace: Trace) -> NDArray[np.float64]:
    """(n,) eq. 15; where the object is not seen, what it would be upright: the distance squared."""
    sse = history(trace, "sse")
    return np.where(np.isfinite(sse), sse, _squared_m2(trace))


@dataclass(frozen=True, kw_only=True)
class Converged:
    """The TCP ends within 1 mm and 0.1 degree of the desired pose, judged by pose, not by features.

    Margin: 1 mm less the distance at the end; where the angle is too large, minus the distance
    that the excess angle means at the camera's desired depth.  A run shorter than the closed form
    needs (both gains) is inconclusive unless it has converged already.

    Exercised when the TCP was farther off at any tick of the run, so that servoing has brought it
    here; a TCP that began there and was never pushed away says nothing.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "converged to the desired pose"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the last tick."""
        problem = unreadable(trace, ("transform_tcp_to_base", "hand_position_in_base_m"))
        if problem is not None:
            return inconclusive(self, problem)
        first = left_at(trace)
        if first is None:
            return inconclusive(self, "a hand is near to the end: servoing was not free to go on")
        position = position_errors_m(trace)
        angle_rad = float(angle_errors_rad(trace, trace.ticks["transform_tcp_to_base"][-1:])[0])
        needed_s = self._needed_s(trace, float(position[first]))
        had_s = float(trace.time_s[-1] - trace.time_s[first])
        margin = CONVERGED_POSITION_M - float(position[-1])
        excess_rad = angle_rad - CONVERGED_ANGLE_RAD
        if excess_rad > 0.0:
            settings = trace.scenario.settings
            desired_m = settings.cell.desired_tcp_position_in_base_m
            depth_m = desired_m[2] - settings.object.position_in_base_m[2]
            margin = min(margin, -excess_rad * depth_m)
        if margin < 0.0 and had_s < needed_s:
            return inconclusive(self, f"the closed form needs {needed_s:.1f} s; the run leaves {had_s:.1f} s")
        return judged(
            self,
            trace,
            margin=margin,
            worst_time_s=float(trace.time_s[-1]),
            reason=f"ends {position[-1] * 1e3:.2f} mm and {np.degrees(angle_rad):.3f} deg off",
            exercised=int(was_off(trace)),
        )

    def _needed_s(self, trace: Trace, distance_m: float) -> float:
        """Closed form from ``distance_m``: fast until the gain switch, slow from there to 1 mm."""
        servo = trace.scenario.settings.servo
        switch_m = float(np.sqrt(servo.gain_switch_sse))
        far_s = np.log(max(distance_m, switch_m) / switch_m) / servo.gain_far
        near_s = np.log(max(min(distance_m, switch_m), CONVERGED_POSITION_M) / CONVERGED_POSITION_M)
        return float(ALLOWANCE * (far_s + near_s / servo.gain_near) + GRACE_S)


GAIN_SWITCH = CatalogueEntry(
    example="gain switch reached",
    pattern="gain switch reached",
    make=lambda *_: GainSwitchReached(),
    unit=Unit.TIME,
    rationale="an avoider that leaves the arm where servoing cannot go on ends the task",
    source="the paper, eq. 15",
    margin="time left of 1.25 times the closed form plus 1 s, counted from when the last hand has left",
    parameters="the gains and the switch of the settings",
    exercised="the error is above the switch after the last hand has left",
    inconclusive="a hand is near to the end, or the run ends before the time allowed",
    scenario="servoing-alone",
    broken_by="a controller that does nothing",
)

GAIN_SWITCH_WITHIN = CatalogueEntry(
    example="gain switch reached within 5 s",
    pattern=r"gain switch reached within (?!.* iterations$)(.+)",
    make=lambda match, _, place: GainSwitchReached(within_s=quantity(match[1], TIME, place)),
    unit=Unit.TIME,
    rationale="the same, for a cell with a cycle time",
    source="the paper, eq. 15",
    margin="time left of the time allowed",
    parameters="the time allowed",
    exercised="the error is above the switch after the last hand has left",
    inconclusive="a hand is near to the end, or the run ends before the time allowed",
    scenario="servoing-alone",
    broken_by="a controller that does nothing",
)

CONVERGED = CatalogueEntry(
    example="converged to the desired pose",
    pattern="converged to the desired pose",
    make=lambda *_: Converged(),
    unit=Unit.LENGTH,
    rationale="small image errors can belong to another pose of the same triangle",
    source="the P3P ambiguity of a triangle; judged by pose",
    margin="1 mm less the distance at the end (and 0.1 degree)",
    parameters="the gains of the settings",
    exercised="the TCP was farther off than that at some tick",
    inconclusive="the run is shorter than the closed form needs",
    scenario="servoing-alone",
    broken_by="a controller that does nothing",
)
