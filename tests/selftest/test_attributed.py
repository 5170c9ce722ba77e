"""A seeded fault is laid at the part that it sits in."""

from __future__ import annotations

import pytest
from small import shipped

from safety_harness.extensions.attribution.ingredients import Ingredient
from safety_harness.extensions.selftest.attributed import INGREDIENTS, attribute_seeded
from safety_harness.extensions.selftest.catalogue import FAULTS
from safety_harness.extensions.selftest.fault import FaultyPart, SeededFault
from safety_harness.scenario.model import Claim, Verdict


def named(name: str) -> SeededFault:
    (fault,) = (one for one in FAULTS if one.name == name)
    return fault


def test_every_part_is_an_ingredient_of_its_own() -> None:
    assert set(INGREDIENTS) == set(FaultyPart)
    assert len(set(INGREDIENTS.values())) == len(FaultyPart)


@pytest.mark.parametrize(
    ("name", "sentence", "ingredient"),
    [
        ("sign flip", "repulsion moves away from every hand", Ingredient.AVOIDER),
        ("late commands", "repulsion moves away from every hand", Ingredient.DEADLINE),
    ],
)
def test_a_seeded_fault_is_blamed(name: str, sentence: str, ingredient: Ingredient) -> None:
    fault = named(name)
    claim = Claim(sentence=sentence, expected=Verdict.HOLDS)
    episode = shipped("hand-visits-and-leaves")
    (found,) = attribute_seeded(fault, fault.ladder.values[0], episode, [claim])
    assert found.cause == (ingredient,)
