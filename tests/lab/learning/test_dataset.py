from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.exceptions import DatasetError
from safety_harness.base.geometry.transforms import transform_from
from safety_harness.base.settings import DEFAULTS, ImageSource, ObjectKind, Settings
from safety_harness.cell.avoidance.candidates import CandidateCap, continuous_optimum
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base, view_of
from safety_harness.cell.servoing.features import feature_error, features
from safety_harness.cell.simulation.cameras import object_polygon_in_base, sensors
from safety_harness.cell.simulation.exact_views import exact_object
from safety_harness.extensions.lab.learning import dataset as dataset_module
from safety_harness.extensions.lab.learning.dataset import (
    CompactDataset,
    candidates_of,
    generate,
    label_floor,
    seen,
    space_named,
)
from safety_harness.extensions.lab.learning.image_error import ImageErrors

SEEN = seen(DEFAULTS)
CAP = CandidateCap.from_settings(DEFAULTS)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
SMALL = generate(DEFAULTS, SEEN, seed=3, tcps=300, hands=7)


def with_object(kind: ObjectKind) -> Settings:
    return replace(DEFAULTS, servo=replace(DEFAULTS.servo, object_kind=kind))


def same(first: CompactDataset, second: CompactDataset) -> bool:
    names = ("tcp_in_base", "selected_in_base", "optimum_in_base", "candidates_in_view", "hand_in_base")
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


@pytest.mark.parametrize("source", [ImageSource.EXACT, ImageSource.RASTER])
def test_image_errors_are_those_of_the_simulated_camera(source: ImageSource) -> None:
    """An independent way to the same number: polygon in base, camera pose in base, as a world does it."""
    settings = replace(DEFAULTS, camera=replace(DEFAULTS.camera, source=source))
    positions = space_named("unseen tcp", settings).tcp.draw(np.random.default_rng(5), 300)
    errors, in_view = ImageErrors.from_settings(settings).at(positions, raster=source is ImageSource.RASTER)
    view, state = view_of(settings), sensors(settings, 0, 0, np.eye(4)).state
    polygon = object_polygon_in_base(settings)
    rotation = desired_transform_tcp_to_base(settings)[:3, :3]
    assert 0 < np.count_nonzero(in_view) < len(positions)
    for position, error, inside in zip(positions, errors, in_view, strict=True):
        moments, current = np.full(31, np.nan), np.empty(6)
        visible = exact_object(state, polygon, transform_from(rotation, position), moments)
        assert visible == inside
        if visible:
            assert features(moments, view.area, view.depth_m, view.dense, current)
            expected = feature_error(current, view.features, np.empty(6))
            assert error == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_the_image_error_of_an_upright_view_is_the_squared_distance_even_beyond_the_border() -> None:
    positions = space_named("unseen tcp", DEFAULTS).tcp.draw(np.random.default_rng(6), 2_000)
    errors, in_view = ImageErrors.from_settings(DEFAULTS).at(positions)
    assert not in_view.all()
    assert errors == pytest.approx(np.sum((positions - DESIRED) ** 2, axis=1), abs=1e-12)


def test_discrete_objects_have_image_errors_too_but_no_raster_image() -> None:
    errors = ImageErrors.from_settings(with_object(ObjectKind.DISCRETE))
    at_desired, in_view = errors.at(DESIRED)
    assert in_view
    assert at_desired == pytest.approx(0.0, abs=1e-18)
    assert errors.at(DESIRED + 0.05)[0] > 1e-3
    with pytest.raises(DatasetError, match="dense"):
        errors.at(DESIRED, raster=True)


def test_selected_is_the_candidate_in_view_with_the_least_error() -> None:
    candidates = candidates_of(SMALL.settings, SMALL.tcp_in_base, SMALL.seed, np.arange(SMALL.tcps))
    errors, in_view = ImageErrors.from_settings(DEFAULTS).at(candidates)
    for k in range(SMALL.tcps):
        best = min(range(100), key=lambda c, k=k: errors[k, c] if in_view[k, c] else np.inf)
        assert np.array_equal(SMALL.selected_in_base[k], candidates[k, best])
    assert np.array_equal(SMALL.candidates_in_view, in_view.sum(axis=1))
    assert SMALL.views_without_object == np.count_nonzero(~in_view)


def test_a_nearer_candidate_that_does_not_see_the_object_is_not_selected_unless_none_does() -> None:
    errors = ImageErrors.from_settings(DEFAULTS)
    out_of_view, in_view = DESIRED + [0.0, 0.2, -0.2], DESIRED + [0.0, 0.0, 0.5]
    further_out = DESIRED + [0.0, 0.3, -0.2]
    best, counts = errors.select(np.array([[out_of_view, in_view], [further_out, out_of_view]]))
    assert np.array_equal(counts, [1, 0])
    assert np.array_equal(best, [1, 1])


def test_tcps_from_which_nothing_can_be_seen_are_refused() -> None:
    below_the_object = np.array([DEFAULTS.object.position_in_base_m]) - [0.0, 0.0, 0.2]
    with pytest.raises(DatasetError, match="1 of 1 TCPs"):
        ImageErrors.from_settings(DEFAULTS).select(below_the_object[:, None])


def test_a_sample_joins_a_tcp_and_a_hand_by_equation_13() -> None:
    assert len(SMALL) == 300 * 7
    index = np.arange(len(SMALL))
    inputs, targets = SMALL.inputs(index), SMALL.targets(index)
    assert inputs.shape == (len(SMALL), 6)
    assert targets.shape == (len(SMALL), 3)
    for k in (0, 6, 7, 1234, len(SMALL) - 1):
        tcp, hand = SMALL.tcp_in_base[k // 7], SMALL.hand_in_base[k % 7]
        assert np.array_equal(inputs[k], np.concatenate([hand, tcp]))
        expected = 0.05 * (tcp - hand) + SMALL.selected_in_base[k // 7]
        assert targets[k] == pytest.approx(expected, abs=1e-15)
        noise_free = SMALL.without_noise().targets(np.array([k]))[0]
        assert noise_free - targets[k] == pytest.approx(
            SMALL.optimum_in_base[k // 7] - SMALL.selected_in_base[k // 7], abs=1e-15
        )
    some = np.array([1234, 5, 1234])
    assert np.array_equal(SMALL.targets(some), targets[some])
    assert np.array_equal(SMALL.inputs(some), inputs[some])
    assert SMALL.inputs(np.array([], dtype=np.int64)).shape == (0, 6)


@pytest.mark.parametrize("beyond", [-1, 300 * 7])
def test_samples_that_do_not_exist_are_an_error(beyond: int) -> None:
    with pytest.raises(IndexError, match="0 to 2099"):
        SMALL.targets(np.array([3, beyond]))


def test_one_seed_is_one_data_set_and_another_seed_another() -> None:
    assert same(SMALL, generate(DEFAULTS, SEEN, seed=3, tcps=300, hands=7))
    other = generate(DEFAULTS, SEEN, seed=4, tcps=300, hands=7)
    assert not np.isin(SMALL.tcp_in_base, other.tcp_in_base).any()
    assert not np.isin(SMALL.hand_in_base, other.hand_in_base).any()


def test_the_data_do_not_depend_on_how_many_are_made_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []
    monkeypatch.setattr(dataset_module, "VIEWS_AT_A_TIME", 1_700)
    assert same(SMALL, generate(DEFAULTS, SEEN, seed=3, tcps=300, hands=7, on_progress=told.append))
    assert told == [*range(17, 300, 17), 300]


def test_a_tcps_candidates_depend_on_the_seed_and_its_number_alone() -> None:
    all_of_them = candidates_of(DEFAULTS, SMALL.tcp_in_base, 3, np.arange(300))
    backwards = candidates_of(DEFAULTS, SMALL.tcp_in_base, 3, np.array([200, 20]))
    assert np.array_equal(backwards, all_of_them[[200, 20]])


def test_another_number_of_candidates_is_part_of_the_settings_that_are_kept() -> None:
    few = generate(DEFAULTS, SEEN, seed=3, tcps=50, candidates=5, hands=2)
    assert few.candidates == few.settings.avoidance.candidate_count == 5
    many = generate(DEFAULTS, SEEN, seed=3, tcps=50, candidates=2_000, hands=2)
    error_of_few = np.linalg.norm(few.selected_in_base - few.optimum_in_base, axis=1)
    error_of_many = np.linalg.norm(many.selected_in_base - many.optimum_in_base, axis=1)
    assert np.median(error_of_many) < 0.3 * np.median(error_of_few)


def test_arrays_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        SMALL.tcp_in_base[0] = 0.0


@pytest.mark.parametrize(
    ("field", "value"), [("tcps", 0), ("candidates", -1), ("hands", 10**9), ("tcps", 10**12), ("seed", -1)]
)
def test_impossible_numbers_are_refused_before_anything_is_made(field: str, value: int) -> None:
    numbers = {"seed": 1, "tcps": 10, "candidates": 10, "hands": 10, field: value}
    with pytest.raises(DatasetError, match=field):
        generate(DEFAULTS, SEEN, **numbers)


def test_raster_images_of_1000_tcps_select_alike_or_nearly_as_well() -> None:
    """Pixels move a_n by tenths of a millimetre, so that near ties may fall the other way."""
    dataset = generate(DEFAULTS, SEEN, seed=8, tcps=1000, hands=1)
    candidates = candidates_of(dataset.settings, dataset.tcp_in_base, 8, np.arange(1000))
    errors = ImageErrors.from_settings(DEFAULTS)
    best, _ = errors.select(candidates, raster=True)
    chosen = candidates[np.arange(1000), best]
    assert np.mean(np.all(chosen == dataset.selected_in_base, axis=1)) > 0.98
    way = np.linalg.norm(chosen - DESIRED, axis=1)
    assert np.all(way - np.linalg.norm(dataset.selected_in_base - DESIRED, axis=1) < 1e-3)


def dense_cap(cap: CandidateCap, count: int) -> np.ndarray:
    """(count, 3) offsets that cover the cap evenly: a Fibonacci lattice about its axis."""
    k = np.arange(count) + 0.5
    cosine = 1.0 - k / count * (1.0 - np.cos(cap.cone_rad))
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    first = np.cross(cap.axis_in_base, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(cap.axis_in_base, first)
    sine = np.sqrt(1.0 - cosine**2)
    return cap.radius_m * (
        cosine[:, None] * cap.axis_in_base
        + (sine * np.cos(turn))[:, None] * first
        + (sine * np.sin(turn))[:, None] * second
    )


@pytest.mark.parametrize("cone_deg", [20.0, 60.0, 120.0])
def test_the_continuous_optimum_is_the_nearest_point_of_the_cap(cone_deg: float) -> None:
    settings = replace(
        DEFAULTS, avoidance=replace(DEFAULTS.avoidance, candidate_cone_rad=np.radians(cone_deg))
    )
    cap = CandidateCap.from_settings(settings)
    tcps = SEEN.tcp.draw(np.random.default_rng(9), 200)
    optimum = continuous_optimum(settings, tcps)
    offsets = optimum - tcps
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(cap.radius_m, abs=1e-14)
    assert np.all(offsets @ cap.axis_in_base >= cap.radius_m * np.cos(cap.cone_rad) - 1e-14)
    samples = dense_cap(cap, 20_000)
    of_optimum = np.linalg.norm(optimum - DESIRED, axis=1)
    of_samples = np.array([np.linalg.norm(tcp + samples - DESIRED, axis=1).min() for tcp in tcps])
    assert np.all(of_optimum <= of_samples + 1e-12)  # none is nearer
    assert np.all(of_samples < of_optimum + 2e-3)  # and it is no nearer than the cap is


def test_selected_candidates_are_never_nearer_than_the_continuous_optimum() -> None:
    of_optimum = np.linalg.norm(SMALL.optimum_in_base - DESIRED, axis=1)
    assert np.all(of_optimum <= np.linalg.norm(SMALL.selected_in_base - DESIRED, axis=1) + 1e-12)


def test_where_no_point_is_nearest_the_optimum_is_still_one_of_the_nearest() -> None:
    """At the desired position, and where the way to it leads against the axis, exactly or nearly."""
    beside = 0.03 * np.cross(CAP.axis_in_base, [1.0, 0.0, 0.0])
    against = [
        DESIRED + 0.03 * CAP.axis_in_base + share * beside for share in (0.0, 1e-14, 1e-11, 1e-8, 1e-4)
    ]
    tcps = np.array([DESIRED, *against])
    offsets = continuous_optimum(DEFAULTS, tcps) - tcps
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(CAP.radius_m, abs=1e-15)
    assert offsets[0] == pytest.approx(CAP.radius_m * CAP.axis_in_base, abs=1e-15)
    along_rim = offsets[1:] @ CAP.axis_in_base
    assert along_rim == pytest.approx(CAP.radius_m * np.cos(CAP.cone_rad), abs=1e-14)


def test_the_label_floor_is_what_redrawing_through_the_image_leaves() -> None:
    """The same floor by brute force: fresh data sets for the same TCPs, selected by image error."""
    tcps = SEEN.tcp.draw(np.random.default_rng(10), 40)
    floor = label_floor(DEFAULTS, tcps, seed=1)
    errors, rows = ImageErrors.from_settings(DEFAULTS), np.arange(40)
    labels = []
    for seed in range(300):
        candidates = candidates_of(DEFAULTS, tcps, 100 + seed, rows)
        labels.append(candidates[rows, errors.select(candidates)[0]])
    drawn = np.array(labels)  # (300, 40, 3)
    rmse = np.sqrt(drawn.var(axis=0, ddof=1).mean(axis=0))
    mae = np.abs(drawn - np.median(drawn, axis=0)).mean(axis=(0, 1))
    assert floor.rmse_m == pytest.approx(rmse, rel=0.05)
    assert floor.mae_m == pytest.approx(mae, rel=0.05)


def test_no_prediction_from_the_tcp_alone_beats_the_floor() -> None:
    """The mean label over other draws, and the optimum, against labels drawn afresh."""
    tcps = SEEN.tcp.draw(np.random.default_rng(11), 150)
    floor = label_floor(DEFAULTS, tcps, seed=2)
    rows = np.arange(150)
    labels = np.array(
        [
            candidates[rows, np.argmin(np.linalg.norm(candidates - DESIRED, axis=2), axis=1)]
            for candidates in (candidates_of(DEFAULTS, tcps, seed, rows) for seed in range(300))
        ]
    )
    mean_of_others = labels[:150].mean(axis=0)
    for prediction, least in ((mean_of_others, 0.97), (continuous_optimum(DEFAULTS, tcps), 1.0)):
        rmse = np.sqrt(((labels[150:] - prediction) ** 2).mean(axis=(0, 1)))
        assert np.all(rmse > least * np.array(floor.rmse_m))


def test_more_candidates_lower_the_floor() -> None:
    tcps = SEEN.tcp.draw(np.random.default_rng(12), 20)
    many = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, candidate_count=1000))
    few = label_floor(DEFAULTS, tcps, seed=1, redraws=200)
    assert np.all(np.array(label_floor(many, tcps, seed=1, redraws=200).rmse_m) < 0.6 * np.array(few.rmse_m))


def test_a_floor_over_nothing_is_refused() -> None:
    with pytest.raises(DatasetError, match="redraws"):
        label_floor(DEFAULTS, SMALL.tcp_in_base, seed=1, redraws=1)
    with pytest.raises(DatasetError, match="at least one TCP"):
        label_floor(DEFAULTS, np.empty((0, 3)), seed=1)
