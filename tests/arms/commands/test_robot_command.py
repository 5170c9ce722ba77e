"""``safety-harness robot``: an arm as a table and as JSON, and the file of its capsules."""

import json
import re
from pathlib import Path

import pytest

from safety_harness.cell.robot.capsules import read_capsules
from safety_harness.cell.robot.description import read_arm
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, answered_as_json
from safety_harness.extensions.arms import fit_capsules
from safety_harness.extensions.arms.commands import fit, show
from safety_harness.scenario.robots import robot_named

JOINT = (
    '<joint name="j{0}" type="{2}"><parent link="l{0}"/><child link="l{1}"/><origin xyz="0 0 0.2"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1.5" velocity="2" effort="30"/></joint>'
)
LINK = '<link name="l{0}"><visual><geometry><box size="0.1 0.1 0.2"/></geometry></visual></link>'


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    kinds = ["revolute", "revolute", "continuous"]
    parts = [LINK.format(i) for i in range(4)] + [
        JOINT.format(i, i + 1, kind) for i, kind in enumerate(kinds)
    ]
    (tmp_path / "arm.urdf").write_text("\n".join(['<robot name="three">', *parts, "</robot>"]))
    return tmp_path / "arm.urdf"


def test_show_prints_joints_limits_reach_and_shapes(urdf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert show(urdf) == AS_EXPECTED
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "arm         three: 3 joints, l0 to l3"
    assert out[1] == "reach       at most 200 mm from the second joint"
    assert out[3].split() == ["joint", "lower", "deg", "upper", "deg", "deg/s", "N", "m"]
    assert out[4].split() == ["j0", "-57.3", "85.9", "114.6", "30"]
    assert out[6].split() == ["j2", "-inf", "inf", "114.6", "30"]
    assert out[-1].split() == ["l3", "box"]


def test_show_as_json_has_no_limit_as_null(urdf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert answered_as_json(lambda: show(urdf)) == AS_EXPECTED
    told = json.loads(capsys.readouterr().out)["result"]
    assert told["joints"] == ["j0", "j1", "j2"]
    assert told["position_lower_rad"] == [-1.0, -1.0, None]
    assert told["velocity_limit_radps"] == [2.0, 2.0, 2.0]
    assert told["shapes"]["l3"] == ["box"]


def test_fit_writes_capsules_of_this_arm_and_tells_the_excess(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_capsules, "STARTS", 1)
    assert fit(urdf, tmp_path / "arm.json") == AS_EXPECTED
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()] == ["link", "l0", "l1", "l2", "l3"]
    assert "4/4 links, 100 %" in err
    assert read_capsules(tmp_path / "arm.json", read_arm(urdf)).frames == 5


def test_mistakes_end_with_2_and_no_traceback(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf.write_text(urdf.read_text().replace('velocity="2"', 'velocity="-2"', 1))
    assert show(urdf) == BAD_INPUT
    assert f"{urdf}:6: <limit>\n  expected velocity 0, which is unknown, or above" in capsys.readouterr().err
    assert fit(urdf, tmp_path / "arm.json") == BAD_INPUT
    assert not (tmp_path / "arm.json").exists()
    assert show(urdf, package=["small"]) == BAD_INPUT
    assert "--package\n  expected NAME=FOLDER" in capsys.readouterr().err


def test_a_page_shows_an_arm_with_every_capsule(tmp_path: Path) -> None:
    page = tmp_path / "arm.html"
    assert show(Path("shipped:ur10e"), html=page) == AS_EXPECTED
    text = page.read_text()
    arm = robot_named("shipped:ur10e")
    for name in (*arm_capsules(arm).names, *arm_model(arm).joint_names):
        assert name in text
    assert not re.search(r"(?:src|href)=.https?:", text)


def test_a_page_needs_capsules(urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert show(urdf, html=tmp_path / "arm.html") == BAD_INPUT
    assert "--html\n  expected an arm with capsules" in capsys.readouterr().err
    assert not (tmp_path / "arm.html").exists()


def test_an_arms_file_has_its_base_and_tcp_already(capsys: pytest.CaptureFixture[str]) -> None:
    assert show(Path("UR10"), base="base_link") == BAD_INPUT
    assert "expected a URDF with these options" in capsys.readouterr().err
