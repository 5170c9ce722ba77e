"""robot show says what a URDF lacks, and for which use."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.cell.robot.urdf import ArmFileError
from safety_harness.cli.console import AS_EXPECTED
from safety_harness.extensions.arms.commands import show
from tests.cell.robot.test_what_a_urdf_lacks import LIMIT, arm_in, second, urdf


def test_robot_show_says_what_the_urdf_lacks_and_for_which_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = urdf(*second(LIMIT.replace(' effort="50"', "")))
    (tmp_path / "arm.urdf").write_text(text.replace("j1", "finance").replace("j3", "nan"))
    assert show(tmp_path / "arm.urdf") == AS_EXPECTED
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if "the effort of j2" in line)
    assert "drives with a torque limit, a world with motors" in row
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
