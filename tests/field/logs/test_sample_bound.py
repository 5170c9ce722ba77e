"""A tracker may say of each sample how well it is known: by a radius, a box or a covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cells import Cell, Streams, cell, recorded, said, write_csv
from log_formats import header, of
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from truths import truth_at

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.field.logs.certain import trace_from_log
from safety_harness.extensions.field.logs.read import read_log

FINE_M, COARSE_M = 0.002, 0.022
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


@pytest.fixture(scope="module")
def half_coarse() -> tuple[Cell, Streams, np.ndarray]:
    """A cell whose tracker is off by ten times as much in the first half, and says so."""
    rng = np.random.default_rng(5)
    one = cell(rng)
    streams = recorded(one, rng, seconds=1.2, hand_off_m=FINE_M)
    coarse = np.arange(len(streams.hand_ns)) < len(streams.hand_ns) // 2
    off = np.outer(coarse, [COARSE_M - FINE_M, 0.0, 0.0])
    streams.hand_m[:] += off
    streams.elbow_m[:] -= off
    return one, streams, np.where(coarse, COARSE_M, FINE_M)


def log_file(folder: Path, streams: Streams, bound: list[str], known_to: str) -> Path:
    """With cells of ``bound`` at the end of each row, for the hand and the elbow."""
    write_csv(streams, folder)
    first, *rows = (folder / "hands.csv").read_text().splitlines()
    names = [f"{track}_off{axis}" for track in ("hand", "elbow") for axis in ("_x_mm", "_y_mm", "_z_mm")]
    if bound[0].count(",") == 0:
        names = ["hand_off_mm", "elbow_off_mm"]
    lines = [",".join((first, *names)), *(f"{row},{b},{b}" for row, b in zip(rows, bound, strict=True))]
    (folder / "hands.csv").write_text("\n".join(lines) + "\n")
    text = said("joints.csv", "hands.csv#hand", "hands.csv#elbow")
    (folder / "LOG.yaml").write_text(text.replace("known to: 8 mm", f"known to: {known_to}"))
    return folder / "LOG.yaml"


def test_a_hand_is_within_what_its_samples_say(
    half_coarse: tuple[Cell, Streams, np.ndarray], tmp_path: Path
) -> None:
    one, streams, known_m = half_coarse
    file = log_file(tmp_path, streams, [f"{m * 1e3}" for m in known_m], "{field: off}")
    trace = trace_from_log(read_log(file)).trace
    true, count = truth_at(trace, one, trace.time_s).ticks, len(trace.ticks)
    within = {
        name: trace.known.uncertainty_of(name, count)
        for name in ("hand_position_in_base_m", "elbow_position_in_base_m")
    }
    for name, bound in within.items():
        off = np.linalg.norm(trace.ticks[name][:, 0] - true[name][:, 0], axis=1)
        assert (off <= bound + 1e-9).all()
        assert off[: count // 3].max() > COARSE_M - 2.0 * FINE_M  # it would be false to take the finer one
    coarse, fine = (within["hand_position_in_base_m"][part] for part in (np.s_[: count // 3], np.s_[-20:]))
    assert np.median(coarse) - np.median(fine) > 0.5 * (COARSE_M - FINE_M)


def test_a_box_counts_to_its_corner_and_a_covariance_by_its_largest_axis(
    half_coarse: tuple[Cell, Streams, np.ndarray], tmp_path: Path
) -> None:
    _, streams, _ = half_coarse
    for name in ("box", "bag"):
        (tmp_path / name).mkdir()
    rows = ["2,3,6"] * len(streams.hand_ns)
    box = read_log(log_file(tmp_path / "box", streams, rows, "{field: off, times: 2}")).hands[0]
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = turn @ np.diag([1e-6, 4e-6, 12.25e-6]) @ turn.T
    file = bag(tmp_path / "bag", streams, covariance)
    poses = read_log(file).hands[0]
    for known in (box.hand, box.elbow, poses.hand, poses.elbow):
        assert known is not None
        assert known.known_to_m is not None
        np.testing.assert_allclose(known.known_to_m, 0.014, rtol=1e-9)
    text = file.read_text()
    file.write_text(text.replace(", times: 4", ""))
    with pytest.raises(InputError, match="the most standard deviations"):
        read_log(file)
    nobody = bag(tmp_path / "nobody", streams, 0.0 * covariance)
    with pytest.raises(InputError, match="message 1 of /hand"):
        read_log(nobody)


def bag(folder: Path, streams: Streams, covariance: np.ndarray) -> Path:
    """Poses with their covariance in a bag, joints beside it."""
    folder.mkdir(exist_ok=True)
    write_csv(streams, folder)
    with Writer(folder / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, rows in (("/hand", streams.hand_m), ("/elbow", streams.elbow_m)):
            store = get_typestore(Stores.ROS2_HUMBLE)
            connection = writer.add_connection(topic, POSE, typestore=store)
            for t, at in zip(streams.hand_ns.tolist(), rows, strict=True):
                point = of("geometry_msgs/msg/Point", *map(float, at))
                turned = of("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
                pose = of("geometry_msgs/msg/Pose", point, turned)
                told = of("geometry_msgs/msg/PoseWithCovariance", pose, covariance.ravel())
                message = of(POSE, header(t, "base_link"), told)
                writer.write(connection, t, store.serialize_cdr(message, POSE))
    text = said("joints.csv", "run#/hand", "run#/elbow", frame="")
    text = text.replace("known to: 8 mm", "known to: {field: pose.covariance, times: 4}")
    (folder / "LOG.yaml").write_text(text)
    return folder / "LOG.yaml"


@pytest.mark.parametrize("cell_of_a_row", ["", "-3", "nan"])
def test_a_sample_without_a_bound_is_refused_with_its_line(
    half_coarse: tuple[Cell, Streams, np.ndarray], tmp_path: Path, cell_of_a_row: str
) -> None:
    _, streams, _ = half_coarse
    rows = ["4"] * len(streams.hand_ns)
    rows[7] = cell_of_a_row
    with pytest.raises(InputError, match=r"hands.csv:9: .*its accuracy"):
        read_log(log_file(tmp_path, streams, rows, "{field: off}"))
