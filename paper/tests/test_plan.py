"""What can be asked for, at which scale, and what that measures."""

from __future__ import annotations

from dataclasses import asdict

import made_up
import pytest

from safety_harness.base.exceptions import SettingsError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.model_file import Dropout
from safety_harness_paper.avoiders import BAYESIAN, OPPOSITE
from safety_harness_paper.plan import PARTS, measuring_order, parts_named
from safety_harness_paper.predictions import SEEN, TCP
from safety_harness_paper.result import ClaimState, PaperVerdict
from safety_harness_paper.scale import DEFAULT, PAPER, QUICK, scale_named
from safety_harness_paper.sensitivity import PART as SENSITIVITY
from safety_harness_paper.sensitivity import conclusions
from safety_harness_paper.sensitivity import result as sensitivity
from safety_harness_paper.variants import BASE, LITERAL_EQ12, VARIANTS
from safety_harness_paper.work import Done, in_order


def names(*what: str) -> list[str]:
    return [part.name for part in parts_named(what)]


def test_all_is_everything_but_the_sensitivity_study() -> None:
    assert names("all") == [
        *(f"table{k}" for k in range(1, 6)),
        *(f"figure{k}" for k in range(5, 9)),
        "timing",
        "outlook",
        "safety",
    ]
    assert names("sensitivity") == ["sensitivity"]
    assert names("table4", "table1", "table4") == ["table1", "table4"]


@pytest.mark.parametrize("what", [["table6"], [], ["all", "everything"]])
def test_what_there_is_not_is_refused_with_what_there_is(what: list[str]) -> None:
    with pytest.raises(SettingsError, match=r"all, or any of table1, .* sensitivity"):
        parts_named(what)


def test_a_scale_by_its_name() -> None:
    assert [scale_named(name).name for name in ("quick", "default", "paper")] == ["quick", "default", "paper"]
    with pytest.raises(SettingsError, match="quick, default, paper"):
        scale_named("huge")


def test_the_papers_scale_has_its_sizes() -> None:
    assert (PAPER.tcps, PAPER.hands, PAPER.inter.training_samples) == (10_000, 500, None)
    assert (PAPER.inter.epochs, PAPER.full.epochs, PAPER.full_long.epochs) == (200, 200, 1200)
    assert (PAPER.inter.learning_rate, PAPER.inter.batch_size, PAPER.inter.normalise) == (1e-3, 2000, False)


def test_the_default_scale_has_at_least_five_trainings_and_what_the_paper_tried() -> None:
    assert DEFAULT.seeds >= 5
    assert (DEFAULT.reach_tcps, DEFAULT.few_trials) == (50, 20)
    assert DEFAULT.trials * DEFAULT.seeds == 500
    assert DEFAULT.full_long.epochs == 6 * DEFAULT.inter.epochs


def test_the_parts_share_their_measurements() -> None:
    tasks = [task for part in PARTS for task in part.tasks(QUICK, 0).values()]
    assert len(in_order(tasks)) < len(tasks)
    trainings = [task for task in in_order(tasks) if task.label.startswith("train")]
    assert len(trainings) == 4 * QUICK.seeds


def test_another_seed_shares_nothing() -> None:
    first, second = (
        {task.key for part in PARTS for task in in_order(part.tasks(QUICK, root).values())} for root in (0, 1)
    )
    assert not first & second


def test_the_longest_trainings_come_last() -> None:
    assert measuring_order(parts_named(["all"]))[-1].name == "table2"


def test_a_variant_differs_in_one_choice() -> None:
    for variant in VARIANTS[1:]:
        settings = [
            name for name, value in asdict(variant.settings).items() if value != asdict(DEFAULTS)[name]
        ]
        recipe, before = asdict(variant.recipe(DEFAULT.inter)), asdict(DEFAULT.inter)
        bent = [name for name, value in recipe.items() if value != before[name]]
        assert len(settings) + len(bent) + (variant.picp != BASE.picp) == 1, variant.name


def test_the_weight_decay_of_a_variant_is_the_one_it_names() -> None:
    (literal,) = (one for one in VARIANTS if one.name == "eq. 12 read literally")
    for recipe in (DEFAULT.deterministic, DEFAULT.inter):
        assert literal.recipe(recipe).weight_decay(4_000_000, 7_000.0) == pytest.approx(LITERAL_EQ12)


def test_variants_of_dropout_leave_the_network_without_it_alone() -> None:
    for variant in VARIANTS:
        assert variant.recipe(DEFAULT.deterministic).dropout is Dropout.NONE


def measured(k: int, *, opposite: float = 220.0, tcp_mm: float = 22.0) -> Done:
    """One variant's training in which all six conclusions hold, unless they are bent."""
    dnn = {SEEN: {"1": made_up.numbers(11.0, k=k)}, TCP: {"1": made_up.numbers(28.0, k=k)}}
    bayesian = {
        SEEN: {
            "5": made_up.numbers(21.0, (0.8, 0.9, 0.9), k=k),
            "10": made_up.numbers(20.0, (0.8, 0.9, 0.9), k=k),
        },
        TCP: {"10": made_up.numbers(tcp_mm, (0.6, 0.7, 0.7), k=k)},
    }
    took = {BAYESIAN: 100.0 + k, OPPOSITE: opposite + k}
    return made_up.done({"models": [dnn, bayesian], "iterations": took})


def test_six_conclusions_that_hold_and_one_that_does_not() -> None:
    rows = [measured(k).result for k in range(3)]
    assert [claim.state for claim in conclusions(rows, "spread")] == [ClaimState.HOLDS] * 6
    slow = [measured(k, opposite=50.0).result for k in range(3)]
    assert [claim.state for claim in conclusions(slow, "spread")][-1] is ClaimState.CONTRADICTED
    by_residuals = conclusions(rows, "spread and residuals")
    assert by_residuals[1].state is ClaimState.UNDECIDED  # 0.95 on every axis


def test_the_sensitivity_study_says_which_conclusions_change() -> None:
    found = {
        f"{variant.name} {k}": measured(k, tcp_mm=40.0 if variant.name == "raw millimetres" else 22.0)
        for variant in VARIANTS
        for k in range(DEFAULT.sensitivity_seeds)
    }
    result = sensitivity(DEFAULT, found)
    assert result.word is PaperVerdict.NO_VERDICT
    assert "raw millimetres: Bayesian DNN better with the TCP unseen (contradicted)" in result.why
    assert "dropout 0.2" not in result.why
    assert len(result.tables[0].rows) == len(VARIANTS)
    assert len(SENSITIVITY.tasks(DEFAULT, 0)) == len(VARIANTS) * DEFAULT.sensitivity_seeds
