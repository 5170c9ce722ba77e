"""What is estimated of the clocks, and how well it says that it knows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import cell, recorded, said, write_csv
from typer.testing import CliRunner

from safety_harness.base.exceptions import LogError
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cli.main import app
from safety_harness.extensions.field.logs.align import Offset, align
from safety_harness.extensions.field.logs.read import read_log

ON_TOOL_M = np.array([0.05, -0.02, 0.12])


def _log(
    folder: Path,
    seed: int,
    *,
    ahead_s: float = 0.137,
    off_m: float = 0.004,
    seconds: float = 8.0,
    cycle_s: float | None = None,
) -> Path:
    """The log of a marker on the tool, whose clock is ahead by ``ahead_s``; it may have a cycle."""
    rng = np.random.default_rng(seed)
    one = cell(rng)
    if cycle_s is not None:
        one = replace(one, rate_radps=np.full(6, 2.0 * np.pi / cycle_s))
    streams = recorded(one, rng, seconds=seconds, ahead_s=0.0, clock_s=0.0, hand_off_m=0.0)
    true_s = (streams.hand_ns - streams.joint_ns[0]) / 1e9
    tools = [links_in_base(load_arm(), row)[-1] for row in one.joints_rad(true_s)]
    marker = np.array([tool[:3, :3] @ ON_TOOL_M + tool[:3, 3] for tool in tools])
    marker += rng.uniform(-off_m, off_m, marker.shape)
    object.__setattr__(streams, "hand_m", marker)
    object.__setattr__(streams, "hand_ns", streams.hand_ns + round(ahead_s * 1e9))
    write_csv(streams, folder)
    text = said("joints.csv", "hands.csv#hand", "none").replace("moves at most: 1.0", "moves at most: 3")
    (folder / "LOG.yaml").write_text(
        "\n".join(row for row in text.splitlines() if not row.startswith("clock"))
    )
    return folder / "LOG.yaml"


def _offset(file: Path) -> Offset:
    log = read_log(file, align=True)
    return align(log, log.hands[0])


@pytest.mark.parametrize("ahead_s", [0.137, -2.75, 86_400.0])
def test_the_offset_is_within_what_is_said_of_it(tmp_path: Path, ahead_s: float) -> None:
    for seed in range(2):
        found = _offset(_log(tmp_path, seed, ahead_s=ahead_s))
        assert abs(found.hands_ahead_s - ahead_s) <= found.known_to_s
        assert found.known_to_s < 0.02


def test_noise_widens_it(tmp_path: Path) -> None:
    clean, noisy = (_offset(_log(tmp_path, 5, off_m=off_m)) for off_m in (1e-4, 0.01))
    assert clean.known_to_s < noisy.known_to_s / 3.0
    assert clean.off_m < 0.001 < noisy.off_m


def test_a_body_that_does_not_move_with_the_tool_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    write_csv(recorded(cell(rng), rng, seconds=12.0), tmp_path)
    (tmp_path / "LOG.yaml").write_text(said("joints.csv", "hands.csv#hand", "none"))
    with pytest.raises(LogError, match="a body that moves with the tool"):
        _offset(tmp_path / "LOG.yaml")


@pytest.mark.parametrize("off_m", [0.001, 0.02])
def test_a_motion_that_repeats_itself_is_refused_with_the_offsets_that_it_leaves(
    tmp_path: Path, off_m: float
) -> None:
    with pytest.raises(LogError, match="a motion that only a single offset explains") as refused:
        _offset(_log(tmp_path, 4, cycle_s=2.0, seconds=12.0, off_m=off_m))
    offsets_ms = [float(one) for one in refused.value.got.split("ahead by ")[1].split(" ms")[0].split(", ")]
    assert min(abs(one - 137.0) for one in offsets_ms) < 10.0
    np.testing.assert_allclose(np.diff(offsets_ms), 2000.0, atol=20.0)
    assert "from" in refused.value.hint


def test_cycles_that_are_not_alike_are_aligned(tmp_path: Path) -> None:
    """All of it, of which a part repeats itself: the arm stands before."""
    file = _log(tmp_path, 4, cycle_s=2.0, seconds=12.0)
    for table in ("joints.csv", "hands.csv"):
        first, *rows = file.with_name(table).read_text().splitlines()
        stood = [
            f"{int(rows[0].split(',')[0]) - k * 20_000_000},{rows[0].split(',', 1)[1]}" for k in range(1, 60)
        ]
        file.with_name(table).write_text("\n".join([first, *stood[::-1], *rows]) + "\n")
    file.write_text(file.read_text().replace(", accelerate at most: 4.0 rad/s2", ""))  # it begins at once
    assert abs(_offset(file).hands_ahead_s - 0.137) < 0.01


def test_too_short_a_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="in 4 s or more"):
        _offset(_log(tmp_path, 1, seconds=2.0))


def test_the_command_prints_the_line_for_the_file(tmp_path: Path) -> None:
    file = _log(tmp_path, 2)
    found = CliRunner().invoke(app, ["log", "align", str(file)])
    assert found.exit_code == 0, found.output
    line = next(row for row in found.output.splitlines() if row.startswith("clock: "))
    file.write_text(f"{file.read_text()}\n{line}\n")
    log = read_log(file)
    assert abs(log.hands_ahead_ns / 1e9 - 0.137) <= log.clock_known_to_s
    data = json.loads(CliRunner().invoke(app, ["log", "align", str(file), "--json"]).stdout)
    assert data["result"]["clock"] == line


def test_the_command_asks_which_body(tmp_path: Path) -> None:
    found = CliRunner().invoke(app, ["log", "align", str(_log(tmp_path, 2)), "--body", "left"])
    assert found.exit_code == 2
    assert "expected one of the log's hands: hand" in found.output
