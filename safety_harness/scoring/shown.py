"""What an avoider that sees more is shown with a question outside of a run.

The arm stands where its TCP is the question's, and one hand rests at the question's place: it was just
measured there, and is predicted to stay.  Images are not drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from safety_harness.avoidance.asking import Answer, OutOfProcessAvoider, Question, ask
from safety_harness.avoidance.avoider import (
    Avoider,
    Proposal,
    Vector,
    decision_time_of,
    shown_to,
    spread_threshold_of,
)
from safety_harness.controller.contract import HANDS, JOINTS, PREDICTED_HANDS, Seen
from safety_harness.controller.desired import desired_transform_tcp_to_base
from safety_harness.controller.rows import seen_dtype, unpacked
from safety_harness.exceptions import AvoiderError
from safety_harness.robot.robots import inverse_kinematics
from safety_harness.scoring.regions import QuestionRegion
from safety_harness.scoring.repeats import Subject

DRAWN = (JOINTS, HANDS, PREDICTED_HANDS)
VARIANCES = np.diag([1e-4] * 3 + [1e-2] * 3)  # of a predicted hand: 10 mm and 0.1 m/s along each axis


def why_not_shown(subject: Subject, regions: Sequence[QuestionRegion]) -> str:
    """Return why what the avoider sees cannot be drawn; empty if it can."""
    missing = [word for word in shown_to(subject.avoider) if word not in DRAWN]
    if missing:
        return f"it sees {', '.join(missing)}, which no question outside of a run has"
    others = any((one.settings, one.robot) != (regions[0].settings, regions[0].robot) for one in regions)
    return "the regions are of several arms or settings" if shown_to(subject.avoider) and others else ""


def shown(subject: Subject, region: QuestionRegion) -> Subject:
    """Return the subject, shown what it sees with each question of ``region``'s arm and settings."""
    if not shown_to(subject.avoider):
        return subject

    def around(make: Callable[[], Avoider]) -> Callable[[], Avoider]:
        return lambda: ShownAvoider(make(), region)

    own, another, apart = (
        ShownAvoider(subject.avoider, region),
        around(subject.another),
        around(subject.apart),
    )
    return replace(subject, avoider=own, another=another, apart=apart)


@dataclass(eq=False)
class ShownAvoider(OutOfProcessAvoider):
    """An avoider that sees more, as one that does not: what it sees is drawn from the question alone."""

    avoider: Avoider
    region: QuestionRegion

    def __post_init__(self) -> None:
        self.name, self.takes_many = self.avoider.name, True
        self.spread_threshold_m = spread_threshold_of(self.avoider)
        self.decision_time_s = decision_time_of(self.avoider)

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """As any avoider; AvoiderError says what was wrong."""
        question = Question(hand_position_in_base_m, tcp_position_in_base_m, seed)
        (answer,) = self.answers([question], together=False)
        if answer.fault:
            raise AvoiderError(answer.fault)
        return answer.proposal

    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """As ``OutOfProcessAvoider`` has it; a fault where the arm cannot stand so."""
        every = self._seen(questions)
        pairs = zip(questions, every, strict=True)
        asked = [question._replace(seen=seen) for question, seen in pairs if seen is not None]
        if isinstance(self.avoider, OutOfProcessAvoider):
            given = iter(self.avoider.answers(asked, together=together) if asked else [])
        else:
            given = (ask(self.avoider, question) for question in asked)
        beyond = Answer(fault="the arm does not reach the TCP of the question")
        return [beyond if seen is None else next(given) for seen in every]

    def _seen(self, questions: Sequence[Question]) -> list[Seen | None]:
        """Return what is seen with each question; None where the arm does not reach its TCP."""
        settings, robot, sees = self.region.settings, self.region.robot, shown_to(self.avoider)
        poses = np.repeat(desired_transform_tcp_to_base(settings)[None], len(questions), axis=0)
        poses[:, :3, 3] = [question.tcp_position_in_base_m for question in questions]
        preferred = np.array(settings.cell.preferred_joint_position_rad)
        joints = inverse_kinematics(robot).nearest_of_each(poses, preferred)
        rows = np.zeros(len(questions), seen_dtype(1, joints.shape[1]))
        rows["joint_position_rad"], rows["transform_tcp_to_base"] = joints, poses
        rows["tcp_position_in_base_m"] = poses[:, :3, 3]
        rows["hand_count"] = rows["tracked"][:, 0] = 1
        hands = np.array([question.hand_position_in_base_m for question in questions]).reshape(-1, 3)
        rows["hands"][:, 0] = rows["predicted"][:, 0] = hands
        rows["predicted_covariance"][:, 0] = VARIANCES
        period_s = settings.clock.control_period_s
        return [
            None
            if np.isnan(row["joint_position_rad"][0])
            else unpacked((period_s, 1, joints.shape[1], sees, row.tobytes()))
            for row in rows
        ]
