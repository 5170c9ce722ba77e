"""Wrappers of ours hand on what an avoider asks to see."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from examples import VISIT, hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.extensions.selftest.avoider_faults import FaultyAvoider
from safety_harness.extensions.selftest.avoider_faults import asked as soundly
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.seams.contract import Seen
from safety_harness.search.confirm import OtherDraws

OTHER = hand(
    MoveTo(position_in_base_m=(0.95, 0.5, 0.3), speed_mps=0.5),
    Wait(duration_s=2.0),
    name="left",
    at=(1.1, 0.75, 0.2),
)
TWO_HANDS = scenario(VISIT, OTHER, duration_s=1.6)


@dataclass(eq=False)
class Watching:
    """Goes up, and notes down what it was asked and shown."""

    sees: tuple[str, ...] = ("joints", "hands", "object", "predicted hands")
    decision_time_s: float | None = None
    shown: list[tuple[np.ndarray, np.ndarray, Seen]] = field(default_factory=list)
    name = "watching"

    def propose(
        self,
        *,
        hand_position_in_base_m: np.ndarray,
        tcp_position_in_base_m: np.ndarray,
        seed: int,
        seen: Seen,
    ) -> Proposal:
        """100 mm up."""
        self.shown.append((hand_position_in_base_m, tcp_position_in_base_m, seen))
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


def test_wrappers_of_ours_hand_on_what_is_seen() -> None:
    for wrap in (lambda one: OtherDraws(one, 1), lambda one: FaultyAvoider(one, soundly)):
        avoider = Watching()
        run_kinematic(admit(TWO_HANDS, avoider=wrap(avoider)))  # type: ignore[no-untyped-call]
        assert avoider.shown
