"""Measure a proposal before any gate.

The measures are whether the path leads away from the hand, and the distance of the proposal from the optimum.
All positions have the shape (n, 3) and are in the base frame [m]. Results have the shape (n,) and are in
metres. A result is NaN if its proposal or its question is not finite. The claims about proposals and the
command that scores an avoider use these functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.candidates import continuous_optimum

WRONG_M = 0.060  # from the optimum: over half the repulsion radius, so the answer has another direction


def optimum_in_base_m(settings: Settings, hands: ArrayNx3, tcps: ArrayNx3) -> ArrayNx3:
    """Return the targets of eq. 13, t_opt + hand_pull (t_tcp - t_h), shape (n, 3).

    Here t_opt is the continuous optimum. The result is the closed form of the targets that the networks
    learn. This form is a reference for comparison, not a requirement.

    Args:
        settings: The settings, with the cap of candidates and ``hand_pull``.
        hands: The hands t_h (n, 3).
        tcps: The TCPs t_tcp (n, 3).

    """
    pull = settings.avoidance.hand_pull
    return np.asarray(continuous_optimum(settings, tcps) + pull * (tcps - hands))


def gained_m(hands: ArrayNx3, tcps: ArrayNx3, proposed: ArrayNx3) -> NDArray[np.float64]:  # (n,)
    """Return how far [m] each path leads directly away from the hand, shape (n,).

    The result is dot(p - t, t - h)/|t - h|. Along a straight path, the distance from the hand is a convex
    function. So if the result is zero or more, the path never comes nearer to the hand. If the hand is at the
    TCP, every path leads away, and the result is the length of the path.

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
    """Return the distance of each proposal from the optimum, shape (n,)."""
    return np.asarray(np.linalg.norm(proposed - optimum, axis=1))


def is_sure(
    spreads_m: ArrayNx3,
    threshold_m: float | NDArray[np.float64],  # (n,)
) -> NDArray[np.bool_]:
    """Return whether each proposal's spread is within the avoider's threshold on every axis, shape (n,).

    Args:
        spreads_m: The spreads (n, 3).
        threshold_m: The threshold, either one number or one number for each proposal (n,). NaN means no
            threshold: then every answer is sure.

    """
    sure: NDArray[np.bool_] = ~(spreads_m.max(axis=1) > threshold_m)
    return sure
