"""The robot never comes nearer to a hand than a given distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.robot.capsules import load_capsules
from safety_harness.robot.description import ArmModel, load_arm
from safety_harness.robot.distance import closest_approach_between
from safety_harness.settings import Settings
from safety_harness.simulation.truth import cell_capsules
from safety_harness.trace.trace import Trace

RESOLUTION_M = 1e-4
READS = ("joint_position_rad", "hand_position_in_base_m", "elbow_position_in_base_m", "hand_distance_m")


@dataclass(frozen=True, kw_only=True)
class HandDistance:
    """min over time of d(t) - ``minimum_m``, d from any hand or forearm to any link, surface to surface.

    Between two ticks joints and hands are taken to move linearly; the margin is a certified lower
    bound of the distance there, at most 0.1 mm below it.  (What acceleration a adds within a tick
    of 8 ms is at most a dt^2/8, 0.08 mm at 10 m/s^2.)

    Rationale: contact with a moving robot is the hazard itself; ISO/TS 15066 speaks of a
    protective separation distance, of which this is the constant form.  Exercised when a hand
    comes within ``near_m``, by default the critical distance; a run in which none did says nothing.
    """

    minimum_m: float
    near_m: float
    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"hand distance never below {self.minimum_m * 1e3:g} mm"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the closest approach, between ticks too."""
        problem = unreadable(trace, READS)
        if problem is not None:
            return inconclusive(self, problem)
        if not trace.ticks["hand_present"].any():
            return inconclusive(self, "there is no hand in this scenario")
        distance_m, time_s, hand = closest_approach(trace)
        near = trace.ticks["hand_distance_m"].min(axis=1) < self.near_m
        name = trace.scenario.hands[hand].name if hand < len(trace.scenario.hands) else str(hand)
        nearest = int(np.argmin(trace.ticks["hand_distance_m"][:, hand]))
        link = capsule_name(trace, nearest, hand)
        return judged(
            self,
            trace,
            margin=distance_m - self.minimum_m,
            worst_time_s=time_s,
            reason=f"{name}: {_words(distance_m)} {link}",
            exercised=int(np.count_nonzero(np.diff(near.astype(int), prepend=0) == 1)),
        )


def _words(distance_m: float) -> str:
    if distance_m < 0.0:
        return f"{-distance_m * 1e3:.1f} mm inside"
    return f"{distance_m * 1e3:.1f} mm from"


def capsule_name(trace: Trace, tick: int, hand: int) -> str:
    """Which part of the robot is nearest to a hand at a tick."""
    names = _capsules(load_arm(), trace.scenario.settings)[0]
    return names[int(trace.ticks["hand_distance_capsule"][tick, hand])].replace("_", " ")


def closest_approach(trace: Trace) -> tuple[float, float, int]:
    """(distance [m], time [s], hand) of the closest approach of any hand, ticks and between them."""
    arm = load_arm()
    settings = trace.scenario.settings
    _, link_index, start_in_link, end_in_link, radius_m = _capsules(arm, settings)
    ticks = trace.ticks
    best = (np.inf, 0.0, 0)
    for hand in range(ticks["hand_present"].shape[1]):
        if not ticks["hand_present"][:, hand].any():
            continue
        distance_m, index, fraction = _closest_in_trace(
            arm.joint_origins,
            arm.joint_axes,
            arm.flange,
            link_index,
            start_in_link,
            end_in_link,
            radius_m,
            np.ascontiguousarray(ticks["joint_position_rad"]),
            np.ascontiguousarray(ticks["hand_position_in_base_m"][:, hand]),
            np.ascontiguousarray(ticks["elbow_position_in_base_m"][:, hand]),
            np.ascontiguousarray(ticks["hand_distance_m"][:, hand]),
            settings.hand.radius_m,
            settings.hand.forearm_radius_m,
            RESOLUTION_M,
        )
        if distance_m < best[0]:
            times = trace.time_s
            later = times[min(index + 1, len(times) - 1)]
            best = (distance_m, float(times[index] + fraction * (later - times[index])), hand)
    return best


def _capsules(
    arm: ArmModel, settings: Settings
) -> tuple[tuple[str, ...], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    capsules = cell_capsules(load_capsules(arm.name), settings)
    return (
        tuple(capsules.names),
        capsules.link_index,
        capsules.start_in_link,
        capsules.end_in_link,
        capsules.radius_m,
    )


@compiled
def _closest_in_trace(
    joint_origins: NDArray[np.float64],
    joint_axes: NDArray[np.float64],
    flange: NDArray[np.float64],
    link_index: NDArray[np.int64],
    start_in_link: NDArray[np.float64],
    end_in_link: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    joints_rad: NDArray[np.float64],  # (n, 6)
    hands_m: NDArray[np.float64],  # (n, 3)
    elbows_m: NDArray[np.float64],  # (n, 3)
    distance_m: NDArray[np.float64],  # (n,) at the ticks
    hand_radius_m: float,
    forearm_radius_m: float,
    tolerance_m: float,
) -> tuple[float, int, float]:
    """Least distance over a trace: (distance, tick before it, fraction of the way to the next).

    Intervals whose Lipschitz bound already exceeds the best so far are passed over.
    """
    best = np.inf
    index, fraction = 0, 0.0
    for k in range(distance_m.shape[0]):
        if distance_m[k] < best:
            best, index, fraction = distance_m[k], k, 0.0
    for k in range(distance_m.shape[0] - 1):
        bound, where = closest_approach_between(
            joint_origins,
            joint_axes,
            flange,
            link_index,
            start_in_link,
            end_in_link,
            radius_m,
            joints_rad[k],
            joints_rad[k + 1],
            hands_m[k],
            hands_m[k + 1],
            elbows_m[k],
            elbows_m[k + 1],
            hand_radius_m,
            forearm_radius_m,
            tolerance_m,
            best,
        )
        if not bound >= best:  # a NaN must come out, not be passed over
            best, index, fraction = bound, k, where
    return best, index, fraction
