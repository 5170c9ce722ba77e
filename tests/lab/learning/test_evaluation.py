"""Figures against the definitions written out once more, against uncertainty-toolbox, and as laws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cell.avoidance.random_models import random_model
from disagreement import noted
from uncertainty_toolbox import metrics_accuracy, metrics_calibration

from safety_harness.base.exceptions import ModelError, Place
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Calibration, Dropout, Model, load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.cell.controller.desired import reachable
from safety_harness.extensions.lab.learning import metrics, trained_model
from safety_harness.extensions.lab.learning.dataset import SPACES, SPLITS, generate, seen, space_named
from safety_harness.extensions.lab.learning.evaluation import (
    BRANCH,
    LEVELS,
    DataCard,
    EvaluationSet,
    Figures,
    evaluate_model,
    fresh_sets,
    has_spread,
    leaf,
)
from safety_harness.extensions.lab.learning.evaluation import (
    test_part as make_test_part,
)
from safety_harness.extensions.lab.learning.manifest import data_hash
from safety_harness.extensions.lab.learning.metrics import RESIDUALS

SAMPLES = 400
HERE = Place(file=Path("a.safetensors"))
NAMES = ["seen, new TCPs", "unseen hand", "unseen tcp", "unseen both"]


@pytest.fixture(scope="module")
def sets() -> list[EvaluationSet]:
    return fresh_sets(DEFAULTS, samples=SAMPLES, seed=3, candidates=100)


@pytest.fixture(scope="module")
def shipped() -> Model:
    return load_model(shipped_model("mc-dropout"))


@pytest.fixture(scope="module")
def figures(shipped: Model, sets: list[EvaluationSet]) -> list[Figures]:
    return evaluate_model("shipped", shipped, sets, DEFAULTS, place=HERE)


def calibrated(model: Model, multiplier: float = 2.0, threshold_m: float = 0.01) -> Model:
    made = Calibration(
        interval_multiplier=multiplier,
        spread_threshold_m=threshold_m,
        residual_std_m=(0.01, 0.02, 0.03),
        samples=9,
    )
    return replace(model, calibration=made)


def constant(position_in_base_m: tuple[float, float, float]) -> Model:
    """All weights zero: the mean of the targets, whatever it is asked."""
    model = random_model(Dropout.NONE)
    zeros = {name: np.zeros_like(t) + name.endswith("running_var") for name, t in model.tensors.items()}
    return replace(model, target_mean=position_in_base_m, tensors=zeros)


def test_each_set_lies_in_its_space_and_uses_no_tcp_or_hand_twice(sets: list[EvaluationSet]) -> None:
    assert [one.name for one in sets] == NAMES
    assert [one.seen for one in sets] == [True, False, False, False]
    for one, name in zip(sets, SPACES, strict=True):
        space = space_named(name, DEFAULTS)
        assert space.hand.contains(one.hands_in_base).all()
        assert space.tcp.contains(one.tcps_in_base).all()
        for points in (one.hands_in_base, one.tcps_in_base):
            assert len(np.unique(points, axis=0)) == SAMPLES
        assert len(np.unique(one.decision_seeds)) == SAMPLES


def test_labels_are_eq_13_s_with_a_candidate_and_with_the_optimum(sets: list[EvaluationSet]) -> None:
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    for one in sets:
        pull = 0.05 * (one.tcps_in_base - one.hands_in_base)
        selected, optimum = one.labels_in_base - pull, one.noise_free_in_base - pull
        for point in (selected, optimum):
            assert np.linalg.norm(point - one.tcps_in_base, axis=1) == pytest.approx(0.1)
        nearer = np.linalg.norm(optimum - desired, axis=1) <= np.linalg.norm(selected - desired, axis=1)
        assert nearer.all()


def test_sets_follow_the_seed_and_differ_from_those_of_a_calibration(sets: list[EvaluationSet]) -> None:
    again = fresh_sets(DEFAULTS, samples=30, seed=3, candidates=100)
    other = fresh_sets(DEFAULTS, samples=30, seed=4, candidates=100)
    for one, same, different in zip(sets, again, other, strict=True):
        assert np.array_equal(one.tcps_in_base[:30], same.tcps_in_base)
        assert not np.isin(different.tcps_in_base, one.tcps_in_base).any()
    assert BRANCH != trained_model.BRANCH
    ours = {leaf(seed, k) for seed in range(20) for k in range(5)}
    theirs = {
        int(np.random.SeedSequence(seed, spawn_key=(trained_model.BRANCH, k)).generate_state(1, np.uint64)[0])
        for seed in range(20)
        for k in range(5)
    }
    assert len(ours) == len(theirs) == 100
    assert not ours & (theirs | set(range(1_000)))


def test_only_seen_sets_have_a_label_floor_and_the_network_is_above_it(figures: list[Figures]) -> None:
    assert [one.set.floor is None for one in figures] == [False, True, True, True]
    floor = figures[0].set.floor
    assert floor is not None
    assert floor.redraws == 1_000
    ratio = figures[0].errors.rmse / floor.rmse_m
    assert ((ratio > 0.9) & (ratio < 1.3)).all()


@pytest.mark.parametrize("kind", ["by TCP", "by sample"])
def test_the_test_part_is_the_training_s_own_with_one_row_a_tcp(kind: str) -> None:
    data = generate(DEFAULTS, seen(DEFAULTS), seed=6, tcps=40, candidates=10, hands=5)
    card = DataCard(6, 40, 10, 5, kind, data_hash(data))
    part, why = make_test_part(DEFAULTS, card, samples=100, seed=1)
    assert part is not None
    assert why == ""
    split = SPLITS[kind](data, seed=6)
    inputs = data.inputs(split.test)
    rows = np.concatenate([part.hands_in_base, part.tcps_in_base], axis=1)
    where = [np.flatnonzero((inputs == row).all(axis=1)) for row in rows]
    assert all(len(found) == 1 for found in where)
    assert np.array_equal(part.labels_in_base, data.targets(split.test)[np.concatenate(where)])
    assert len(np.unique(part.tcps_in_base, axis=0)) == len(part) == len(np.unique(split.test // 5))
    trained = {tuple(tcp) for tcp in data.inputs(split.train)[:, 3:]}
    leaked = [tuple(tcp) in trained for tcp in part.tcps_in_base]
    assert all(leaked) if kind == "by sample" else not any(leaked)
    fewer, _ = make_test_part(DEFAULTS, card, samples=2, seed=1)
    assert fewer is not None
    assert len(fewer) == 2


def test_training_data_that_cannot_be_made_again_are_no_test_part() -> None:
    part, why = make_test_part(DEFAULTS, DataCard(6, 40, 10, 5, "by TCP", "0" * 64), samples=9, seed=1)
    assert part is None
    assert "another hash" in why
    part, why = make_test_part(DEFAULTS, DataCard(6, 10**7, 10**5, 5, "by TCP", ""), samples=9, seed=1)
    assert part is None
    assert "10000000 TCPs" in why


def test_a_card_that_says_less_or_something_else_is_none(shipped: Model) -> None:
    data = dict(shipped.card["data"])
    whole = DataCard.from_card({"data": data})
    assert whole is not None
    assert (whole.tcps, whole.split) == (10_000, "by TCP")
    for change in ({"tcps": "many"}, {"seed": -1}, {"split": []}, {"space": "mine"}, {"sha256": None}):
        assert DataCard.from_card({"data": data | change}) is None
    assert DataCard.from_card({}) is None
    assert DataCard.from_card({"data": "random weights"}) is None


def test_errors_of_a_constant_answer_are_those_of_its_distance(sets: list[EvaluationSet]) -> None:
    at = (0.7, 0.0, 0.4)
    for found in evaluate_model("constant", constant(at), sets, DEFAULTS, place=HERE):
        off = found.set.labels_in_base - at
        assert found.errors.rmse == pytest.approx(np.sqrt((off**2).mean(axis=0)), rel=1e-6)
        assert found.noise_free.overall_mae == pytest.approx(
            np.abs(found.set.noise_free_in_base - at).mean(), rel=1e-6
        )
        assert found.median_largest_spread_m == 0.0
        assert found.auroc is None  # there is no spread to tell by
        assert found.unreachable.count == 0
    far = evaluate_model("far", constant((2.0, 0.0, 0.4)), sets[:1], DEFAULTS, place=HERE)
    assert far[0].unreachable.share == 1.0


def test_reachable_is_what_the_arm_can_reach() -> None:
    points = np.array([[0.7, 0.0, 0.35], [1.5, 0.0, 0.35], [0.0, 0.0, 0.3], [0.5, 0.3, 0.2]])
    assert reachable(points, DEFAULTS).tolist() == [True, False, False, True]


def test_a_model_for_labels_without_noise_is_measured_on_such(sets: list[EvaluationSet]) -> None:
    model = replace(constant((0.7, 0.0, 0.4)), card={"recipe": {"target": "continuous"}})
    (found,) = evaluate_model("optimum", model, sets[:1], DEFAULTS, place=HERE)
    assert found.errors.rmse.tolist() == found.noise_free.rmse.tolist()


def test_intervals_and_threshold_are_the_calibration_s(sets: list[EvaluationSet]) -> None:
    model = random_model(Dropout.INTER)
    one = sets[0]
    positions, spreads = LearnedAvoider.from_model(model).propose_many(
        one.hands_in_base, one.tcps_in_base, one.decision_seeds
    )
    threshold_m = float(np.median(spreads.max(axis=1)))
    (found,) = evaluate_model("m", calibrated(model, 1.5, threshold_m), [one], DEFAULTS, place=HERE)
    half = 1.5 * np.sqrt(spreads**2 + np.array([0.01, 0.02, 0.03]) ** 2)
    inside = np.abs(positions - one.labels_in_base) <= half
    assert found.intervals is not None
    assert found.intervals.covered.count == inside.all(axis=1).sum()
    assert found.intervals.coverage.picp == pytest.approx(inside.mean(axis=0))
    assert found.intervals.coverage.mean_width == pytest.approx(2 * half.mean(axis=0))
    above = found.intervals.above_threshold
    assert above is not None
    assert above.count == (spreads.max(axis=1) > threshold_m).sum() == SAMPLES // 2


def test_wide_intervals_cover_all_and_narrow_ones_nothing(sets: list[EvaluationSet]) -> None:
    for multiplier, share in ((1e3, 1.0), (1e-9, 0.0)):
        model = calibrated(random_model(Dropout.INTER), multiplier)
        (found,) = evaluate_model("m", model, sets[:1], DEFAULTS, place=HERE)
        assert found.intervals is not None
        assert found.intervals.covered.share == share


def test_a_model_without_calibration_has_no_intervals_and_one_without_spread_no_alarms(
    sets: list[EvaluationSet],
) -> None:
    (plain,) = evaluate_model("m", random_model(Dropout.INTER), sets[:1], DEFAULTS, place=HERE)
    assert plain.intervals is None
    assert RESIDUALS not in plain.picp
    assert list(plain.curves) == ["spread"]
    (certain,) = evaluate_model("m", calibrated(constant((0.7, 0.0, 0.4))), sets[:1], DEFAULTS, place=HERE)
    assert certain.intervals is not None
    assert certain.intervals.above_threshold is None
    assert list(certain.curves) == ["spread", RESIDUALS]


def test_the_shipped_model_keeps_its_promises_on_new_tcps_and_notices_unseen_ones(
    figures: list[Figures],
) -> None:
    new, _, unseen_tcp, unseen_both = figures
    assert new.intervals is not None
    assert new.intervals.covered.low <= 0.95 <= new.intervals.covered.high + 0.02
    for one in (unseen_tcp, unseen_both):
        assert one.auroc is not None
        assert one.auroc > 0.8
        assert one.intervals is not None
        alarms, false = one.intervals.above_threshold, new.intervals.above_threshold
        assert alarms is not None
        assert false is not None
        assert alarms.low > false.high


def test_an_auroc_tells_each_unseen_set_from_the_first(
    shipped: Model, sets: list[EvaluationSet], figures: list[Figures]
) -> None:
    avoider = LearnedAvoider.from_model(shipped)
    scores = [
        avoider.propose_many(one.hands_in_base, one.tcps_in_base, one.decision_seeds)[1].max(axis=1)
        for one in sets
    ]
    assert figures[0].auroc is None
    for found, having in zip(figures[1:], scores[1:], strict=True):
        order = (having[:, None] > scores[0]).mean() + 0.5 * (having[:, None] == scores[0]).mean()
        assert found.auroc == pytest.approx(order)


def test_an_answer_that_is_not_finite_is_no_evidence(sets: list[EvaluationSet]) -> None:
    model = random_model(Dropout.NONE)
    huge = {name: np.full_like(t, 1e30) if "fc" in name else t for name, t in model.tensors.items()}
    with pytest.raises(ModelError, match=r"a\.safetensors: expected finite answers on the set 'seen, new"):
        evaluate_model("huge", replace(model, tensors=huge), sets, DEFAULTS, place=HERE)


def test_spread_is_what_dropout_or_several_members_have() -> None:
    assert not has_spread(random_model(Dropout.NONE))
    assert has_spread(random_model(Dropout.NONE, members=2))
    assert has_spread(random_model(Dropout.FULL))


# ---- uncertainty-toolbox 0.1.1, one axis at a time --------------------------------------------------


def agree_with_the_toolbox(predictions: np.ndarray, labels: np.ndarray, stds: np.ndarray) -> None:
    """RMSE, MAE, PICP at 95 % and at every level of the curve, and its mean distance from the diagonal."""
    errors = metrics.errors(predictions, labels)
    covered = metrics.coverage(predictions, labels, metrics.half_width_of_spread(stds))
    levels = np.linspace(0.0, 1.0, 21)[1:-1]
    curve = metrics.calibration_curve(predictions, labels, stds, levels)
    for axis in range(3):
        mean, std, label = predictions[:, axis], stds[:, axis], labels[:, axis]
        accuracy = metrics_accuracy.prediction_error_metrics(mean, label)
        assert errors.rmse[axis] == pytest.approx(accuracy["rmse"])
        assert errors.mae[axis] == pytest.approx(accuracy["mae"])
        expected, observed = metrics_calibration.get_proportion_lists_vectorized(
            mean, std, label, num_bins=21
        )
        assert expected[1:-1] == pytest.approx(levels)
        noted("uncertainty-toolbox", "shares within intervals", "", curve[:, axis], observed[1:-1])
        assert curve[:, axis] == pytest.approx(observed[1:-1], abs=1e-12)
        ends = np.abs([observed[0] - 0.0, observed[-1] - 1.0]).sum()  # the toolbox counts 0 % and 100 % too
        distance = (np.abs(curve[:, axis] - levels).sum() + ends) / 21
        assert distance == pytest.approx(
            metrics_calibration.mean_absolute_calibration_error(
                mean, std, label, num_bins=21, vectorized=True
            )
        )
        at_95 = metrics_calibration.get_proportion_in_interval(mean, std, label, 0.95)
        assert covered.picp[axis] == pytest.approx(at_95, abs=2 / len(mean))  # 1.96 against 1.95996


def test_metrics_agree_with_the_toolbox_on_random_numbers() -> None:
    rng = np.random.default_rng(12)
    stds = rng.uniform(0.5, 2.0, (3_000, 3))
    means = rng.normal(0.0, 3.0, (3_000, 3))
    labels = rng.normal(means + [0.2, 0.0, -0.4], 1.3 * stds)
    agree_with_the_toolbox(means, labels, stds)


def test_figures_of_a_model_agree_with_the_toolbox(
    shipped: Model, sets: list[EvaluationSet], figures: list[Figures]
) -> None:
    assert shipped.calibration is not None
    for one, found in zip(sets, figures, strict=True):
        positions, spreads = LearnedAvoider.from_model(shipped).propose_many(
            one.hands_in_base, one.tcps_in_base, one.decision_seeds
        )
        scale = np.sqrt(spreads**2 + np.array(shipped.calibration.residual_std_m) ** 2)
        agree_with_the_toolbox(positions, one.labels_in_base, spreads)
        agree_with_the_toolbox(positions, one.labels_in_base, scale)
        for stds, name in ((spreads, "spread"), (scale, RESIDUALS)):
            for axis in range(3):
                for row, level in enumerate(LEVELS):
                    share = metrics_calibration.get_proportion_in_interval(
                        positions[:, axis], stds[:, axis], one.labels_in_base[:, axis], level
                    )
                    assert found.curves[name][row, axis] == pytest.approx(share, abs=1e-12)
            picp = found.picp[name].picp
            assert picp == pytest.approx(found.curves[name][LEVELS.index(0.95)], abs=2 / SAMPLES)
