"""The further inputs of an avoider that sees more than two positions, for a question outside of a run.

The arm stands with its TCP at the question's TCP.  One hand rests at the question's hand; it was just
measured there, and its prediction is there too.  A second hand rests beyond the TCP, at 1.5 times the
critical distance.  The seed decides which hand comes first in the inputs.  The module draws no images.
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
    """Return why the inputs of an avoider cannot be drawn; empty if they can be drawn.

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
    """Return the subject, with inputs drawn for each question by the arm and settings of ``region``."""
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
    """A wrapper for an avoider with further inputs: a caller passes the question, and it draws the inputs."""

    region: QuestionRegion

    @property
    def sees(self) -> tuple[str, ...]:
        """The further inputs that a caller has to pass: an empty tuple."""
        return ()

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the avoider's answer for positions (3,); raise AvoiderError if the TCP is out of reach."""
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
