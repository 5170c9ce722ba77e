"""What the report says of the system under test."""

from __future__ import annotations

from dataclasses import replace

import pytest
from examples import VISIT, scenario

from safety_harness.base.exceptions import ModelError
from safety_harness.cell.avoidance.model_file import load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.extensions.assurance.certification.system import card_of, model_of


def test_a_network_in_the_home_of_nobody_is_one_that_is_missing() -> None:
    nobody = replace(scenario(VISIT, duration_s=1.0), avoider="~nobody of that name/x.safetensors")
    with pytest.raises(ModelError, match="no such file"):
        model_of(nobody)


def test_of_a_card_that_says_little_what_it_says_is_told() -> None:
    model = load_model(shipped_model("student"))
    told = dict(card_of(replace(model, card={"data": {"tcps": 3, "hands": [1]}, "recipe": "of a friend"})))
    assert told["Data: answers"] == "not stated"
    assert told["Learning: recipe"] == "of a friend"
    assert "Data: how many" not in told
    assert "Data: where from" not in told


def test_what_answers_are_of_random_candidates_says_so_and_how_many() -> None:
    told = {
        name: dict(card_of(load_model(shipped_model(name))))["Data: answers"]
        for name in ("mc-dropout", "optimum")
    }
    assert "100 random candidates" in told["mc-dropout"]
    assert "no noise" in told["optimum"]
