"""The cell for which a network is trained: the arm, the object and the settings of a scenario."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.base.exceptions import DatasetError, Place
from safety_harness.base.geometry.regions import Region
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.base.shipped.contents import located
from safety_harness.cell.controller.desired import reachable
from safety_harness.cell.robot.robots import arm_model
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import AnyRobot, OwnRobot, Robot
from safety_harness.space.regions import paper_seen

TRIED = 200  # random TCPs of the seen box, besides its corners


@dataclass(frozen=True)
class TrainingCell:
    """An arm and the settings of its cell; the default is the UR10's cell."""

    robot: AnyRobot = Robot.UR10
    settings: Settings = DEFAULTS

    @property
    def arm(self) -> str:
        """The arm's name on model cards.

        For an arm of this package, the name is its label.  For a user's own arm, it is the name in the URDF
        file.
        """
        return arm_model(self.robot).name if isinstance(self.robot, OwnRobot) else self.robot.label


UR10_CELL = TrainingCell()


def training_cell(scenario: str | None) -> TrainingCell:
    """Return the training cell that a scenario describes.

    The network learns from TCPs in the box of seen TCPs, so the arm must reach them in the desired
    orientation.  The function checks this for the corners of the box and for 200 random TCPs within the box.

    Args:
        scenario: ``shipped:NAME`` or a file; None means the UR10's cell.

    Raises:
        DatasetError: The arm cannot reach at least one of these TCPs.

    """
    if scenario is None:
        return UR10_CELL
    source = read_scenario(located(scenario))
    box = paper_seen(source.settings).tcp
    corners = np.stack(np.meshgrid(*zip(box.low_m, box.high_m, strict=True)), axis=-1).reshape(-1, 3)
    tcps = np.vstack([corners, Region(box).draw(np.random.default_rng(0), TRIED)])
    missed = tcps[~reachable(tcps, source.settings, source.robot)]
    if len(missed):
        raise DatasetError(
            place=Place(field="--robot"),
            expected=f"an arm that reaches the seen TCPs, {list(box.low_m)} to {list(box.high_m)}",
            got=f"{len(missed)} of {len(tcps)} out of reach, such as {missed[0].round(3).tolist()}",
            hint="settings: {cell: {desired tcp position: ...}} puts their middle elsewhere",
        )
    return TrainingCell(source.robot, source.settings)
