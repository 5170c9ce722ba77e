"""The systems that are compared, by name, and an exact oracle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.cell.avoidance.candidates import continuous_optimum
from safety_harness.cell.avoidance.simple import NearestCandidate, OppositePose
from safety_harness_paper.networks import avoider_in
from safety_harness_paper.work import Done

DNN, BAYESIAN, ENSEMBLE = "DNN", "Bayesian DNN", "ensemble"
OPPOSITE, CANDIDATE, OPTIMUM, NONE = "opposite pose", "eq. 13 itself", "exact optimum", "no avoidance"


@dataclass(frozen=True, eq=False)
class ExactOptimum:
    """Eq. 13 with the continuous optimum in place of the selected candidate: an oracle without noise."""

    settings: Settings
    name: str = OPTIMUM

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """The nearest point of the cap to the desired position, pulled off the hand."""
        optimum = continuous_optimum(self.settings, np.asarray(tcp_position_in_base_m)[None])[0]
        away = tcp_position_in_base_m - hand_position_in_base_m
        return Proposal(optimum + self.settings.avoidance.hand_pull * away)


def without_networks(settings: Settings) -> dict[str, Avoider]:
    """Opposite pose and the two oracles."""
    return {
        OPPOSITE: OppositePose(settings.avoidance.radius_m),
        CANDIDATE: NearestCandidate.for_cell(settings),
        OPTIMUM: ExactOptimum(settings),
    }


def with_networks(settings: Settings, dnn: Done, bayesian: Done, *ensemble: Done) -> dict[str, Avoider]:
    """The networks first, in the order of the tables."""
    found: dict[str, Avoider] = {DNN: avoider_in(dnn), BAYESIAN: avoider_in(bayesian)}
    if ensemble:
        found[ENSEMBLE] = avoider_in(ensemble[0])
    return found | without_networks(settings)
