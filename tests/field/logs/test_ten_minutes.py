"""The three cells of docs/how-to/ten-minutes.md, with files as their recorders make them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cells import NAMES, Cell, Floats, cell
from log_formats import AT_M, TURN, _pose, _transform, header, of, write_bag
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from safety_harness.cli.main import app

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "ten-minutes.md").read_text()
FILES = dict(re.findall(r'^```yaml title="([^"]+)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))
JOINT_S, HAND_S = np.arange(376) * 0.008, np.arange(360) / 120.0
START_NS = 1_700_000_000_000_000_000
JOINT_STATE, POSE, TF = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "tf2_msgs/msg/TFMessage",
)


def table(file: Path, separator: str, names: list[str], rows: Floats) -> None:
    lines = [separator.join(names), *(separator.join(f"{one:.6f}" for one in row) for row in rows)]
    file.write_text("\n".join(lines) + "\n")


def ur(motion: Cell, folder: Path) -> None:
    names = ["timestamp", *(f"{what}_{k}" for what in ("actual_q", "actual_qd") for k in range(6))]
    rows = [JOINT_S[:, None] + 5211.5, motion.joints_rad(JOINT_S), motion.rates_radps(JOINT_S)]
    table(folder / "robot.csv", " ", names, np.hstack(rows))
    table(folder / "marker.csv", ",", ["x_mm", "y_mm", "z_mm"], 1e3 * motion.hand_m(HAND_S))


def ros2(motion: Cell, folder: Path) -> None:
    """With a gripper on the joints' topic, and a service's events, which are not of interest."""
    half = float(np.sqrt(0.5))
    still = of(TF, [_transform(START_NS, "base_link", "camera", AT_M, (0.0, 0.0, half, half))])
    messages = [(START_NS, "/tf_static", TF, still)]
    for t, row in zip(
        (START_NS + np.round(JOINT_S * 1e9).astype(int)).tolist(), motion.joints_rad(JOINT_S), strict=True
    ):
        told = of(JOINT_STATE, header(t, ""), list(NAMES), row.copy(), np.zeros(0), np.zeros(0))
        finger = of(JOINT_STATE, header(t, ""), ["finger_joint"], np.zeros(1), np.zeros(0), np.zeros(0))
        messages += [(t, "/joint_states", JOINT_STATE, told), (t + 9, "/joint_states", JOINT_STATE, finger)]
    for t, at in zip(
        (START_NS + np.round(HAND_S * 1e9).astype(int)).tolist(), motion.hand_m(HAND_S), strict=True
    ):
        messages.append((t, "/hand", POSE, of(POSE, header(t, "camera"), _pose((at - AT_M) @ TURN))))
    write_bag(folder / "run", messages, StoragePlugin.MCAP)


def vendor(motion: Cell, folder: Path) -> None:
    rows = np.hstack([1e3 * JOINT_S[:, None], np.degrees(motion.joints_rad(JOINT_S))])
    table(folder / "Export #3.CSV", ";", ["Time", *(f"J{k + 1}" for k in range(6))], rows)
    rows = np.hstack([1e3 * HAND_S[:, None], 1e3 * (motion.hand_m(HAND_S) - AT_M) @ TURN])
    table(folder / "tracker.csv", "\t", ["Time", "hand_x", "hand_y", "hand_z"], rows)


CELLS = {"ur.yaml": ur, "ros2.yaml": ros2, "vendor.yaml": vendor}


def test_the_page_has_these_cells() -> None:
    assert list(FILES) == list(CELLS)
    assert re.findall(r"^safety-harness judge (\S+)$", PAGE, re.MULTILINE) == list(CELLS)


@pytest.mark.parametrize(("name", "write"), CELLS.items())
def test_a_cell_comes_to_the_verdicts_of_the_page(
    name: str, write: Callable[[Cell, Path], None], tmp_path: Path
) -> None:
    write(cell(np.random.default_rng(11)), tmp_path)
    (tmp_path / name).write_text(FILES[name])
    done = CliRunner().invoke(app, ["judge", str(tmp_path / name)])
    assert done.exit_code == 0, done.output
    (told,) = re.findall(r"^```text\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    said, page = (
        re.findall(r"^holds +(.+?) +\+([0-9.]+) (\S+) at ", text, re.MULTILINE)
        for text in (done.output, told)
    )
    assert [(claim, unit) for claim, _, unit in said] == [(claim, unit) for claim, _, unit in page]
    for (_, mine, _), (_, its, _) in zip(said, page, strict=True):
        assert float(mine) == pytest.approx(float(its), abs=0.2)
    if name == "ur.yaml":
        assert all(line in done.output for line in told.splitlines())
