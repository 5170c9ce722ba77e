"""PyBullet's C code prints lines between ours; the harness discards them."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.cell.simulation.engine import pybullet, quiet

FRAME = (
    '<robot name="r"><link name="base"/><link name="tool0"/>'
    '<joint name="j" type="fixed"><parent link="base"/><child link="tool0"/></joint></robot>'
)


def test_a_frame_without_inertia_prints_no_line_between_ours(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "frame.urdf"
    file.write_text(FRAME)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.loadURDF(str(file), physicsClientId=client)
        assert "No inertial data" in capfd.readouterr().out  # the engine prints it
        print("before", flush=True)
        with quiet(1):
            pybullet.loadURDF(str(file), physicsClientId=client)
        print("after", flush=True)
        assert capfd.readouterr().out == "before\nafter\n"
    finally:
        pybullet.disconnect(client)
