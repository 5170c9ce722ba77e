"""What a proposal is worth before any gate: does it lead away, and how far is it from the optimum?

Positions are (n, 3) in the base frame [m]; what comes back is (n,), in metres, NaN where a proposal or a
question is not finite.  The claims about proposals and the command that scores an avoider measure with the
same functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.candidates import continuous_optimum


def optimum_in_base_m(settings: Settings, hands: ArrayNx3, tcps: ArrayNx3) -> ArrayNx3:
    """(n, 3) eq. 13 with the continuous optimum: gt = t_opt + hand_pull (t_tcp - t_h).

    The closed form of what the networks learn: a yardstick, not a duty.
    """
    pull = settings.avoidance.hand_pull
    return np.asarray(continuous_optimum(settings, tcps) + pull * (tcps - hands))


def gained_m(hands: ArrayNx3, tcps: ArrayNx3, proposed: ArrayNx3) -> NDArray[np.float64]:  # (n,)
    """(n,) the component of the way to a proposal away from the hand: (p - t) . (t - h)/|t - h|.

    The distance from a hand to a straight way is convex: with a component of zero or more the way leads
    away from the hand everywhere.  From a hand at the TCP every way leads away: its whole length counts.
    """
    way, apart = proposed - tcps, tcps - hands
    distance = np.linalg.norm(apart, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.einsum("ij,ij->i", way, apart) / distance
    return np.asarray(np.where(distance == 0.0, np.linalg.norm(way, axis=1), along))


def off_m(proposed: ArrayNx3, optimum: ArrayNx3) -> NDArray[np.float64]:  # (n,)
    """(n,) how far a proposal is from the optimum."""
    return np.asarray(np.linalg.norm(proposed - optimum, axis=1))


def is_sure(
    spreads_m: ArrayNx3,
    threshold_m: float | NDArray[np.float64],  # (n,)
) -> NDArray[np.bool_]:
    """(n,) is no spread (n, 3) above the avoider's own threshold?  Without one (NaN) every answer is sure."""
    sure: NDArray[np.bool_] = ~(spreads_m.max(axis=1) > threshold_m)
    return sure
