"""Compute rewards from violations of claims at each tick, and from progress to the desired pose.

A claim is usable if it assigns a number to each tick, and its margin is the smallest of these numbers in a
run. Each number must depend on its tick alone. Let m_k [SI] be this number at tick k, and T the control
period. A claim of weight w then contributes the reward

    r_k = w T min(m_k, 0).

The reward is zero at a tick that satisfies the claim, and negative at any other tick. If all ticks of an
episode satisfy the claim, the sum of these rewards is 0. With weight w, progress contributes r_k = w (d_(k-1)
- d_k). Here d [m] is the distance of the TCP from the desired position. These rewards ignore the motion
between two ticks, which only the verdicts on a trace judge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Checked
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.base.settings import CONVERGED_POSITION_M
from safety_harness.cell.robot.description import ArmModel
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.formula import Always, Comparison, Relation
from safety_harness.claims.formulas.signals import hand_distance, joint_speed, tcp_height, tcp_speed
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.limits import JointLimits, JointSpeedLimits, TcpSpeedLimit
from safety_harness.claims.signals.signal import Signal
from safety_harness.scenario.model import Claim, Verdict

Floats = NDArray[np.float64]
Ticks = NDArray[np.void]  # (n,) TICK
OfTicks = Callable[[Ticks], Floats]  # (n,) TICK to (n,)
PROGRESS = "progress"
USABLE = (
    "hand distance never below 50 mm, TCP speed never above 250 mm/s, joint speeds within limits, joint "
    'positions within limits, "always hand distance > 80 mm" or the same of TCP speed, TCP height and joint '
    f"speed; {PROGRESS}"
)


def nearest_m(ticks: Ticks) -> Floats:
    """Return the least distance (n,) [m] between the surfaces of the arm and any hand; inf without a hand."""
    nearest: Floats = np.where(ticks["hand_present"], ticks["hand_distance_m"], np.inf).min(axis=1)
    return nearest


_SIGNALS: dict[Signal, OfTicks] = {
    hand_distance: nearest_m,
    tcp_speed: lambda ticks: ticks["tcp_speed_mps"],
    tcp_height: lambda ticks: ticks["transform_tcp_to_base"][:, 2, 3],
    joint_speed: lambda ticks: np.abs(ticks["joint_velocity_radps"]).max(axis=1),
}


def margins_of(claim: Property, arm: ArmModel) -> OfTicks | None:
    """Return a function that computes the claim's numbers at n ticks, or None if the claim is not usable.

    The function maps an array (n,) of the dtype TICK to an array (n,) in SI units.
    """
    lower, upper = arm.position_lower_rad, arm.position_upper_rad
    if isinstance(claim, HandDistance):
        least_m = claim.minimum_m
        return lambda ticks: nearest_m(ticks) - least_m
    if isinstance(claim, TcpSpeedLimit):
        most_mps = claim.maximum_mps
        return lambda ticks: most_mps - ticks["tcp_speed_mps"]
    if isinstance(claim, JointSpeedLimits):
        return lambda ticks: (arm.velocity_limit_radps - np.abs(ticks["joint_velocity_radps"])).min(axis=1)
    if isinstance(claim, JointLimits):
        return lambda ticks: np.minimum(
            ticks["joint_position_rad"] - lower, upper - ticks["joint_position_rad"]
        ).min(axis=1)
    return _formula_margins(claim.formula) if isinstance(claim, FormulaClaim) else None


def _formula_margins(formula: object) -> OfTicks | None:
    """Return the function for a formula such as "always SIGNAL < LIMIT" without a window.

    Return None for another formula, or if SIGNAL does not depend on a single tick.
    """
    if not isinstance(formula, Always) or formula.span is not None:
        return None
    compared = formula.body
    if not isinstance(compared, Comparison) or compared.signal not in _SIGNALS:
        return None
    value, limit = _SIGNALS[compared.signal], compared.limit.value
    sign = 1.0 if compared.relation in (Relation.ABOVE, Relation.AT_LEAST) else -1.0
    return lambda ticks: sign * (value(ticks) - limit)


@dataclass(frozen=True, eq=False)
class Rewards:
    """The claims that affect rewards, their weights, and the claims whose violation ends an episode."""

    margins: Mapping[str, OfTicks]
    weights: Mapping[str, float]  # only the rewarded claims
    ends: tuple[str, ...]
    progress: float
    period_s: float
    desired_tcp_in_base_m: Floats  # (3,)

    @classmethod
    def of_claims(cls, rewards: Mapping[str, float], ends: Sequence[str], checked: Checked) -> Rewards:
        """Return the rewards for the claims whose sentences are in ``rewards`` and ``ends``.

        Args:
            rewards: The weight of each claim, and of "progress". Weights are finite and at least 0.
            ends: Sentences of the claims whose violation ends an episode.
            checked: The first episode, which determines the arm and the settings.

        Raises:
            InadmissibleError: A claim is not usable, or a weight is negative or not finite.

        """
        margins, weights = {}, {}
        settings = checked.scenario.settings
        for name, weight in rewards.items():
            if not (isinstance(weight, int | float) and np.isfinite(weight)):
                raise InadmissibleError.of_option("rewards", f"a number for {name!r}", repr(weight))
            if weight < 0.0:  # it would reward a violation, whose margin is negative already
                raise InadmissibleError.of_option("rewards", f"no negative number for {name!r}", repr(weight))
            if name != PROGRESS:
                weights[name] = float(weight)
        for sentence in (*weights, *ends):
            place = Place(field="rewards" if sentence in weights else "ends")
            claim = Claim(sentence=sentence, expected=Verdict.HOLDS, place=place)
            of_ticks = margins_of(property_of(claim, checked.scenario), checked.arm)
            if of_ticks is None:
                raise InadmissibleError(
                    place=place, expected=f"a claim of single ticks: {USABLE}", got=repr(sentence)
                )
            margins[sentence] = of_ticks
        desired = np.array(settings.cell.desired_tcp_position_in_base_m)
        progress = float(rewards.get(PROGRESS, 0.0))
        return cls(margins, weights, tuple(ends), progress, settings.clock.control_period_s, desired)

    def way_left_m(self, ticks: Ticks) -> Floats:
        """Return the distance (n,) [m] from the TCP to the desired position at ``ticks`` (n,) TICK."""
        left: Floats = np.linalg.norm(
            ticks["transform_tcp_to_base"][:, :3, 3] - self.desired_tcp_in_base_m, axis=1
        )
        return left

    def at(self, ticks: Ticks) -> dict[str, Floats]:
        """Return the margins of each claim at ``ticks`` (n,), shape (n,).

        The margins ignore the motion between ticks.
        """
        return {sentence: of_ticks(ticks) for sentence, of_ticks in self.margins.items()}

    def of_step(self, margins: Mapping[str, Floats], way_m: Floats, way_before_m: Floats) -> Floats:
        """Return the reward (n,) of one step.

        Args:
            margins: The margins (n,) of each claim at the end of the step.
            way_m: The distance (n,) to the desired position at the end of the step [m].
            way_before_m: The distance (n,) at the beginning of the step [m].

        """
        total = self.progress * (way_before_m - way_m)
        for sentence, weight in self.weights.items():
            total += weight * self.period_s * np.minimum(margins[sentence], 0.0)
        return total

    def cost_of(self, margins: Mapping[str, Floats], count: int) -> Floats:
        """Return how many claims are violated at each tick, shape (n,).

        A margin of NaN is a violation.
        """
        cost = np.zeros(count)
        for margin in margins.values():
            cost += ~(margin >= 0.0)
        return cost

    def succeeds(self, least: Mapping[str, Floats], way_m: Floats) -> NDArray[np.bool_]:
        """Return whether the TCP has arrived without a violation of any claim so far, shape (n,).

        Args:
            least: The least margin (n,) of each claim so far.
            way_m: The distance (n,) to the desired position [m].

        """
        return np.asarray((way_m <= CONVERGED_POSITION_M) & (self.cost_of(least, len(way_m)) == 0.0))

    def ends_episode(self, margins: Mapping[str, Floats], count: int) -> NDArray[np.bool_]:
        """Return whether any claim in ``ends`` is violated, shape (n,).

        A margin of NaN is a violation.
        """
        ended = np.zeros(count, np.bool_)
        for sentence in self.ends:
            ended |= ~(margins[sentence] >= 0.0)
        return ended
