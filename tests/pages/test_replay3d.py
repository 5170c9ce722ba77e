"""The data of a replay: they are the trace's, small, safe in a page, and the same arm's meshes only once."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import factory
import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.cell.perception.hand_filter import TRACK, filter_parameters, initialise, predict, update
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.extensions.pages.arm_meshes import MOST_TRIANGLES, arm_meshes, clustered
from safety_harness.extensions.pages.packing import INF, NAN, as_attribute, packed
from safety_harness.extensions.pages.prediction_spread import UPPER, prediction_spread_m
from safety_harness.extensions.pages.replay import MOST_TICKS, Replays, kept_ticks, replay_data, start_s
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.robots import Robot
from safety_harness.trace.known import Measurement, Source
from safety_harness.trace.unmeasured import knowing

REPLAY_BYTES = 20_000


def unpacked(found: dict[str, Any]) -> dict[str, NDArray[np.float64]]:
    """As ``unpack`` of replay.js does it."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found["packed"])), np.uint8).reshape(4, -1)
    steps = np.ascontiguousarray(planes.T).view("<i4").ravel()
    columns, at = {}, 0
    for name, (rows, width, scale) in found["columns"].items():
        part = steps[at : at + rows * width].reshape(width, rows).astype(np.int64)
        at += rows * width
        whole = ((np.cumsum(part, axis=1) - NAN) % 2**32 + NAN).T
        columns[name] = np.where(whole == NAN, np.nan, np.where(whole == INF, np.inf, whole / scale))
    assert at == len(steps)
    return columns


def inflated(attribute: object) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(str(attribute))))
    return found


def replay_of(run: JudgedRun) -> dict[str, Any]:
    return inflated(as_attribute(replay_data(run)))


def test_the_columns_are_those_of_the_trace() -> None:
    run = factory.violated_run()
    found, ticks = unpacked(replay_of(run)), run.trace.ticks[kept_ticks(run)]
    count = len(ticks)
    for name in ("time_s", "joint_position_rad", "mode"):
        assert np.abs(found[name] - ticks[name].reshape(count, -1)).max() <= 5.1e-6
    hands = len(run.trace.scenario.hands)
    hand_m = ticks["hand_position_in_base_m"][:, :hands].reshape(count, -1)
    assert np.abs(found["hand_in_base_m"] - hand_m).max() <= 5.1e-6
    assert np.abs(found["tcp_in_base_m"] - ticks["transform_tcp_to_base"][:, :3, 3]).max() <= 5.1e-6
    assert np.array_equal(found["nearest_capsule"], ticks["hand_distance_capsule"][:, :hands])


def test_what_is_not_a_number_stays_none_and_what_is_infinite_stays_it() -> None:
    values = np.array([0.25, np.nan, np.inf, -3.0, 1e9, -np.inf, 21_000.0])
    found = unpacked(packed({"a": values, "b": np.array([[2**31 - 2, -7]] * 3)}))
    assert np.array_equal(found["a"].ravel()[:4], values[:4], equal_nan=True)
    assert np.isnan(found["a"].ravel()[[4, 5]]).all()  # too far to be drawn
    assert found["a"].ravel()[6] == 21_000.0
    assert found["b"].tolist() == [[2**31 - 2, -7]] * 3


def test_the_arm_and_its_capsules_are_those_that_distances_are_measured_to() -> None:
    found = replay_of(factory.violated_run())
    assert len(found["joint_origins"]) == 6
    assert len(found["capsules"]) == len(load_capsules().names) + 1  # and the camera
    assert {capsule["link"] for capsule in found["capsules"]} <= set(range(8))
    assert all(capsule["radius_m"] > 0.0 for capsule in found["capsules"])


def test_a_long_run_is_thinned_but_its_worst_moments_and_decisions_stay() -> None:
    run = factory.violated_run()
    kept = set(kept_ticks(run).tolist())
    assert {0, len(run.trace.ticks) - 1} <= kept
    assert set(run.trace.decisions["tick"].tolist()) <= kept
    for evaluation in run.evaluations:
        if evaluation.worst_time_s is not None:
            nearest = int(np.argmin(np.abs(run.trace.time_s - evaluation.worst_time_s)))
            assert nearest in kept
    assert len(kept) <= MOST_TICKS + len(run.trace.decisions) + len(run.evaluations) + 1


def test_decisions_say_which_ways_were_refused() -> None:
    run = factory.violated_run()
    decisions = run.trace.decisions
    found = replay_of(run)["decisions"]
    assert [len(one["refused"]) > 0 for one in found] == [
        bool(one["proposed_failed"]) and bool(np.isfinite(one["proposed_position_in_base_m"]).all())
        for one in decisions
    ]
    assert any("refused" in one["says"] for one in found)
    assert found[0]["from"] == pytest.approx(decisions["tcp_position_in_base_m"][0], abs=1e-5)


def test_it_stands_within_an_attribute_and_is_small() -> None:
    text = as_attribute(replay_data(factory.hostile_run()))
    assert re.fullmatch(r"[A-Za-z0-9+/=]+", text)
    assert inflated(text)["hands"]
    assert start_s(factory.no_hands_run()) >= 0.0
    assert len(as_attribute(replay_data(factory.violated_run()))) < REPLAY_BYTES


def test_a_page_has_so_many_replays_and_the_meshes_of_an_arm_once() -> None:
    page, run = Replays(most=3), factory.violated_run()
    found = [page.arguments(run, f"run-{k}") for k in range(4)]
    data = [inflated(one["data"]) for one in found if one]
    assert [one is None for one in found] == [False, False, False, True]
    assert ["meshes" in one for one in data] == [True, False, False]
    assert data[2]["meshes_of"] == "run-0-replay"


@pytest.mark.parametrize("robot", list(Robot))
def test_the_meshes_lie_within_the_capsules_of_their_links(robot: Robot) -> None:
    """They are for pictures; a corner that stood out of its capsules would show a distance that is none."""
    meshes, capsules = arm_meshes(arm_model(robot)), arm_capsules(robot)
    assert meshes is not None
    found = unpacked(meshes)
    assert sum(len(found[f"faces {link}"]) for link in meshes["links"]) <= MOST_TRIANGLES
    for link in meshes["links"]:
        corners = found[f"corners {link}"]
        gaps = []
        for k in np.flatnonzero(capsules.link_index == link):
            start, way = capsules.start_in_link[k], capsules.end_in_link[k] - capsules.start_in_link[k]
            share = np.clip((corners - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)[:, None]
            gaps.append(np.linalg.norm(corners - start - share * way, axis=1) - capsules.radius_m[k])
        assert np.min(gaps, axis=0).max() < 1e-3, link


def test_few_triangles_keep_the_shape() -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform(size=(500, 3, 3))
    points, faces = clustered(corners, 1e-9)
    assert len(faces) == 500
    assert np.abs(np.sort(points[faces].reshape(-1)) - np.sort(corners.reshape(-1))).max() < 1e-4
    coarse, few = clustered(corners, 0.2)
    assert len(few) < len(faces)
    assert coarse.min() >= 0.0
    assert coarse.max() <= 1.0


def test_the_spread_of_predictions_is_that_of_the_filter_that_saw_every_image() -> None:
    """The filter itself, a measurement a tick; the overhead camera looks straight down."""
    trace = factory.violated_run().trace
    settings, period_s = trace.scenario.settings, trace.scenario.settings.clock.control_period_s
    assert trace.ticks["track_valid"][:, 0].all()
    found = prediction_spread_m(trace)[:, 0]
    parameters, track = filter_parameters(settings.hand_filter, settings.hand_sensor), np.zeros(1, TRACK)
    box = np.array([320.0, 240.0, 1.0, 4000.0, 1.0])
    initialise(track[0], box, 0.0, parameters[0])
    for tick in range(40):
        later = track.copy()
        predict(later[0], settings.hand_filter.prediction_horizon_s, parameters[0])
        root = np.zeros((3, 3))
        root[UPPER] = root.T[UPPER] = found[tick]
        assert (root @ root)[2, 2] == pytest.approx(later[0]["pair_covariance"][2, 0], rel=1e-9)
        predict(track[0], period_s, parameters[0])
        update(track[0], box, parameters[0])
    assert np.linalg.norm(found[-1]) < np.linalg.norm(found[0])  # it has seen more since
    logged = knowing(trace, {"predicted_hand_in_base_m": Measurement(source=Source.LOG)})
    assert np.isnan(prediction_spread_m(logged)).all()


def test_other_files_than_meshes_leave_the_capsules_alone(tmp_path: Path) -> None:
    arm = arm_model(Robot.UR10)
    broken = tmp_path / "link.stl"
    broken.write_bytes(b"solid of text\n" + b"x" * 100)
    links = [
        replace(one, collision=tuple(replace(s, file=broken) for s in one.collision), visual=())
        for one in arm.links
    ]
    assert arm_meshes(replace(arm, links=tuple(links))) is None
