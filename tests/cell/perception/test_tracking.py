from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from safety_harness.base.settings import DEFAULTS, HAND_SLOTS
from safety_harness.cell.perception.hand_boxes import position_from_box, sphere_box
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.cell.perception.tracking import (
    advance_tracks,
    no_tracks,
    predict_positions,
)
from safety_harness.trace.records import TRACKS_PER_HAND

PARAMETERS = filter_parameters(DEFAULTS.hand_filter, DEFAULTS.hand_sensor)
GATE = DEFAULTS.hand_filter.gate_px
TIMEOUT = DEFAULTS.hand_filter.track_timeout_s
FOCAL, C_U, C_V = (float(PARAMETERS[0][name]) for name in ("focal_px", "c_u", "c_v"))
RADIUS = DEFAULTS.hand_filter.assumed_hand_radius_m
# A camera 1.4 m up that looks straight down, u along -y and v along -x.
TO_BASE = np.array(
    [[0.0, -1.0, 0.0, 0.8], [-1.0, 0.0, 0.0, -0.3], [0.0, 0.0, -1.0, 1.4], [0.0, 0.0, 0.0, 1.0]]
)


def frame(*boxes: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    rows = np.full((max(len(boxes), TRACKS_PER_HAND * HAND_SLOTS[0]), 5), np.nan)
    for row, box in zip(rows, boxes, strict=False):
        row[:] = box
    return rows, len(boxes)


def box_at(u_px: float, v_px: float, z_m: float = 1.0, aspect: float = 1.0) -> NDArray[np.float64]:
    return np.array([u_px, v_px, z_m, 5000.0, aspect])


def advance(tracks: NDArray[np.void], time_s: float, *boxes: NDArray[np.float64]) -> bool:
    return advance_tracks(tracks, *frame(*boxes), time_s, PARAMETERS)


def predicted(
    tracks: NDArray[np.void], time_s: float, transform: NDArray[np.float64] = TO_BASE
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    positions, valid = np.full((len(tracks), 3), 7.0), np.zeros(len(tracks), np.bool_)
    predict_positions(tracks, time_s, PARAMETERS, transform, positions, valid)
    return positions, valid


def test_two_steadily_moving_hands_are_foreseen() -> None:
    tracks, rate_s = no_tracks(), 1 / 60
    start = np.array([[0.0, 0.1, 1.2], [-0.3, 0.0, 1.3]])  # in the camera frame
    velocity = np.array([[0.6, 0.0, -0.5], [0.0, -0.4, 0.1]])
    for k in range(40):
        boxes = np.empty((2, 5))
        for j in range(2):
            position = start[j] + k * rate_s * velocity[j]
            assert sphere_box(position, RADIUS, FOCAL, C_U, C_V, boxes[j])
        order = (0, 1) if k % 2 == 0 else (1, 0)  # a detector keeps no order
        assert advance(tracks, k * rate_s, *boxes[list(order)])
    then_s = 39 * rate_s + 0.1
    positions, valid = predicted(tracks, then_s)
    assert list(valid) == [True, True, False, False]
    expected = (start + then_s * velocity) @ TO_BASE[:3, :3].T + TO_BASE[:3, 3]
    # u = f X/Z does not move uniformly while Z changes: second order in the horizon.
    np.testing.assert_allclose(positions[:2], expected, atol=0.006)
    assert sorted(tracks["id"][:2]) == [1, 2]


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(HAND_SLOTS))
def test_boxes_and_tracks_are_paired_at_the_globally_least_distance(seed: int, hand_slots: int) -> None:
    rng, tracks = np.random.default_rng(seed), no_tracks(hand_slots)
    track_count, box_count = rng.integers(0, len(tracks) + 1, 2)
    spread = rng.choice([100.0, 300.0, 600.0])
    before, after = rng.uniform(0, spread, (track_count, 2)), rng.uniform(0, spread, (box_count, 2))
    advance(tracks, 0.0, *(box_at(u, v) for u, v in before))
    # A new track and its first measurement weigh alike, so box j leaves the aspect 2 + j behind.
    advance(tracks, 0.0, *(box_at(u, v, aspect=3.0 + 2 * j) for j, (u, v) in enumerate(after)))
    pairs = [(round(tracks[i]["mean"][4] - 2), i) for i in range(track_count)]
    # Tracks that a box without a free slot replaced carry the box's own aspect 3 + 2 j.
    pairs = [(j, i) for j, i in pairs if j >= 0 and tracks[i]["id"] <= track_count]
    distance = np.linalg.norm(after[:, None] - before[None], axis=2)
    assert len({j for j, _ in pairs}) == len(pairs)
    assert all(distance[j, i] <= GATE for j, i in pairs)
    total = sum(distance[j, i] for j, i in pairs) + GATE * (box_count - len(pairs))
    padded = np.hstack([np.where(distance <= GATE, distance, 1e6), np.full((box_count, box_count), GATE)])
    replaced = any(tracks["id"] > len(tracks))
    if not replaced:  # a replaced track no longer shows that it was not paired
        assert total == pytest.approx(padded[linear_sum_assignment(padded)].sum())


@pytest.mark.parametrize("gate_px", [np.inf, np.nan])
def test_without_a_bound_eight_boxes_find_their_tracks_all_the_same(gate_px: float) -> None:
    tracks, places = no_tracks(8), np.arange(8) * 1000.0
    parameters = PARAMETERS.copy()
    parameters["gate_px"] = gate_px
    for _ in range(2):
        boxes, count = frame(*(box_at(u, 100.0) for u in places))
        assert advance_tracks(tracks, boxes, count, 0.0, parameters)
    assert sorted(tracks["mean"][:8, 0]) == sorted(places)


def test_a_box_beyond_the_gate_is_another_hand() -> None:
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(100, 100))
    advance(tracks, 0.0, box_at(100 + GATE, 100))
    assert tracks["valid"].sum() == 1
    advance(tracks, 0.0, box_at(tracks[0]["mean"][0] + GATE + 0.01, 100))
    assert tracks["valid"].sum() == 2


def test_a_new_hand_does_not_push_the_others_on_by_one() -> None:
    # Two long pairs (100 and 140 px) would cost more than a perfect pair and a new hand.
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(300, 100), box_at(400, 100))
    advance(tracks, 0.0, box_at(300, 100, aspect=3.0), box_at(160, 100, aspect=5.0))
    assert list(tracks["mean"][:3, 4]) == [2.0, 1.0, 5.0]


def test_equal_distances_go_to_the_earlier_box_and_the_lower_slot() -> None:
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(100, 100), box_at(200, 100))
    advance(tracks, 0.0, box_at(150, 100, aspect=3.0))
    assert list(tracks["mean"][:2, 4]) == [2.0, 1.0]
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(150, 100))
    advance(tracks, 0.0, box_at(100, 100, aspect=3.0), box_at(200, 100, aspect=5.0))
    assert list(tracks["mean"][:2, 4]) == [2.0, 5.0]


def test_an_unseen_hand_coasts_until_the_timeout_and_not_longer() -> None:
    tracks = no_tracks()
    for k in range(20):
        advance(tracks, 0.01 * k, box_at(100 + 2 * k, 100))
    seen_s = tracks[0]["last_seen_s"]
    speed = tracks[0]["mean"][5]
    assert speed == pytest.approx(200.0, rel=0.05)
    advance(tracks, seen_s + TIMEOUT)
    assert tracks[0]["valid"]
    assert tracks[0]["mean"][0] == pytest.approx(138 + speed * TIMEOUT, rel=0.02)
    advance(tracks, seen_s + TIMEOUT + 0.001)
    assert not tracks["valid"].any()


def test_without_frames_a_track_never_goes() -> None:
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(100, 100))
    _, valid = predicted(tracks, 1000.0)
    assert valid[0]


def test_a_new_hand_takes_the_slot_that_is_free_for_longest_and_a_new_id() -> None:
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(0, 0), box_at(300, 0), box_at(600, 0), box_at(0, 300))
    advance(tracks, 0.2, box_at(0, 0), box_at(600, 0), box_at(0, 300))  # slot 1 last seen at 0
    advance(tracks, 0.4, box_at(0, 0), box_at(0, 300))  # slot 2 last seen at 0.2
    advance(tracks, 0.8, box_at(0, 0), box_at(0, 300))
    assert list(tracks["valid"]) == [True, False, False, True]
    advance(tracks, 0.9, box_at(0, 0), box_at(0, 300), box_at(600, 300))
    assert list(tracks["id"]) == [1, 5, 3, 4]
    advance(tracks, 1.0, box_at(0, 0), box_at(0, 300), box_at(600, 300), box_at(600, 0))
    assert list(tracks["id"]) == [1, 5, 6, 4]


def test_a_hand_seen_now_takes_the_place_of_one_long_unseen() -> None:
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(0, 0), box_at(300, 0), box_at(600, 0), box_at(0, 300))
    advance(tracks, 0.1, box_at(0, 0), box_at(600, 0), box_at(0, 300))
    advance(tracks, 0.2, box_at(600, 300))
    assert list(tracks["id"]) == [1, 5, 3, 4]
    assert tracks["valid"].all()


@pytest.mark.parametrize("time_s", [0.99, -np.inf, np.inf, np.nan])
def test_a_frame_out_of_order_changes_nothing(time_s: float) -> None:
    tracks = no_tracks()
    advance(tracks, 1.0, box_at(100, 100))
    before = tracks.copy()
    assert not advance(tracks, time_s, box_at(110, 100))
    assert np.array_equal(tracks, before)


@pytest.mark.parametrize(("column", "value"), [(0, np.nan), (1, np.inf), (2, 0.0), (2, np.nan), (3, 0.0)])
def test_a_box_without_a_usable_number_is_passed_over(column: int, value: float) -> None:
    tracks, without = no_tracks(), no_tracks()
    bad = box_at(105, 100)
    bad[column] = value
    for given_tracks, boxes in ((tracks, (bad, box_at(300, 100))), (without, (box_at(300, 100),))):
        advance(given_tracks, 0.0, box_at(100, 100), box_at(290, 100))
        assert advance(given_tracks, 0.1, *boxes)
    assert np.array_equal(tracks, without)


def approaching() -> NDArray[np.void]:
    """A hand that comes straight at the sensor with 2 m/s and is 0.1 m away at 0.45 s."""
    tracks = no_tracks()
    for k in range(46):
        advance(tracks, 0.01 * k, box_at(200, 200, 1.0 - 0.02 * k))
    return tracks


def test_a_hand_foreseen_behind_the_sensor_stays_where_it_was_filtered() -> None:
    tracks = approaching()
    assert tracks[0]["mean"][2] + 0.1 * tracks[0]["mean"][7] < 0
    positions, valid = predicted(tracks, 0.55, np.eye(4))
    here = np.empty(3)
    position_from_box(tracks[0]["mean"][:5], FOCAL, C_U, C_V, RADIUS, here)
    assert valid[0]
    np.testing.assert_array_equal(positions[0], here)


def test_a_coasting_track_never_passes_the_sensor() -> None:
    tracks = approaching()
    uncertain = tracks[0]["pair_covariance"][2, 0]
    for k in range(1, 50):
        advance(tracks, 0.45 + 0.01 * k)
        assert tracks[0]["mean"][2] > 0
        assert tracks[0]["pair_covariance"][2, 0] > uncertain
        uncertain = tracks[0]["pair_covariance"][2, 0]
        positions, valid = predicted(tracks, 0.55 + 0.01 * k, np.eye(4))
        assert valid[0]
        assert positions[0, 2] > 0


def test_a_prediction_for_no_time_is_the_filtered_position() -> None:
    tracks = approaching()
    positions, valid = predicted(tracks, np.nan, np.eye(4))
    now, _ = predicted(tracks, tracks[0]["time_s"], np.eye(4))
    assert valid[0]
    np.testing.assert_array_equal(positions[0], now[0])


def test_predicting_changes_no_track_and_marks_empty_slots() -> None:
    tracks = no_tracks()
    advance(tracks, 0.0, box_at(100, 100), box_at(400, 100))
    before = tracks.copy()
    positions, valid = predicted(tracks, 0.1)
    assert np.array_equal(tracks, before)
    assert list(valid) == [True, True, False, False]
    assert np.isnan(positions[2:]).all()


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(HAND_SLOTS))
def test_whatever_is_seen_a_tracked_hand_has_a_place_in_front_of_the_sensor(
    seed: int, hand_slots: int
) -> None:
    rng = np.random.default_rng(seed)
    tracks, time_s = no_tracks(hand_slots), 0.0
    for _ in range(60):
        time_s += rng.choice([0.001, 0.008, 0.033, 0.3])
        boxes = [
            np.array([*rng.uniform(-200, 900, 2), 10 ** rng.uniform(-3, 1), rng.uniform(1, 1e5), 1.0])
            for _ in range(rng.integers(0, len(tracks) + 1))
        ]
        assert advance(tracks, time_s, *boxes)
        alive = tracks[tracks["valid"]]
        assert (alive["last_seen_s"] == time_s).sum() == len(boxes)  # every hand seen is tracked
        assert (alive["mean"][:, 2] > 0).all()
        assert len(set(alive["id"])) == len(alive)
        positions, valid = predicted(tracks, time_s + rng.uniform(0, 0.5), np.eye(4))
        assert np.array_equal(valid, tracks["valid"])
        assert np.isfinite(positions[valid]).all()
        assert (positions[valid, 2] > 0).all()
