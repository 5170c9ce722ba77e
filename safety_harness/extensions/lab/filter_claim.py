"""Check that a safety filter does not change commands that cannot harm a hand.

A filter that always stops the arm prevents every contact, but the arm then does no work.  The claim uses the
true positions of the hands, an upper bound on their speed, and the deceleration of the braking arm.  Let the
arm execute a command for one control period and then brake.  The command is harmless if no moving part can
meet a hand before the arm stands still.  The claim applies the rule of the shield
(``cell.controller.shield``) with exact positions.  According to this rule, a harmless command needs no
reduction of its speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.controller.shield import (
    ShieldRecords,
    clearances,
    fastest_point,
    guard_of,
    share_within,
)
from safety_harness.cell.robot.description import ChainRecords
from safety_harness.cell.robot.distance import CapsuleRecords
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.properties.base import Evaluation, Unit, Worded, inconclusive, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.scenario.shield import Shield
from safety_harness.trace.limiting import changed_by_filter, overridden_stops
from safety_harness.trace.trace import Trace

JOINTS, HANDS, ELBOWS = "joint_position_rad", "hand_position_in_base_m", "elbow_position_in_base_m"


@dataclass(frozen=True, kw_only=True)
class HarmlessUnchanged(Worded):
    """A claim about safety filters: they change no harmless command.

    The margin is the least 1 - s over all commands that the filter changed.  Here s is the fraction of the
    command's speed that the rule allows.

    A protective stop of the controller is always harmless.  If the filter overrides a protective stop, it
    therefore violates the claim.

    A run exercises the claim if the filter received at least one harmless command that moves the arm while a
    hand was present.
    """

    hand_speed_mps: float
    deceleration_mps2: float
    unit: Unit = Unit.FRACTION
    wording: ClassVar[str] = (
        "the safety filter changes no command that is harmless to hands of {hand_speed_mps:m/s}, "
        "braking at {deceleration_mps2:m/s2}"
    )

    @reads(JOINTS, HANDS, ELBOWS, also=["limits"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Evaluate each command that moves the arm while a hand is present."""
        if not trace.scenario.safety_filter:
            return inconclusive(self, "the run has no safety filter")
        if overridden := overridden_stops(trace):
            reason = f"the filter moved the arm in spite of {overridden} protective stops of the controller"
            return judged(self, trace, -1.0, trace.time_s[-1], reason, overridden)
        if not trace.ticks["hand_present"].any():
            return unexercised(self, "no hand was there")
        shares = self._shares(trace)
        beside_hand = trace.ticks["hand_present"].any(axis=1) & np.isfinite(shares)
        harmless = beside_hand & (shares >= 1.0)
        if not harmless.any():
            return unexercised(self, "every command that moved the arm could have harmed a hand")
        changed = beside_hand & changed_by_filter(trace) & ~trace.filtered["held"]
        if not changed.any():
            reason = (
                f"unchanged: all {int(beside_hand.sum())} commands that moved the arm while a hand was there"
            )
            return judged(self, trace, 1.0, trace.time_s[-1], reason, int(harmless.sum()))
        tick = int(np.argmax(np.where(changed, shares, -np.inf)))
        needless = int((changed & harmless).sum())
        reason = f"changed {needless} of {int(harmless.sum())} harmless commands"
        return judged(self, trace, 1.0 - shares[tick], trace.time_s[tick], reason, int(harmless.sum()))

    def _shares(self, trace: Trace) -> NDArray[np.float64]:
        """Return the fraction of each requested command that the rule allows, shape (n,).

        The fraction is infinite if the command moves no joint or if no hand is present.
        """
        scenario, ticks = trace.scenario, trace.ticks
        size, hands = scenario.settings.hand, len(scenario.hands)
        at_m, elbow_m = ticks[HANDS][:, :hands], ticks[ELBOWS][:, :hands]
        there = ticks["hand_present"][:, :hands]
        reach_m = np.where(there, np.linalg.norm(elbow_m - at_m, axis=2), 0.0).max(initial=0.0)
        assumed = Shield(
            hand_speed_mps=self.hand_speed_mps,
            body_m=max(size.radius_m, float(reach_m) + size.forearm_radius_m),
            uncertainty_m=0.0,
            deceleration_mps2=self.deceleration_mps2,
        )
        arm = arm_model(scenario.robot)
        capsules = cell_capsules(arm_capsules(scenario.robot), scenario.settings)
        guard = guard_of(assumed, scenario.settings, arm, capsules, 1, scenario.hand_slots)
        shares = np.full(len(ticks), np.inf)
        wanted = np.where(trace.filtered["wanted_stop"][:, None], 0.0, trace.filtered["wanted_radps"])
        _allowed(
            arm.chain,
            guard.shield,
            guard.capsules,
            np.ascontiguousarray(ticks[JOINTS]),
            np.ascontiguousarray(wanted),
            np.ascontiguousarray(at_m),
            np.ascontiguousarray(there.astype(np.bool_)),
            scenario.settings.clock.control_period_s,
            shares,
        )
        return shares


@compiled
def _allowed(
    chains: ChainRecords,
    shields: ShieldRecords,
    capsules: CapsuleRecords,
    joints_rad: NDArray[np.float64],  # (n, joints)
    wanted_radps: NDArray[np.float64],  # (n, joints)
    hands_m: NDArray[np.float64],  # (n, hands, 3)
    there: NDArray[np.bool_],  # (n, hands)
    period_s: float,
    shares: NDArray[np.float64],  # (n,) written
) -> None:
    """Write to ``shares`` the fraction of each requested command that the shield's rule allows.

    A fraction may exceed 1.

    If a command moves no joint, or if there is no hand at a tick, the function does not change the entry.
    """
    g, axes, joints = shields[0], chains[0].joint_axes, joints_rad.shape[1]
    transforms = np.empty((joints + 2, 4, 4))
    for k in range(joints_rad.shape[0]):
        bend, rate_sum, count = 0.0, 0.0, 0
        for j in range(joints):
            # A of the shield's rule: it bounds how far a point leaves its straight line
            # (docs/explanation/shield.md).
            rate = abs(wanted_radps[k, j])
            bend += rate * g.reach_m[j] * (rate + 2.0 * rate_sum)
            rate_sum += rate
        for hand in range(there.shape[1]):
            if there[k, hand]:
                for i in range(3):
                    g.hand_in_base_m[0, count, i] = hands_m[k, hand, i]
                count += 1
        g.count[0] = count
        if rate_sum == 0.0 or count == 0:
            continue
        forward_kinematics(chains[0], joints_rad[k], transforms)
        clearances(transforms, shields, capsules)
        fastest_mps = fastest_point(axes, transforms, wanted_radps[k], shields, capsules)
        stop_s = fastest_mps / g.deceleration_mps2
        # One period at the commanded speed, then uniform braking.
        way_s = period_s + 0.5 * stop_s
        robot_m = fastest_mps * way_s + 0.5 * bend * way_s * way_s
        for i in range(count):
            free_m = g.clearance_m[i] - g.body_m
            own = share_within(free_m, robot_m, period_s, stop_s, g.hand_speed_mps, 0.0)
            if not own >= shares[k] and not np.isnan(shares[k]):  # NaN of one hand stays
                shares[k] = own


HARMLESS_UNCHANGED = CatalogueEntry(
    prop=HarmlessUnchanged(hand_speed_mps=2.0, deceleration_mps2=1.0),
    rationale="a filter that stops the arm without need prevents contact, but nobody will keep the filter",
    source="the shield's rule, applied to the true hands (see explanation/shield)",
    margin=(
        "1 minus the fraction of a changed command that the rule allows; the least value over "
        "the changed commands. The margin is -100 % if the filter overrode a protective stop "
        "of the controller"
    ),
    parameters=(
        "the greatest speed of a hand and the arm's deceleration; the model of a hand and its "
        "forearm is a ball around the hand's centre that contains the elbow"
    ),
    exercised="the filter gets a harmless command while a hand is present",
    inconclusive="the run has no safety filter",
    broken_by="a filter that stops the arm at every hand",
)
