"""How near the hands are to the arm's surface, and to the TCP, at every tick and from each to the next."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.formulas.cells import absent, rises, tcp_way_m, tent
from safety_harness.formulas.signal import Sampled
from safety_harness.properties.hand_distance import (
    RESOLUTION_M,
    followed_hands,
    instants,
    joint_bend_m,
)
from safety_harness.properties.hand_paths import HandPaths, hand_bend_m
from safety_harness.properties.true_motion import capsules_of, joint_reach_m
from safety_harness.robot.closest_approach import MAX_BISECTIONS, approach_between
from safety_harness.robot.description import load_arm
from safety_harness.trace.trace import Trace


@lru_cache(maxsize=4)
def hand_distance_of(trace: Trace) -> Sampled:
    """Of any hand or forearm from any link, surface to surface, with the bounds of the catalogue's claim.

    Between two ticks it is not below the certified bound of ``HandDistance``, and not above what
    both ends and the ways of arm and hand allow.  Occasions: a hand comes within the critical
    distance of the arm's surface.
    """
    paths, why = followed_hands(trace)
    if paths is None:
        return absent(trace, why)
    value = trace.ticks["hand_distance_m"][:, : len(trace.scenario.hands)]
    low, high = value.copy(), value.copy()
    for hand in range(value.shape[1]):
        way_m, slack_m = _ways(trace, paths, hand)
        low[:-1, hand] = np.minimum(low[:-1, hand], _certified(trace, paths, hand))
        high[:-1, hand] = tent(value[:, hand], way_m, slack_m)[1]
    return _nearest(trace, value, low, high)


@lru_cache(maxsize=4)
def nearest_hand_to_tcp_of(trace: Trace) -> Sampled:
    """From the TCP to the nearest hand's centre; bounded between ticks by the ways of both."""
    paths, why = followed_hands(trace)
    if paths is None:
        return absent(trace, why)
    tcp = trace.ticks["transform_tcp_to_base"][:, None, :3, 3]
    hands = trace.ticks["hand_position_in_base_m"][:, : len(trace.scenario.hands)]
    value = np.linalg.norm(hands - tcp, axis=2)  # (n, hands)
    low, high = value.copy(), value.copy()
    for hand in range(value.shape[1]):
        way_m = tcp_way_m(trace) + _path_m(trace, paths, hand)[0]
        slack_m = hand_bend_m(trace, paths, hand)
        low[:-1, hand], high[:-1, hand] = tent(value[:, hand], way_m, slack_m)
    return _nearest(trace, value, low, high)


def _nearest(
    trace: Trace, value: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> Sampled:
    """The nearest of the hands of (n, hands) distances and bounds of them."""
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    near = value.min(axis=1) < critical_m
    return Sampled(
        value=value.min(axis=1),
        low=low.min(axis=1),
        high=high.min(axis=1),
        occasions=rises(near),
        untried=f"no hand comes within {critical_m * 1e3:g} mm",
    )


def _path_m(trace: Trace, paths: HandPaths, hand: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n-1,) ways of a hand and of its elbow within each tick [m], corners of a recording included."""
    at, _, hand_m, elbow_m, _, _ = instants(trace, paths, hand)
    tick = np.minimum(at[:-1].astype(int), max(len(trace.ticks) - 2, 0))
    ways = np.zeros((2, max(len(trace.ticks) - 1, 0)))
    for way, points in zip(ways, (hand_m, elbow_m), strict=True):
        np.add.at(way, tick, np.linalg.norm(np.diff(points, axis=0), axis=1))
    return ways[0], ways[1]


def _ways(trace: Trace, paths: HandPaths, hand: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n-1,) how far arm and hand can go to or from each other within a tick, and by how much they bend."""
    turned = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0))
    hand_m, elbow_m = _path_m(trace, paths, hand)
    way_m = turned @ joint_reach_m(trace) + np.maximum(hand_m, elbow_m)
    return way_m, joint_bend_m(trace) + hand_bend_m(trace, paths, hand)


def _certified(trace: Trace, paths: HandPaths, hand: int) -> NDArray[np.float64]:
    """(n-1,) lower bound of one hand's distance within each tick; NaN where it is not known."""
    arm = load_arm(trace.scenario.robot.arm_name)
    settings = trace.scenario.settings
    capsules = capsules_of(trace)
    at, joints_rad, hand_m, elbow_m, _, slack_m = instants(trace, paths, hand)
    bounds = _bounds(
        arm.joint_origins,
        arm.joint_axes,
        arm.flange,
        capsules.link_index,
        capsules.start_in_link,
        capsules.end_in_link,
        capsules.radius_m,
        joints_rad,
        hand_m,
        elbow_m,
        joint_reach_m(trace),
        settings.hand.radius_m,
        settings.hand.forearm_radius_m,
        RESOLUTION_M,
    )
    least = np.full(max(len(trace.ticks) - 1, 0), np.inf)
    tick = np.minimum(at[:-1].astype(int), max(len(least) - 1, 0))
    np.minimum.at(least, tick, bounds - slack_m)
    return least


@compiled
def _bounds(
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
    reach_m: NDArray[np.float64],  # (6,) of ``chain_lengths``
    hand_radius_m: float,
    forearm_radius_m: float,
    tolerance_m: float,
) -> NDArray[np.float64]:
    """(n-1,) certified lower bound of the distance from each instant to the next."""
    bounds = np.empty(max(joints_rad.shape[0] - 1, 0))
    room = np.empty((MAX_BISECTIONS + 1, radius_m.shape[0], 2, 3))
    for k in range(bounds.shape[0]):
        bounds[k], _, _ = approach_between(
            joint_origins,
            joint_axes,
            flange,
            link_index,
            start_in_link,
            end_in_link,
            radius_m,
            reach_m,
            room,
            joints_rad[k],
            joints_rad[k + 1],
            hands_m[k],
            hands_m[k + 1],
            elbows_m[k],
            elbows_m[k + 1],
            hand_radius_m,
            forearm_radius_m,
            tolerance_m,
            np.inf,
        )
    return bounds
