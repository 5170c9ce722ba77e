"""Compute the further inputs of an avoider that has more inputs than the positions of hand and TCP.

Scoring asks such an avoider questions outside of a run, so there is no simulation that provides these inputs.
The module assumes that the arm's TCP is at the TCP position of the question.  A first hand rests at the hand
position of the question, and its measured and predicted positions are there too.  A second hand rests on the
other side of the TCP, at 1.5 times the critical distance.  The seed determines the order of the two hands in
the inputs.  The module cannot compute images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from safety_harness.base.exceptions import AvoiderError
from safety_harness.cell.avoidance.avoider import AvoiderAround, Proposal, Vector, shown_to
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.robot.robots import inverse_kinematics
from safety_harness.extensions.lab.scoring.regions import QuestionRegion
from safety_harness.extensions.lab.scoring.repeats import Subject
from safety_harness.seams.contract import HANDS, JOINTS, PREDICTED_HANDS
from safety_harness.seams.rows import seen_dtype, unpacked

DRAWN = (JOINTS, HANDS, PREDICTED_HANDS)
VARIANCES = np.diag([1e-4] * 3 + [1e-2] * 3)  # of a predicted hand: (10 mm)^2, (0.1 m/s)^2 along each axis


def why_not_shown(subject: Subject, regions: Sequence[QuestionRegion]) -> str:
    """Return the reason why the module cannot compute the inputs of an avoider.

    The text is empty if the module can compute them.

    Args:
        subject: The avoider.
        regions: The regions of the questions.

    """
    missing = [name for name in shown_to(subject.avoider) if name not in DRAWN]
    if missing:
        return f"it sees {', '.join(missing)}, which no question outside of a run has"
    several = len({(region.settings, region.robot) for region in regions}) > 1
    return "the regions are of several arms or settings" if shown_to(subject.avoider) and several else ""


def shown(subject: Subject, region: QuestionRegion) -> Subject:
    """Return a copy of the subject whose avoider receives computed inputs.

    The inputs of each question come from the arm and the settings of ``region``.
    """
    if not shown_to(subject.avoider):
        return subject
    return replace(
        subject,
        avoider=ShownAvoider(subject.avoider, region),
        another=lambda: ShownAvoider(subject.another(), region),
        apart=lambda: ShownAvoider(subject.apart(), region),
    )


@dataclass(frozen=True, eq=False)
class ShownAvoider(AvoiderAround):
    """A wrapper for an avoider with further inputs, which it computes from each question."""

    region: QuestionRegion

    @property
    def sees(self) -> tuple[str, ...]:
        """The further inputs that a caller must pass, which is an empty tuple."""
        return ()

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the avoider's answer for positions of shape (3,).

        Raise AvoiderError if the arm cannot reach the TCP.
        """
        settings, robot = self.region.settings, self.region.robot
        pose = desired_transform_tcp_to_base(settings)
        pose[:3, 3] = tcp_position_in_base_m
        joints = inverse_kinematics(robot).nearest(pose, np.array(settings.cell.preferred_joint_position_rad))
        if joints is None:
            raise AvoiderError("the arm does not reach the TCP of the question")
        row = np.zeros((), seen_dtype(2, len(joints)))
        row["joint_position_rad"], row["transform_tcp_to_base"] = joints, pose
        row["tcp_position_in_base_m"] = tcp_position_in_base_m
        away = tcp_position_in_base_m - hand_position_in_base_m
        away *= 1.5 * settings.avoidance.critical_distance_m / max(float(np.linalg.norm(away)), 1e-9)
        hands = [hand_position_in_base_m, tcp_position_in_base_m + away][:: 1 if seed % 2 else -1]
        row["hand_count"], row["tracked"][:2] = 2, (1, 2)
        row["hands"][:2] = row["predicted"][:2] = hands
        row["predicted_covariance"][:2] = VARIANCES
        sees, period_s = shown_to(self.avoider), settings.clock.control_period_s
        return self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=seed,
            seen=unpacked((period_s, 2, len(joints), sees, row.tobytes())),  # type: ignore[call-arg]
        )
