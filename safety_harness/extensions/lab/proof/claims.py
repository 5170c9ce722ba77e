"""What can be proven about answers: each claim a quantity of one question, and the limit that it must keep.

A question is a hand h and a TCP t, the answer p; all in the base frame [m].

* steps at most / at least D: |p - t| <= D, or >= D.
* within E of the optimum: |p - o(h, t)| <= E, where o = t_opt + pull (t - h) with the continuous optimum of
  ``cell.avoidance.candidates``, for the settings' defaults.
* uncertain or within E of the optimum: so it is, or the spread over the members is above the network's own
  threshold on an axis, so that the gate refuses the answer.
* leads away: (p - t) . (t - h) >= 0.  Then no point of the straight way from t to p is nearer to h than t is,
  since the squared distance along the way is convex and does not fall at its beginning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.candidates import CandidateCap, continuous_optimum
from safety_harness.cell.avoidance.model_file import Model
from safety_harness.scenario.fields import Field
from safety_harness.scenario.units import LENGTH, nice, parse_quantity

Floats = NDArray[np.float64]


class ClaimKind(IntEnum):
    """Numbers are part of the compiled kernel."""

    AT_MOST = 0
    AT_LEAST = 1
    OPTIMUM = 2
    AWAY = 3
    UNSURE = 4
    CERTAIN = 5  # a spread of at most the limit on each axis: of single decisions alone


_PATTERNS = {
    ClaimKind.AT_MOST: "steps at most {}",
    ClaimKind.AT_LEAST: "steps at least {}",
    ClaimKind.OPTIMUM: "within {} of the optimum",
    ClaimKind.AWAY: "leads away",
    ClaimKind.UNSURE: "uncertain or within {} of the optimum",
}


@dataclass(frozen=True)
class DecisionClaim:
    """A kind with its limit [m]; 0 for ``AWAY``."""

    kind: ClaimKind
    limit_m: float

    @property
    def sentence(self) -> str:
        """As a plan has it."""
        return _PATTERNS[self.kind].format(nice(self.limit_m, LENGTH))

    def margins(
        self, hands: ArrayNx3, tcps: ArrayNx3, answers: ArrayNx3, doubt_m: Floats | None = None
    ) -> Floats:
        """(n,) by how much answers (n, 3) to hands and TCPs (n, 3) keep it, in m (AWAY: m2); below 0: not.

        ``doubt_m`` (n,) is by how much the largest axis's spread is above the network's threshold.
        """
        steps = answers - tcps
        if self.kind is ClaimKind.AWAY:
            away: Floats = (steps * (tcps - hands)).sum(axis=1)
            return away
        if self.kind in (ClaimKind.OPTIMUM, ClaimKind.UNSURE):
            pull = DEFAULTS.avoidance.hand_pull
            steps = answers - continuous_optimum(DEFAULTS, tcps) - pull * (tcps - hands)
        below: Floats = self.limit_m - np.linalg.norm(steps, axis=1)
        if self.kind is ClaimKind.UNSURE and doubt_m is not None:
            return np.maximum(below, doubt_m)
        return -below if self.kind is ClaimKind.AT_LEAST else below


class Answering(Protocol):
    """What can be asked many questions; ``model`` is None for a function without a file of our own."""

    @property
    def model(self) -> Model | None:
        """What its file holds."""

    def propose_many(
        self, hands_in_base_m: ArrayNx3, tcps_in_base_m: ArrayNx3, seeds: NDArray[np.uint64]
    ) -> tuple[ArrayNx3, ArrayNx3]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,)."""


def margins_of(avoider: Answering, claim: DecisionClaim, questions: Floats) -> Floats:
    """(n,) margins of what the network itself answers to ``questions`` (n, 6), hands and TCPs."""
    hands, tcps = questions[:, :3], questions[:, 3:]
    answers, spreads = avoider.propose_many(hands, tcps, np.zeros(len(questions), np.uint64))
    return claim.margins(hands, tcps, answers, spreads.max(axis=1) - threshold_m(avoider.model))


def threshold_m(model: Model | None) -> float:
    """The largest spread with which the gate takes an answer; NaN for a network without one."""
    threshold = None if model is None or model.members == 1 else model.spread_threshold_m
    return np.nan if threshold is None else threshold


def read_claim(field: Field) -> DecisionClaim:
    """The claim that a sentence makes; ScenarioError with the four sentences for any other."""
    expected = ", ".join(pattern.format("80 mm") for pattern in _PATTERNS.values())
    text = " ".join(field.sentence(f"one of the claims: {expected}").split())
    for kind, pattern in _PATTERNS.items():
        found = re.fullmatch(re.escape(pattern).replace(r"\{\}", "(.+?)"), text)
        if found:
            limit_m = parse_quantity(found[1], LENGTH, field.place) if found.groups() else 0.0
            if found.groups() and not 0.0 < limit_m <= LENGTH.most:
                raise field.error(f"a length above 0 and at most {LENGTH.most:g} m")
            return DecisionClaim(kind, limit_m)
    raise field.error(f"one of the claims: {expected}")


def optimum_constants() -> Floats:
    """(10,) what the kernel needs of the optimum: desired position, axis, radius, cosine and sine, pull."""
    cap = CandidateCap.from_settings(DEFAULTS)
    desired = DEFAULTS.cell.desired_tcp_position_in_base_m
    rest = (cap.radius_m, np.cos(cap.cone_rad), np.sin(cap.cone_rad), DEFAULTS.avoidance.hand_pull)
    return np.array([*desired, *cap.axis_in_base, *rest])
