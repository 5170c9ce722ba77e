from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.cell.avoidance.simple import NearestCandidate
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base, view_of
from safety_harness.cell.controller.records import overhead_transform_sensor_to_base
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.servoing.features import feature_error, features
from safety_harness.cell.simulation.cameras import sensors
from safety_harness.cell.simulation.exact_views import exact_object

ORACLE = NearestCandidate.for_cell(DEFAULTS)
CAP = CandidateCap.from_settings(DEFAULTS)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
PULL = DEFAULTS.avoidance.hand_pull


def questions(count: int) -> list[tuple[np.ndarray, np.ndarray, int]]:
    """Hand, TCP and seed."""
    rng = np.random.default_rng(3)
    return [
        (np.array([0.84, -0.35, 0.0]) + rng.uniform(-0.3, 0.3, 3), DESIRED + rng.uniform(-0.1, 0.1, 3), seed)
        for seed in range(count)
    ]


def proposed(hand: np.ndarray, tcp: np.ndarray, seed: int) -> np.ndarray:
    return ORACLE.propose(
        hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=seed
    ).position_in_base_m


def image_error(tcp: np.ndarray) -> float:
    """|f - f*| of an exact and large image from a TCP at ``tcp`` that looks straight down."""
    view = view_of(DEFAULTS)
    large = replace(DEFAULTS, camera=replace(DEFAULTS.camera, width_px=4000, height_px=4000))
    camera = sensors(large, 0, 0, overhead_transform_sensor_to_base(DEFAULTS))
    pose = desired_transform_tcp_to_base(DEFAULTS)
    pose[:3, 3] = tcp
    moments, f, error = np.empty(MOMENT_COUNT), np.empty(6), np.empty(6)
    assert exact_object(camera.state, camera.polygon_in_base_m, pose, moments)
    assert features(moments, view.area, view.depth_m, view.dense, f)
    return float(np.sqrt(feature_error(f, view.features, error)))


def test_the_proposal_is_equation_13_by_brute_force() -> None:
    """Of the candidates around the TCP the one with the least *image* error, pulled from the hand."""
    for hand, tcp, seed in questions(4):
        candidates = tcp + CAP.draw(np.random.default_rng(seed))
        best = min(candidates, key=image_error)
        assert proposed(hand, tcp, seed) == pytest.approx(best + PULL * (tcp - hand), abs=1e-12)


def test_the_proposal_is_a_candidate_but_for_the_pull_and_none_is_nearer() -> None:
    for hand, tcp, seed in questions(100):
        offset = proposed(hand, tcp, seed) - PULL * (tcp - hand) - tcp
        assert np.linalg.norm(offset) == pytest.approx(CAP.radius_m, abs=1e-12)
        assert offset @ CAP.axis_in_base >= CAP.radius_m * np.cos(CAP.cone_rad) - 1e-12
        candidates = tcp + CAP.draw(np.random.default_rng(seed))
        nearest_m = np.sqrt(((candidates - DESIRED) ** 2).sum(axis=1)).min()
        assert np.linalg.norm(tcp + offset - DESIRED) == pytest.approx(nearest_m, abs=1e-12)


def test_the_proposal_is_never_further_than_the_radius_and_the_pull() -> None:
    for hand, tcp, seed in questions(100):
        furthest_m = CAP.radius_m + PULL * np.linalg.norm(tcp - hand)
        assert np.linalg.norm(proposed(hand, tcp, seed) - tcp) <= furthest_m + 1e-12


def test_one_seed_is_one_answer() -> None:
    (hand, tcp, _), *_ = questions(1)
    assert np.array_equal(proposed(hand, tcp, 5), proposed(hand, tcp, 5))
    assert not np.array_equal(proposed(hand, tcp, 5), proposed(hand, tcp, 6))
