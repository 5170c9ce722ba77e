"""Measure a proposal before any gate: whether it leads away, and its distance from the optimum.

Positions are (n, 3) in the base frame [m]. Results are (n,), in metres, NaN if a proposal or a question is
not finite. The claims about proposals and the command that scores an avoider use the same functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.candidates import continuous_optimum

WRONG_M = 0.060  # from the optimum: over half the repulsion radius, so the answer has another direction


def optimum_in_base_m(settings: Settings, hands: ArrayNx3, tcps: ArrayNx3) -> ArrayNx3:
    """Return the targets (n, 3) of eq. 13 with the continuous optimum t_opt: t_opt + hand_pull (t_tcp - t_h).

    This is the closed form of the networks' target. It is a reference for comparison, not a requirement.

    Args:
        settings: The settings, for the cap of candidates and ``hand_pull``.
        hands: The hands t_h (n, 3).
        tcps: The TCPs t_tcp (n, 3).

    """
    pull = settings.avoidance.hand_pull
    return np.asarray(continuous_optimum(settings, tcps) + pull * (tcps - hands))


def gained_m(hands: ArrayNx3, tcps: ArrayNx3, proposed: ArrayNx3) -> NDArray[np.float64]:  # (n,)
    """Return how far each path leads directly away from the hand, (n,) [m]: (p - t) . (t - h)/|t - h|.

    Along a straight path, the distance from the hand is a convex function. So if the result is zero or more,
    the path never comes nearer to the hand. If the hand is at the TCP, every path leads away, and the result
    is its length.

    Args:
        hands: The hands h (n, 3).
        tcps: The TCPs t (n, 3).
        proposed: The proposed positions p (n, 3).

    """
    path, offset = proposed - tcps, tcps - hands
    distance = np.linalg.norm(offset, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (path * offset).sum(axis=1) / distance
    return np.asarray(np.where(distance == 0.0, np.linalg.norm(path, axis=1), along))


def off_m(proposed: ArrayNx3, optimum: ArrayNx3) -> NDArray[np.float64]:  # (n,)
    """Return the distance of each proposal from the optimum, (n,)."""
    return np.asarray(np.linalg.norm(proposed - optimum, axis=1))


def is_sure(
    spreads_m: ArrayNx3,
    threshold_m: float | NDArray[np.float64],  # (n,)
) -> NDArray[np.bool_]:
    """Return whether each proposal's spread is within the avoider's own threshold on every axis, (n,).

    Args:
        spreads_m: The spreads (n, 3).
        threshold_m: The threshold, or one for each proposal (n,). NaN means no threshold: then every answer
            is sure.

    """
    sure: NDArray[np.bool_] = ~(spreads_m.max(axis=1) > threshold_m)
    return sure
