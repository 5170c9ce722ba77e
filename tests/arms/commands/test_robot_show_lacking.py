"""robot show says what a URDF lacks, and for which use."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.cell.robot.description import ArmModel, read_arm
from safety_harness.cell.robot.urdf import ArmFileError
from safety_harness.cli.console import AS_EXPECTED
from safety_harness.extensions.arms.commands import show

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
BOX = '<collision><geometry><box size="0.1 0.1 0.3"/></geometry></collision>'
LIMIT = '<limit lower="-2" upper="2" velocity="2" effort="50"/>'
JOINT = """\
<joint name="j{n}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}</joint>
"""
SECOND = '<child link="b"/>\n<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>' + LIMIT


def urdf(old: str = "", new: str = "") -> str:
    """Three joints of +-2 rad, 2 rad/s, 50 N m; ``old`` stands once in it and becomes ``new``."""
    links = [f'<link name="{name}">{INERTIAL}{BOX}</link>' for name in ("base", "a", "b", "c")]
    pairs = zip(("base", "a", "b"), ("a", "b", "c"), strict=True)
    joints = [JOINT.format(n=n, parent=p, child=c, limit=LIMIT) for n, (p, c) in enumerate(pairs, start=1)]
    text = f'<robot name="t">{"".join(links)}\n{"".join(joints)}</robot>'
    assert not old or text.count(old) == 1
    return text.replace(old, new) if old else text


def second(limit: str) -> tuple[str, str]:
    """The change of the second joint's <limit>."""
    return SECOND, SECOND.replace(LIMIT, limit)


def arm_in(folder: Path, change: tuple[str, str]) -> ArmModel:
    (folder / "arm.urdf").write_text(urdf(*change))
    return read_arm(folder / "arm.urdf", base="base", tcp="c")


def test_robot_show_says_what_the_urdf_lacks_and_for_which_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = urdf(*second(LIMIT.replace(' effort="50"', "")))
    (tmp_path / "arm.urdf").write_text(text.replace("j1", "finance").replace("j3", "nan"))
    assert show(tmp_path / "arm.urdf") == AS_EXPECTED
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if "the effort of j2" in line)
    assert "drives with a torque limit, PyBullet" in row
    assert "`joint torque limits`" in row
    cells = [line.split() for line in lines]
    assert [row[0] for row in cells if row[-1:] == ["50"]] == ["finance", "nan"]  # names are no numbers
    assert ["j2", "-114.6", "114.6", "114.6", "unknown"] in cells


def test_a_file_for_xacro_is_refused_with_the_command_that_expands_it(tmp_path: Path) -> None:
    for change in (
        second(LIMIT.replace('"50"', '"${effort}"')),
        ('<link name="c">', '<xacro:x/><link name="c">'),
    ):
        with pytest.raises(ArmFileError, match=r"xacro arm\.urdf > arm-expanded\.urdf"):
            arm_in(tmp_path, change)
