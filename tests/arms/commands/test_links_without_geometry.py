"""A link without geometry is refused unless that is accepted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InputError
from safety_harness.cell.robot.capsules import read_capsules
from safety_harness.cell.robot.description import read_arm
from safety_harness.cell.robot.robots import refuse_unenclosed
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.extensions.arms import fit_capsules
from safety_harness.extensions.arms.commands import fit
from safety_harness.scenario.robots import robot_named


@pytest.fixture
def gapped(tmp_path: Path) -> Path:
    """A URDF whose second link has no shape, between others that have one."""
    box = '<visual><geometry><box size="0.1 0.1 0.2"/></geometry></visual>'
    links = [f'<link name="l{k}">{"" if k == 1 else box}</link>' for k in range(4)]
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" velocity="2" effort="9"/></joint>'
        for k in range(3)
    ]
    (tmp_path / "arm.urdf").write_text(f'<robot name="gapped">{"".join(links + joints)}</robot>')
    return tmp_path / "arm.urdf"


def test_a_link_without_geometry_between_others_is_refused_unless_it_is_accepted(
    gapped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_capsules, "STARTS", 1)
    out = tmp_path / "arm.json"
    assert fit(gapped, out) == BAD_INPUT
    assert "no shape of l1" in capsys.readouterr().err
    assert not out.exists()
    assert fit(gapped, out, without_geometry=["l1"]) == AS_EXPECTED
    assert {one["link"] for one in json.loads(out.read_text())["capsules"]} == {"l0", "l2", "l3"}
    text = "urdf: arm.urdf\nbase: l0\ntcp: l3\ncapsules: arm.json\n"
    text += "braking: {reaction time: 0 ms, stop time: 0 ms}\n"
    (tmp_path / "arm.yaml").write_text(text)
    read_capsules(out, read_arm(gapped))
    with pytest.raises(InputError, match=r"arm\.yaml.*every link between.*none of l1 .*geometry: \[l1\]"):
        refuse_unenclosed(robot_named(str(tmp_path / "arm.yaml")))
    (tmp_path / "arm.yaml").write_text(text + "without geometry: [l1]\n")
    refuse_unenclosed(robot_named(str(tmp_path / "arm.yaml")))
