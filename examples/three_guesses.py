"""An avoider that says how certain it is: the mean of three guesses, used only while they agree.

safety-harness run shipped:hand-visits-and-leaves --avoider shipped:three_guesses.py:guesses
"""

from dataclasses import dataclass

import numpy as np

from safety_harness import Proposal


@dataclass(frozen=True)
class ThreeGuesses:
    """Away from where the hand is, and from two places about ``doubt_m`` beside it."""

    radius_m: float
    doubt_m: float
    spread_threshold_m: float  # the gate refuses a proposal that is spread farther than this on any axis
    name: str = "three guesses"

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        """Random numbers come from the decision's seed alone, so that a run repeats bit for bit."""
        beside = np.random.default_rng(seed).normal(0.0, self.doubt_m, (3, 3))
        beside[0] = 0.0
        away = tcp_position_in_base_m - (hand_position_in_base_m + beside)  # (3, 3)
        away *= self.radius_m / np.linalg.norm(away, axis=1, keepdims=True)
        guesses = tcp_position_in_base_m + away
        return Proposal(guesses.mean(axis=0), guesses.std(axis=0))


guesses = ThreeGuesses(radius_m=0.1, doubt_m=0.01, spread_threshold_m=0.02)
hesitant = ThreeGuesses(radius_m=0.1, doubt_m=0.3, spread_threshold_m=0.02)
