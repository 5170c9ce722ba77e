"""The gate between an avoider and the arm: a proposed position is used only if it can be reached.

In turn: the avoider's proposal, the opposite pose under the same checks, a protective stop.
Every check that fails is recorded.  (Reachability means inverse kinematics within the joint
limits along the whole straight way, not a radius.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.avoidance.avoider import Avoider, Proposal, Vector, checked
from safety_harness.avoidance.opposite import OppositePose
from safety_harness.exceptions import AvoiderError
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.settings import Settings
from safety_harness.trace.records import Check, Outcome

NOWHERE = Proposal(np.full(3, np.nan), np.full(3, np.nan))


@dataclass(frozen=True, eq=False)
class Query:
    """What is asked: where the nearest predicted hand, the TCP and the joints are, and a seed."""

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    transform_tcp_to_base: Vector  # (4, 4)
    joint_position_rad: Vector  # (6,)
    seed: int


@dataclass(frozen=True, eq=False)
class Ruling:
    """What the gate decided, and on what grounds.  Positions are NaN where there is none."""

    outcome: Outcome
    chosen_position_in_base_m: Vector
    proposed: Proposal
    opposite: Proposal
    proposed_failed: Check
    opposite_failed: Check


@dataclass(frozen=True, eq=False)
class Gate:
    """Rules on proposals; holds no state between decisions."""

    kinematics: InverseKinematics
    fallback: OppositePose
    min_singular_value: float
    lowest_tcp_height_m: float

    @classmethod
    def of(cls, settings: Settings, kinematics: InverseKinematics) -> Gate:
        """The gate of the settings."""
        return cls(
            kinematics,
            OppositePose(settings.avoidance.radius_m),
            settings.motion.min_singular_value,
            settings.cell.table_height_m + settings.avoidance.table_clearance_m,
        )

    def rule(self, avoider: Avoider, query: Query) -> Ruling:
        """Ask the avoider, check its proposal, fall back to the opposite pose, else stop."""
        proposed, proposed_failed = self._ask(avoider, query)
        opposite, opposite_failed = self._ask(self.fallback, query)
        if not proposed_failed:
            outcome, chosen = Outcome.PROPOSED, proposed.position_in_base_m
        elif not opposite_failed:
            outcome, chosen = Outcome.OPPOSITE, opposite.position_in_base_m
        else:
            outcome, chosen = Outcome.STOP, NOWHERE.position_in_base_m
        return Ruling(outcome, chosen, proposed, opposite, proposed_failed, opposite_failed)

    def _ask(self, avoider: Avoider, query: Query) -> tuple[Proposal, Check]:
        """One avoider's proposal and the checks that it fails.

        Whatever a user's avoider raises is a decision fault, recorded as NOT_FINITE, and never
        the end of the run; only the interpreter's own exits pass.
        """
        try:
            proposal = checked(
                avoider.propose(
                    hand_position_in_base_m=query.hand_position_in_base_m.copy(),
                    tcp_position_in_base_m=query.tcp_position_in_base_m.copy(),
                    seed=query.seed,
                )
            )
        except AvoiderError:
            return NOWHERE, Check.NOT_FINITE
        except Exception:  # a user's code may raise anything
            return NOWHERE, Check.NOT_FINITE
        return proposal, self.check(proposal.position_in_base_m, query)

    def check(self, position_in_base_m: Vector, query: Query) -> Check:
        """Which checks ``position_in_base_m`` fails, the current orientation kept."""
        failed = Check.NONE
        if position_in_base_m[2] < self.lowest_tcp_height_m:
            failed |= Check.TABLE
        target = query.transform_tcp_to_base.copy()
        target[:3, 3] = position_in_base_m
        if self.kinematics.nearest(target, query.joint_position_rad) is None:
            return failed | Check.UNREACHABLE
        way = position_in_base_m - query.transform_tcp_to_base[:3, 3]
        length_m = float(np.linalg.norm(way))
        if length_m > 0.0:
            reach_m = self.kinematics.reach_along(
                query.joint_position_rad,
                way / length_m,
                length_m,
                min_singular_value=self.min_singular_value,
            )
            if reach_m < length_m:
                failed |= Check.PATH_UNREACHABLE
        return failed
