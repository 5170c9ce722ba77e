"""Nothing in the catalogue passes by default: each entry has a run that exercises and one that breaks it."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import pytest
from broken import BROKEN

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_trial
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
IDS = [entry.example.replace(" ", "-") for entry in CATALOGUE]


@lru_cache
def shipped(name: str) -> Trace:
    return run_trial(admit(read_scenario(SCENARIOS / f"{name}.yaml")))


def claim(entry: CatalogueEntry) -> Claim:
    return Claim(sentence=entry.example, expected=Verdict.HOLDS)


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_its_shipped_scenario_exercises_it(entry: CatalogueEntry) -> None:
    trace = shipped(entry.scenario)
    evaluation = property_of(claim(entry), trace.scenario).evaluate(trace)
    assert evaluation.exercised > 0, evaluation
    assert evaluation.verdict is not Verdict.INCONCLUSIVE, evaluation
    assert evaluation.unit is entry.unit


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_something_breaks_it(entry: CatalogueEntry) -> None:
    trace = BROKEN[entry.example]()
    evaluation = property_of(claim(entry), trace.scenario).evaluate(trace)
    assert evaluation.verdict is Verdict.VIOLATED, evaluation
    assert evaluation.margin is not None
    assert evaluation.margin < 0.0


def test_no_two_entries_understand_the_same_sentence() -> None:
    for entry in CATALOGUE:
        trace = shipped("servoing-alone")
        assert property_of(claim(entry), trace.scenario).sentence == entry.example


def test_every_entry_says_everything_about_itself() -> None:
    for entry in CATALOGUE:
        assert bool(entry.pattern) == (entry.make is not None)  # without both: by its own sentence alone
        for field in fields(entry):
            if field.name not in ("pattern", "make"):
                assert getattr(entry, field.name), (entry.example, field.name)
