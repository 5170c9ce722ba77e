"""The cell that a network is made for: the arm, the object and the settings of a scenario."""

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

TRIED = 200  # TCPs of the seen box, beside its corners


@dataclass(frozen=True)
class TrainingCell:
    """An arm and what stands around it; by default the UR10's."""

    robot: AnyRobot = Robot.UR10
    settings: Settings = DEFAULTS

    @property
    def arm(self) -> str:
        """What cards call the arm: its name here, or that of its URDF."""
        return arm_model(self.robot).name if isinstance(self.robot, OwnRobot) else self.robot.label


UR10_CELL = TrainingCell()


def training_cell(scenario: str | None) -> TrainingCell:
    """The cell of a scenario, ``shipped:NAME`` or a file; None: the UR10's.

    DatasetError where the arm does not reach all that the network would be shown: the corners of the box of
    seen TCPs, and 200 random ones, in the desired orientation.
    """
    if scenario is None:
        return UR10_CELL
    found = read_scenario(located(scenario))
    box = paper_seen(found.settings).tcp
    corners = np.stack(np.meshgrid(*zip(box.low_m, box.high_m, strict=True)), axis=-1).reshape(-1, 3)
    tcps = np.vstack([corners, Region(box).draw(np.random.default_rng(0), TRIED)])
    missed = tcps[~reachable(tcps, found.settings, found.robot)]
    if len(missed):
        raise DatasetError(
            place=Place(field="--robot"),
            expected=f"an arm that reaches the seen TCPs, {list(box.low_m)} to {list(box.high_m)}",
            got=f"{len(missed)} of {len(tcps)} out of reach, such as {missed[0].round(3).tolist()}",
            hint="settings: {cell: {desired tcp position: ...}} puts their middle elsewhere",
        )
    return TrainingCell(found.robot, found.settings)
