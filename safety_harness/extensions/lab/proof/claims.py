"""Define claims that a proof can decide.

A claim limits a quantity that depends on one input and on the answer to this input. An input consists of a
hand h and a TCP t, and the answer is p.  All three are positions in the base frame [m].

* steps at most D: |p - t| <= D.
* steps at least D: |p - t| >= D.
* within E of the optimum: |p - o(h, t)| <= E.  Here o = t_opt + pull (t - h), where t_opt is the continuous
  optimum of ``cell.avoidance.candidates`` for the default settings.
* uncertain or within E of the optimum: the same limit, except for answers whose spread over the members
  exceeds the network's threshold on an axis.  The gate refuses such answers.
* leads away: (p - t) . (t - h) >= 0.  The point nearest to h on the straight path from t to p is then t,
  because the squared distance along the path is convex and does not decrease at the start.
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
    """The kinds of claims; the compiled kernel uses the same numbers for them."""

    AT_MOST = 0
    AT_LEAST = 1
    OPTIMUM = 2
    AWAY = 3
    UNSURE = 4
    CERTAIN = 5  # a spread of at most the limit on each axis; used only for single decisions


_PATTERNS = {
    ClaimKind.AT_MOST: "steps at most {}",
    ClaimKind.AT_LEAST: "steps at least {}",
    ClaimKind.OPTIMUM: "within {} of the optimum",
    ClaimKind.AWAY: "leads away",
    ClaimKind.UNSURE: "uncertain or within {} of the optimum",
}


@dataclass(frozen=True)
class DecisionClaim:
    """A claim about decisions: its kind and its limit [m], which is 0 for ``AWAY``."""

    kind: ClaimKind
    limit_m: float

    @property
    def sentence(self) -> str:
        """The sentence that states the claim in a plan."""
        return _PATTERNS[self.kind].format(nice(self.limit_m, LENGTH))

    def margins(
        self, hands: ArrayNx3, tcps: ArrayNx3, answers: ArrayNx3, doubt_m: Floats | None = None
    ) -> Floats:
        """Return the margin of each answer, shape (n,), in m, or in m2 for AWAY.

        A negative margin is a violation of the claim.

        Args:
            hands: (n, 3) the hands [m].
            tcps: (n, 3) the TCPs [m].
            answers: (n, 3) the answers [m].
            doubt_m: (n,) the largest spread over the axes minus the network's threshold.  None means that the
                network has no spread.

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
    """An avoider that answers many inputs in one call.

    ``model`` is None unless the avoider comes from a model file of this package.
    """

    @property
    def model(self) -> Model | None:
        """The contents of the model file."""

    def propose_many(
        self, hands_in_base_m: ArrayNx3, tcps_in_base_m: ArrayNx3, seeds: NDArray[np.uint64]
    ) -> tuple[ArrayNx3, ArrayNx3]:
        """Return n positions and spreads, shape (n, 3) each [m].

        Hands and TCPs have the shape (n, 3), and seeds have the shape (n,).
        """


def margins_of(avoider: Answering, claim: DecisionClaim, questions: Floats) -> Floats:
    """Return the margins of the network's answers to ``questions``, shape (n,).

    Args:
        avoider: The network.
        claim: The claim.
        questions: (n, 6) hands and TCPs in the base frame [m].

    """
    hands, tcps = questions[:, :3], questions[:, 3:]
    answers, spreads = avoider.propose_many(hands, tcps, np.zeros(len(questions), np.uint64))
    return claim.margins(hands, tcps, answers, spreads.max(axis=1) - threshold_m(avoider.model))


def threshold_m(model: Model | None) -> float:
    """Return the largest spread that the gate accepts, or NaN if the network has no threshold."""
    threshold = None if model is None or model.members == 1 else model.spread_threshold_m
    return np.nan if threshold is None else threshold


def read_claim(field: Field) -> DecisionClaim:
    """Return the claim that a sentence states.

    Raise ScenarioError for an unknown sentence; the error lists all known sentences.
    """
    expected = ", ".join(pattern.format("80 mm") for pattern in _PATTERNS.values())
    text = " ".join(field.sentence(f"one of the claims: {expected}").split())
    for kind, pattern in _PATTERNS.items():
        match = re.fullmatch(re.escape(pattern).replace(r"\{\}", "(.+?)"), text)
        if match:
            limit_m = parse_quantity(match[1], LENGTH, field.place) if match.groups() else 0.0
            if match.groups() and not 0.0 < limit_m <= LENGTH.most:
                raise field.error(f"a length above 0 and at most {LENGTH.most:g} m")
            return DecisionClaim(kind, limit_m)
    raise field.error(f"one of the claims: {expected}")


def optimum_constants() -> Floats:
    """Return the constants that define the optimum, shape (10,).

    They are the desired position, the cone's axis, the radius, the cosine and sine of the cone's angle, and
    the pull.
    """
    cap = CandidateCap.from_settings(DEFAULTS)
    desired = DEFAULTS.cell.desired_tcp_position_in_base_m
    rest = (cap.radius_m, np.cos(cap.cone_rad), np.sin(cap.cone_rad), DEFAULTS.avoidance.hand_pull)
    return np.array([*desired, *cap.axis_in_base, *rest])
