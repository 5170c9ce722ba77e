from __future__ import annotations

import base64
import json

import factory
import numpy as np

from safety_harness.certification.replay3d import MOST_TICKS, kept_ticks, replay_json, start_s
from safety_harness.robot.capsules import load_capsules


def test_the_columns_are_those_of_the_trace() -> None:
    run = factory.violated_run()
    found = json.loads(replay_json(run))
    kept = kept_ticks(run)
    sizes = {"time_s": 1, "joint_position_rad": 6, "tcp_in_base_m": 3, "mode": 1}
    for name, size in sizes.items():
        values = np.frombuffer(base64.b64decode(found["columns"][name]), "<f4").reshape(len(kept), size)
        ticks = run.trace.ticks[kept]
        if name in (ticks.dtype.names or ()):
            assert np.array_equal(values, ticks[name].reshape(len(kept), size).astype("<f4"))
    tcp = np.frombuffer(base64.b64decode(found["columns"]["tcp_in_base_m"]), "<f4").reshape(-1, 3)
    assert np.allclose(tcp, run.trace.ticks["transform_tcp_to_base"][kept, :3, 3], atol=1e-6)


def test_the_arm_and_its_capsules_are_those_that_distances_are_measured_to() -> None:
    found = json.loads(replay_json(factory.violated_run()))
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


def test_it_stands_within_a_script_element() -> None:
    text = replay_json(factory.hostile_run())
    assert "<" not in text
    assert json.loads(text)["hands"]
    assert start_s(factory.no_hands_run()) >= 0.0
