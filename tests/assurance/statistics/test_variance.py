"""The variance split: by hand, measured coverage, and what it refuses."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from acceptance import misses_are, misses_are_no_more_than
from streams import declared, margins_of, told, violations

from safety_harness.base.exceptions import StatisticsError
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.extensions.assurance.statistics.variance import (
    NestedSample,
    variance_split,
    violation_split,
)

H, V, U, I, F = (int(outcome) for outcome in EpisodeOutcome)  # noqa: E741


def nested(margins: Any, outcomes: Any = None, **changes: Any) -> NestedSample:
    signed = np.asarray(margins, float)
    codes = np.where(signed < 0.0, V, H) if outcomes is None else np.asarray(outcomes)
    declaration = declared(len(signed), **changes)
    return NestedSample.of_design(declaration, np.arange(len(signed)), codes, signed, **told(codes))


def drawn(rng: np.random.Generator, m: int, k: int, share: float) -> np.ndarray:
    return np.sqrt(share) * rng.normal(size=(m, 1)) + np.sqrt(1.0 - share) * rng.normal(size=(m, k))


def test_the_parts_by_hand() -> None:
    """Means 1 and 5: between = 2 (4 + 4) = 16; within = 2; (16 - 2) / 2 = 7."""
    found = variance_split(nested([[0.0, 2.0], [4.0, 6.0]]))
    assert found.draw_deviation == pytest.approx(np.sqrt(2.0))
    assert found.scenario_deviation == pytest.approx(np.sqrt(7.0))
    assert found.share == pytest.approx(7.0 / 9.0)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_the_interval_of_normal_margins_is_exact(share: float) -> None:
    rng, missed = np.random.default_rng(9), 0
    for _ in range(400):
        found = variance_split(nested(drawn(rng, 12, 4, share)), 0.9)
        missed += not found.low <= share <= found.high
    # at no share at all only the low end can be wrong
    assert misses_are(missed, 400, 0.05 if share == 0.0 else 0.1)


def test_chance_alone_and_scenarios_alone() -> None:
    rng = np.random.default_rng(10)
    alone = variance_split(nested(np.repeat(rng.normal(size=(20, 1)), 5, axis=1)))
    assert (alone.share, alone.draw_deviation, alone.low) == pytest.approx((1.0, 0.0, 1.0), abs=1e-12)
    chance = variance_split(nested(drawn(rng, 60, 20, 0.0)))
    assert chance.share < 0.05
    assert chance.low == 0.0


def test_the_same_sample_gives_the_same_bootstrap() -> None:
    margins = drawn(np.random.default_rng(11), 15, 4, 0.5)
    assert variance_split(nested(margins)) == variance_split(nested(margins))
    assert variance_split(nested(margins)) != variance_split(nested(margins, seed=5))


def test_the_bootstrap_is_near_the_exact_interval_for_many_normal_scenarios() -> None:
    found = variance_split(nested(drawn(np.random.default_rng(12), 300, 5, 0.5)))
    assert (found.bootstrap_low, found.bootstrap_high) == pytest.approx((found.low, found.high), abs=0.03)


def test_the_bootstrap_holds_about_as_often_as_it_says_where_the_f_interval_does_not() -> None:
    rng, f, bootstrap = np.random.default_rng(17), 0, 0
    for _ in range(200):
        heavy = [rng.laplace(size=shape) / np.sqrt(2.0) for shape in ((40, 1), (40, 5))]
        found = variance_split(nested(np.sqrt(0.8) * heavy[0] + np.sqrt(0.2) * heavy[1]))
        f += not found.low <= 0.8 <= found.high
        bootstrap += not found.bootstrap_low <= 0.8 <= found.bootstrap_high
    assert misses_are_no_more_than(bootstrap, 200, 0.08)
    assert not misses_are_no_more_than(f, 200, 0.08)


def test_scenarios_that_always_sometimes_and_never_violate() -> None:
    codes = [[V, V, V]] * 2 + [[V, H, H], [V, H, U], [V, F, H]] + [[H, H, H]] * 90 + [[H, H, I], [V, V, U]]
    found = violation_split(nested(margins_of(codes), codes))
    assert (found.always.count, found.sometimes.count, found.never.count, found.unclear) == (2, 3, 90, 2)
    for share in (found.always, found.sometimes, found.never):
        assert share.low < share.count / 97 < share.high
    assert found.draws == 3


def test_the_three_shares_hold_together_as_often_as_they_say() -> None:
    rng, missed, truth = np.random.default_rng(13), 0, np.array([0.1, 0.2, 0.7])
    rows = np.array([[V, V], [V, H], [H, H]])
    for _ in range(600):
        drawn = rows[rng.choice(3, 50, p=truth)]
        found = violation_split(nested(margins_of(drawn), drawn), 0.9)
        shares = (found.always, found.sometimes, found.never)
        missed += any(not one.low <= p <= one.high for one, p in zip(shares, truth, strict=True))
    assert misses_are_no_more_than(missed, 600, 0.1)


@pytest.mark.parametrize(("world", "model_only"), [(KINEMATIC, True), (PYBULLET, False)])
def test_what_comes_of_a_simplified_world_says_so(world: WorldEntry, model_only: bool) -> None:
    design = nested([[0.0, 2.0], [4.0, 6.0]], world=world)
    assert variance_split(design).model_only is model_only
    assert violation_split(design).model_only is model_only


def test_what_is_no_design_is_refused() -> None:
    with pytest.raises(StatisticsError, match="two scenarios and two draws"):
        nested([[1.0], [2.0]])
    with pytest.raises(StatisticsError, match="two scenarios and two draws"):
        nested([[1.0, 2.0]])
    with pytest.raises(StatisticsError, match="a margin of every run; got 1 of 4"):
        variance_split(nested([[1.0, np.nan], [2.0, 3.0]], [[H, F], [H, H]]))
    for unsaid in (U, I, F):
        with pytest.raises(StatisticsError, match="a margin of every run; got 1 of 4"):
            variance_split(nested([[1.0, 4.0], [2.0, 3.0]], [[H, unsaid], [H, H]]))
    with pytest.raises(StatisticsError, match="all the same"):
        variance_split(nested(np.ones((3, 3))))
    held = np.zeros((2, 2), int)
    with pytest.raises(StatisticsError, match="some are missing"):
        NestedSample.of_design(declared(2), [0, 2], held, np.ones((2, 2)), **told(held))
    with pytest.raises(StatisticsError, match="as many episodes"):
        NestedSample.of_design(declared(2), [0, 1], held[[0, 0, 1]], np.ones((3, 2)), **told(held))
    with pytest.raises(StatisticsError, match="a seed of its own"):
        NestedSample.of_design(
            declared(2), [0, 1], held, np.ones((2, 2)), **told(held, seeds=[[1, 2], [3, 1]])
        )


def test_only_a_design_is_split() -> None:
    with pytest.raises(TypeError, match="declared design"):
        variance_split(violations(1, 9))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="of_design"):
        dataclasses.replace(nested(np.ones((2, 2))), margins=np.zeros((2, 2)))
