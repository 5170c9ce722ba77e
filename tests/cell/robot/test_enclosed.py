"""A named arm takes a tool; a link or a TCP that no capsule encloses is refused unless a file accepts it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from safety_harness.base.exceptions import InputError
from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.base.shipped.contents import located
from safety_harness.cell.robot.capsules import StoredCapsules, tcp_beyond
from safety_harness.cell.robot.description import load_arm, read_arm
from safety_harness.cell.robot.robots import arm_capsules, arm_model, refuse_unenclosed
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.robots import EquippedArm, Robot, robot_named
from safety_harness.scenario.write import write_scenario
from tests.cell.robot.urdfs import small_arm_in

PIECE = "{from: [0 mm, 0 mm, 0 mm], to: [0 mm, 0 mm, 250 mm], radius: 45 mm}"
TOOL = f"tool: {{position: [0 mm, 0 mm, 250 mm], capsules: [{PIECE}]}}"


def scenario(robot: str) -> Scenario:
    return parse_scenario(f"{located('shipped:fast-reach').read_text()}robot: {robot}\n")


def test_what_is_mounted_on_a_named_arm_is_written_and_read_again(tmp_path: Path) -> None:
    text = f"{{arm: UR5, {TOOL}, carries: [{PIECE}], seated at: {{yaw: 90 deg}}}}"
    first = scenario(text)
    assert isinstance(first.robot, EquippedArm)
    assert first.robot.label == "UR5 with another seat and a tool and a part"
    assert parse_scenario(write_scenario(first)).robot == first.robot
    assert scenario("{arm: UR5}").robot is Robot.UR5
    (tmp_path / "below").mkdir()
    (tmp_path / "base.yaml").write_text(write_scenario(first))
    (tmp_path / "below" / "child.yaml").write_text("scenario: two\nextends: ../base.yaml\n")
    assert read_scenario(tmp_path / "below" / "child.yaml").robot == first.robot


def test_a_mounted_tool_moves_the_tcp_and_is_enclosed() -> None:
    robot = scenario(f"{{arm: UR10, {TOOL}}}").robot
    bare, arm = load_arm(), arm_model(robot)
    np.testing.assert_allclose(
        arm.flange, bare.flange @ [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.25], [0, 0, 0, 1]]
    )
    names = arm_capsules(robot).names
    assert names[-1] == "tool 1"
    assert len(names) == 1 + len(arm_capsules(Robot.UR10).names)


@pytest.mark.parametrize(
    ("robot", "complaint"),
    [
        ("{arm: UR11, tool: {}}", "expected UR10, UR5 or UR3"),
        (f"{{arm: UR10, {TOOL}, base: base_link}}", 'got the key "base"'),
        (f"{{arm: UR10, {TOOL}, braking: {{stop time: 1 s}}}}", r"settings: \{braking: ...\}"),
    ],
)
def test_other_keys_beside_a_named_arm_are_refused(robot: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        scenario(robot)


def test_every_shipped_arm_encloses_its_links_and_its_tcp() -> None:
    for name in ("iiwa14", "panda", "xarm6", "ur10e"):
        robot = robot_named(f"shipped:{name}")
        refuse_unenclosed(robot)
        assert tcp_beyond(arm_model(robot), arm_capsules(robot)) == 0.0


def test_the_last_link_with_capsules_counts_where_the_last_has_none(tmp_path: Path) -> None:
    """The small arm's hand is bare: its TCP is 300 mm from the frame of the link before it."""
    arm = read_arm(small_arm_in(tmp_path), base="foot", tcp="hand")
    end = {"name": "lower", "link": "lower", "start_in_link_m": (0, 0, 0), "end_in_link_m": (0.1, 0, 0)}
    stored = msgspec.convert({"arm": "small", "capsules": [{**end, "radius_m": 0.05}]}, StoredCapsules)
    capsules = stored.on(arm, tmp_path)
    expected = point_segment_distance(np.array([0.3, 0, 0]), np.zeros(3), np.array([0.1, 0, 0])) - 0.05
    assert tcp_beyond(arm, capsules) == pytest.approx(expected) == pytest.approx(0.15)
