"""Calibration on held-out seen TCPs: what it promises is what fresh draws show."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Calibration, Model, load_model
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.extensions.lab.learning.dataset import CompactDataset, generate, seen
from safety_harness.extensions.lab.learning.manifest import is_named_by
from safety_harness.extensions.lab.learning.recipes import recipe_named
from safety_harness.extensions.lab.learning.trained_model import (
    COVERAGE_LEVEL,
    SPREAD_LEVEL,
    calibrate,
    interval_scale,
)

N = 10_000


@pytest.fixture(scope="module")
def paper() -> CompactDataset:
    """What the shipped networks were trained on."""
    return generate(DEFAULTS, seen(DEFAULTS), seed=0)


@pytest.fixture(scope="module")
def fresh() -> CompactDataset:
    return generate(DEFAULTS, seen(DEFAULTS), seed=987_654_321, tcps=N, hands=N)


@pytest.fixture(scope="module")
def shipped() -> Model:
    return load_model(shipped_model("mc-dropout"))


def calibration_of(model: Model) -> Calibration:
    assert model.calibration is not None
    return model.calibration


def test_intervals_cover_all_axes_and_spreads_stay_below_the_threshold_as_promised(
    shipped: Model, fresh: CompactDataset
) -> None:
    pairs = np.arange(N) * (N + 1)
    inputs, targets = fresh.inputs(pairs), fresh.targets(pairs)
    seeds = np.arange(N, dtype=np.uint64)
    predictions, spreads = LearnedAvoider.from_model(shipped).propose_many(
        inputs[:, :3], inputs[:, 3:], seeds
    )
    found = calibration_of(shipped)
    half_width = found.interval_multiplier * interval_scale(spreads, np.array(found.residual_std_m))
    covered = (np.abs(predictions - targets) <= half_width).all(axis=1).mean()
    # Both quantiles and this test have 10,000 rows each: 4 standard deviations of their difference.
    assert abs(covered - COVERAGE_LEVEL) < 4.0 * np.sqrt(2.0 * 0.95 * 0.05 / N)
    above = (spreads.max(axis=1) > found.spread_threshold_m).mean()
    assert abs(above - (1.0 - SPREAD_LEVEL)) < 4.0 * np.sqrt(2.0 * 0.99 * 0.01 / N)


def test_the_shipped_calibration_is_what_the_command_makes(shipped: Model, paper: CompactDataset) -> None:
    again = calibrate(replace(shipped, calibration=None), recipe_named("mc-dropout"), paper, seed=0)
    assert calibration_of(again) == calibration_of(shipped)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_network_was_trained_on_the_data_that_its_card_names(
    name: str, paper: CompactDataset, fresh: CompactDataset
) -> None:
    card = load_model(shipped_model(name)).card
    assert is_named_by(paper, card["data"]["sha256"])
    assert not is_named_by(fresh, card["data"]["sha256"])
    assert card["data"]["split"] == "by TCP"
    assert card["command"] == f"safety-harness train {name} --seed 0 --out models/{name}"


def test_calibration_uses_no_tcp_that_was_trained_on(
    shipped: Model, paper: CompactDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[CompactDataset] = []

    def watched(*args: object, **options: object) -> CompactDataset:
        drawn.append(generate(*args, **options))  # type: ignore[arg-type]
        return drawn[-1]

    monkeypatch.setattr("safety_harness.extensions.lab.learning.dataset.generate", watched)
    calibrate(replace(shipped, calibration=None), recipe_named("mc-dropout"), paper, seed=0, samples=500)
    tcps = np.concatenate([one.tcp_in_base for one in drawn] + [paper.tcp_in_base])
    assert len(np.unique(tcps, axis=0)) == len(tcps) == 2 * 500 + 10_000


def test_a_network_that_is_wrong_gets_wider_intervals(shipped: Model, paper: CompactDataset) -> None:
    x, y, z = shipped.target_mean
    off = replace(shipped, calibration=None, target_mean=(x + 0.1, y, z))  # 100 mm beside the truth
    recipe = recipe_named("mc-dropout")
    wrong = calibration_of(calibrate(off, recipe, paper, seed=0, samples=500))
    assert wrong.residual_std_m[0] > 0.1 > 3.0 * wrong.residual_std_m[1]


@pytest.mark.parametrize("name", SHIPPED)
def test_the_page_of_model_cards_is_about_the_shipped_files(name: str) -> None:
    page = (Path(__file__).parents[3] / "docs" / "results" / "networks.md").read_text()
    section = page.split(f"\n## {name}\n", 1)[1].split("\n## ", 1)[0]
    model = load_model(shipped_model(name))
    assert hashlib.sha256(shipped_model(name).read_bytes()).hexdigest() in section
    assert f"spread threshold {1e3 * calibration_of(model).spread_threshold_m:.2f}" in section
    assert model.card["command"] in section
    assert model.card["data"]["sha256"] in page
