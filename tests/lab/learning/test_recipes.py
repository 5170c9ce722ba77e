from __future__ import annotations

from dataclasses import replace

import pytest

from safety_harness.base.exceptions import ModelError
from safety_harness.cell.avoidance.model_file import Dropout
from safety_harness.extensions.lab.learning import recipes


def test_weight_decay_at_the_paper_s_numbers_is_keep_probability_times_gal_s_term() -> None:
    """N = 4e6, tau = 1e-6 per mm^2, l = 0.01: l^2/(2 N tau) = 1.25e-5."""
    recipe = recipes.PAPER_MC_DROPOUT
    assert recipe.weight_decay(4_000_000, 3_000.0) == pytest.approx(0.9 * 1.25e-5)
    assert recipes.PAPER_DETERMINISTIC.weight_decay(4_000_000, 3_000.0) == pytest.approx(1.25e-5)


def test_weight_decay_of_normalised_targets_is_that_of_the_same_problem_in_millimetres() -> None:
    """Gal's objective E/(2 tau') is one in any unit: with y = s z, tau_z = s^2 tau_y."""
    raw = recipes.PAPER_MC_DROPOUT
    normalised = replace(raw, normalise=True)
    assert normalised.weight_decay(1_000, 2_500.0) == pytest.approx(raw.weight_decay(1_000, 2_500.0) / 2_500)


def test_weight_decay_falls_with_the_number_of_samples() -> None:
    recipe = recipes.OURS_MC_DROPOUT
    assert recipe.weight_decay(400, 9.0) == pytest.approx(10 * recipe.weight_decay(4_000, 9.0))


def test_the_paper_s_recipes_have_its_hyper_parameters() -> None:
    for recipe in recipes.RECIPES:
        if recipe.name.startswith("paper-"):
            assert (recipe.batch_size, recipe.learning_rate, recipe.annealed) == (2000, 0.001, False)
            assert recipe.training_samples is None
            assert not recipe.normalise
            assert recipe.split == "by sample"
            assert recipe.epochs == (1200 if recipe.dropout is Dropout.FULL else 200)


def test_every_network_of_the_paper_has_a_recipe_of_each_family() -> None:
    kinds = {(Dropout.NONE, 1), (Dropout.INTER, 1), (Dropout.FULL, 1), (Dropout.NONE, 5)}
    for family in ("paper-", "trial-", ""):
        names = [family + kind for kind in ("deterministic", "mc-dropout", "mc-dropout-full", "ensemble")]
        assert {(r.dropout, r.members) for r in map(recipes.recipe_named, names)} == kinds


def test_a_recipe_is_found_by_its_name_which_is_its_own() -> None:
    assert [recipes.recipe_named(r.name) for r in recipes.RECIPES] == list(recipes.RECIPES)
    assert len({r.name for r in recipes.RECIPES}) == len(recipes.RECIPES)


def test_an_unknown_recipe_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ModelError, match=r"'mc-drpout'.*mc-dropout"):
        recipes.recipe_named("mc-drpout")
