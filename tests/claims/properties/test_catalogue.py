"""Nothing in the catalogue passes by default: each entry has a run that exercises and one that breaks it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import pytest
from broken import BROKEN

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import InputError, Place
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.parse import parse_formula
from safety_harness.claims.properties.base import Evaluation, Unit, Worded
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
# Of the core: a wing tests its own claims.
OWN = [entry for entry in CATALOGUE if type(entry.prop).__module__.startswith("safety_harness.claims.")]
IDS = [entry.example.replace(" ", "-") for entry in OWN]


@lru_cache
def shipped(name: str) -> Trace:
    return run_kinematic(admit(read_scenario(SCENARIOS / f"{name}.yaml")))


def claim(entry: CatalogueEntry) -> Claim:
    return Claim(sentence=entry.example, expected=Verdict.HOLDS)


@pytest.mark.parametrize("entry", OWN, ids=IDS)
def test_its_shipped_scenario_exercises_it(entry: CatalogueEntry) -> None:
    trace = shipped(entry.scenario)
    evaluation = property_of(claim(entry), trace.scenario).evaluate(trace)
    assert evaluation.exercised > 0, evaluation
    assert evaluation.verdict is not Verdict.INCONCLUSIVE, evaluation
    assert evaluation.unit is entry.unit


@pytest.mark.parametrize("entry", OWN, ids=IDS)
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
        assert entry.pattern or entry.make is None  # what follows from the words has the fields of the words
        for field in fields(entry):
            if field.name not in ("pattern", "make", "former", "formula"):
                assert getattr(entry, field.name), (entry.example, field.name)


@pytest.mark.parametrize("entry", OWN, ids=IDS)
def test_its_sentence_is_read_back(entry: CatalogueEntry) -> None:
    """Whether it has a pattern of its own, or both follow from its words."""
    scenario = shipped("servoing-alone").scenario
    match = entry.understands(entry.example)
    assert match is not None
    assert entry.property_of(match, scenario, Place(field="claims[0]")) == entry.prop


def test_each_unit_of_words_is_written_and_read_back() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Several(Worded):
        near_m: float
        late_s: float
        most: float
        times: int
        wording: ClassVar[str] = "{near_m:mm}, {late_s:ms}, {most:%} and {times:} times"
        unit: Unit = Unit.LENGTH

        def evaluate(self, trace: Trace) -> Evaluation:
            raise NotImplementedError

    entry = replace(CATALOGUE[0], prop=Several(near_m=0.05, late_s=0.1, most=0.25, times=3))
    assert entry.example == "50 mm, 100 ms, 25 % and 3 times"
    match, scenario = entry.understands("2 cm, 0.2 s, 1.5 % and 7 times"), shipped("servoing-alone").scenario
    assert match is not None
    read = entry.property_of(match, scenario, Place(field="claims[0]"))
    assert read == Several(near_m=0.02, late_s=0.2, most=0.015, times=7)
    for wrong, why in (("2 s, 1 s, 1 % and 1 times", "2 s"), ("2 m, 1 h, 1 % and 1 times", "1 h")):
        match = entry.understands(wrong)
        assert match is not None
        with pytest.raises(InputError, match=why):
            entry.property_of(match, scenario, Place(field="claims[0]"))


@pytest.mark.parametrize("entry", [one for one in OWN if one.formula], ids=lambda one: one.example)
def test_it_says_what_its_formula_says(entry: CatalogueEntry) -> None:
    for trace in (shipped(entry.scenario), BROKEN[entry.example]()):
        match = entry.understands(entry.example)
        assert match is not None
        formula = FormulaClaim(parse_formula(entry.formula.format(match[1])))
        found, other = entry.prop.evaluate(trace), formula.evaluate(trace)
        assert (found.verdict, found.exercised) == (other.verdict, other.exercised)
        assert found.margin == pytest.approx(other.margin, abs=1e-4)  # of a distance, its resolution


def test_a_property_may_have_its_words_under_their_old_name() -> None:
    class Earlier(Worded):
        words = "at most {most:} time(s)"
        most = 3

    assert Earlier().sentence == "at most 3 times"
