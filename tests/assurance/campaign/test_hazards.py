"""Hazards of a plan: what is derived from them, step by step, and what is refused with its place."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.campaign.hazards import CountedApproaches
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.risk_graph import (
    ISO_13849,
    PATHS,
    PFH_D,
    UNKNOWN,
    band_of,
    derived,
)
from safety_harness.extensions.assurance.statistics.rates import most_an_hour
from tests.assurance.campaign.hazards import DERIVED, HAZARDOUS, HAZARDS
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT


def test_the_default_graph_is_that_of_annex_a() -> None:
    assert dict(ISO_13849.levels) == {
        **{"S1 F1 P1": "a", "S1 F1 P2": "b", "S1 F2 P1": "b", "S1 F2 P2": "c"},
        **{"S2 F1 P1": "c", "S2 F1 P2": "d", "S2 F2 P1": "d", "S2 F2 P2": "e"},
    }
    assert dict(ISO_13849.an_hour) == {"a": 1e-4, "b": 1e-5, "c": 3e-6, "d": 1e-6, "e": 1e-7}


def test_every_step_is_told_and_a_low_probability_asks_one_level_less_but_never_none() -> None:
    found = derived(ISO_13849, "S2", "F1", "P2", unlikely=True)
    assert (found.level, found.an_hour) == ("c", 3e-6)
    words = ("S2", "F1", "P2", "level d", "low", "level c")
    assert all(word in step for word, step in zip(words, found.steps, strict=True))
    assert derived(ISO_13849, "S1", "F1", "P1", unlikely=True).level == "a"


@pytest.mark.parametrize("way", PATHS)
def test_what_is_not_assessed_leads_nowhere(way: str) -> None:
    values = way.split()
    for place in range(3):
        one = [*values[:place], UNKNOWN, *values[place + 1 :]]
        found = derived(ISO_13849, *one, unlikely=False)
        assert (found.level, found.an_hour) == (None, None)
        assert "not assessed" in found.steps[-1]


def test_bands_are_told_by_their_size() -> None:
    assert [band_of(rate) for rate in (1e-9, 1e-8, 9.9e-8, 1e-7, 3e-6, 9e-5, 1e-4, 3.0)] == [
        "below all bands",
        *(f"of the size of band {level}" for level in "eedba"),
        *["above all bands"] * 2,
    ]
    ends = sorted(PFH_D.values())
    assert all(one[1] == other[0] for one, other in pairwise(ends)), "no gap between bands"


def test_a_plan_has_its_hazards_and_its_claims_stand_under_them(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, HAZARDOUS)
    (hazard,) = plan.risks.hazards
    assert (hazard.name, hazard.severity, hazard.derived(plan.risks.graph).level) == (
        "crushed hand",
        "S2",
        "d",
    )
    assert [(one.hazard, one.hazards) for one in plan.claims] == [
        ("crushed hand", ("crushed hand",)),
        ("", ()),
    ]
    assert plan_in(tmp_path, PLAN).risks.hazards == ()


def test_a_derived_target_is_the_levels_rate_over_the_most_approaches_an_hour(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, DERIVED)
    assert plan.claims[0].target == pytest.approx(1.0 / most_an_hour(37, 12.0, 0.025), rel=1e-12)
    twice = HAZARDS + HAZARDS.removeprefix("hazards:\n").replace("crushed hand", "other").replace("S2", "S1")
    both = DERIVED.replace(HAZARDS, twice).replace("[crushed hand]", "[other, crushed hand]")
    assert plan_in(tmp_path, both).claims[0].target == pytest.approx(
        1.0 / most_an_hour(37, 12.0, 0.0125), rel=1e-12
    ), "the least, and the error shared by two rates"


def fitted(count: object, hours: object) -> str:
    return json.dumps({"result": {"fit": {"approaches": count, "hours": hours, "recordings": [["a", "b"]]}}})


def test_recorded_hands_say_how_many_approaches_there_are_and_their_file_is_the_plans(tmp_path: Path) -> None:
    (tmp_path / "hands.json").write_text(fitted(6, 0.02))
    text = HAZARDOUS.replace("counted: 37, hours: 12, source: two shifts", "fitted: hands.json")
    plan = plan_in(tmp_path, text)
    found = plan.risks.hazards[0].approaches
    assert isinstance(found, CountedApproaches)
    assert (found.count, found.hours) == (6, 0.02)
    assert "hands.json" in [file.name for file in plan.files]
    before = plan.identity.sha256
    (tmp_path / "hands.json").write_text(fitted(7, 0.02))
    assert plan_in(tmp_path, text).identity.sha256 != before


APPROACHES = "approaches: {counted: 37, hours: 12, source: two shifts}"


@pytest.mark.parametrize(
    ("old", "new", "field", "expected"),
    [
        ("severity: S2", "severity: grave", "hazards[0].severity", "S1, S2 or not assessed"),
        ("exposure: F1", "exposure: F", "hazards[0].exposure", "F1, F2"),
        ("    avoidance: P2\n", "", "hazards[0].avoidance", "the key"),
        ("because: it is a test", 'because: " "', "hazards[0].because", "why"),
        ("[crushed hand]", "[crusht hand]", "claims[0].hazards[0]", "a hazard of this plan"),
        ("[crushed hand]", "[crushed hand, crushed hand]", "claims[0].hazards[1]", "once"),
        (
            "[crushed hand]",
            "[crushed hand]\n    hazard: words",
            "claims[0].hazard",
            "one of hazard and hazards",
        ),
        ("[crushed hand]", "[]", "claims[0].hazards", "a list of the plan's hazards"),
        (HAZARDS, HAZARDS + HAZARDS.removeprefix("hazards:\n"), "hazards[1].hazard", "one hazard only"),
        (HAZARDS, "", "risk graph", "hazards for the risk graph"),
        ("hours: 12", "hours: 0", "hazards[0].approaches.hours", "at least"),
        ("counted: 37", "counted: 3.5", "hazards[0].approaches.counted", "a whole number"),
        ("counted: 37, hours: 12", "hours: 12", "hazards[0].approaches", "counted"),
        (
            "counted: 37, hours: 12",
            "at most: 3, confidence: 97 %",
            "hazards[0].approaches.confidence",
            "97.5 %",
        ),
        (APPROACHES, "approaches: {fitted: none.json}", "hazards[0].approaches.fitted", "no such file"),
        (APPROACHES, "approaches: {fitted: short.yaml}", "", "JSON"),
        (APPROACHES, "approaches: {fitted: bad.json}", "hazards[0].approaches.fitted", "more than 0 hours"),
        (APPROACHES, "approaches: {fitted: empty.json}", "hazards[0].approaches.fitted", "no fit"),
        (f"    {APPROACHES}\n", "", "claims[0].violated in at most", "its approaches an hour"),
        ("severity: S2", "severity: not assessed", "claims[0].violated in at most", "severity, exposure"),
        ("    hazards: [crushed hand]\n", "", "claims[0].violated in at most", "under the key"),
        ("low: 5, ", "", "risk graph.levels.S1 F1 P1", "with a rate in"),
        ("S1 F1 P1: low, ", "", "risk graph.levels", "none for S1 F1 P1"),
        ("S1 F1 P1: low", "S1 F1 P3: low", "risk graph.levels.S1 F1 P3", "one of"),
        ("high: 1}", "high: 0}", "risk graph.an hour.high", "above 0"),
        ("  graph: our own\n", "", "risk graph.graph", "the key"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_place(
    tmp_path: Path, old: str, new: str, field: str, expected: str
) -> None:
    assert old in DERIVED
    (tmp_path / "bad.json").write_text(fitted(6, 0))
    (tmp_path / "empty.json").write_text("{}")
    (tmp_path / "short.yaml").write_text(TEXT)
    (tmp_path / "plan.yaml").write_text(DERIVED.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_plan(tmp_path / "plan.yaml")
    assert (caught.value.place.field or "") == field
    assert expected in str(caught.value)
