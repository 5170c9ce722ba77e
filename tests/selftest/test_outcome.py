"""What is counted, printed and written of a self-test."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from made_up_faults import (
    CAUGHT,
    EVERY_KIND,
    LIMIT,
    LOUD,
    QUIET,
    SURVIVES,
    TRUE,
    UNTOUCHED,
    WRONGED,
    about,
    looked_at,
    outcome,
    rung,
)

from safety_harness.base.exceptions import ScenarioError
from safety_harness.extensions.assurance.certification.tools import FaultState
from safety_harness.extensions.selftest.document import document, render, write_document
from safety_harness.extensions.selftest.outcome import (
    HARMLESS_HEAD,
    HEAD,
    FaultOutcome,
    bad,
    harmless_row,
    in_table,
    markdown,
    row,
    summary,
    tally_of,
)
from safety_harness.extensions.selftest.suite import NIGHTLY, QUICK, profile_named


@pytest.mark.parametrize(
    ("one", "state"),
    [
        (CAUGHT, FaultState.CAUGHT),
        (SURVIVES, FaultState.SURVIVES),
        (LIMIT, FaultState.LIMIT),
        (UNTOUCHED, FaultState.UNTOUCHED),
        (QUIET, FaultState.QUIET),
        (LOUD, FaultState.FALSE_ALARM),
        (WRONGED, FaultState.TRUE_ALARM),
        (
            outcome("true and false", rung(1.0, TRUE, caught=True), harmless="it is so"),
            FaultState.FALSE_ALARM,
        ),
        (
            outcome("contradicted", looked_at(rung(1.0), "a visit"), harmless="it is so"),
            FaultState.FALSE_ALARM,
        ),
        (outcome("both", looked_at(rung(1.0, TRUE), "a visit"), harmless="it is so"), FaultState.FALSE_ALARM),
        (outcome("caught below only", rung(9.0, caught=False)), FaultState.SURVIVES),
    ],
)
def test_the_state_is_that_of_the_gravest_magnitude(one: FaultOutcome, state: FaultState) -> None:
    assert one.state is state


def test_the_slightest_caught_and_the_first_survivor() -> None:
    assert CAUGHT.smallest is not None
    assert CAUGHT.smallest.words == "5 mm"
    assert CAUGHT.survivor is not None
    assert CAUGHT.survivor.words == "2 mm"
    assert CAUGHT.confirmed is True
    assert SURVIVES.smallest is None
    assert SURVIVES.confirmed is None


def test_counting() -> None:
    tally = tally_of(EVERY_KIND)
    assert (tally.faults, tally.caught, tally.survivors, tally.limits) == (3, 1, 1, 1)
    assert (tally.rungs, tally.rungs_caught) == (5, 2)
    assert (tally.harmless, tally.false_alarms, tally.true_alarms) == (3, 1, 1)
    assert (tally.geometry_runs, tally.geometry_contradicted) == (9, 0)
    assert tally.kill_rate == pytest.approx(1 / 3)
    assert tally_of(()).kill_rate == 0.0
    words = summary(tally)
    assert "1 of 3 faults caught (33%)" in words
    assert "1 false alarm on 3 harmless changes, 1 true alarm" in words
    assert "PyBullet's geometry contradicts none of 9 hand distances" in words


def test_what_geometry_says_of_a_harmless_change_is_in_its_row() -> None:
    assert harmless_row(QUIET)[-1] == "kept in 1 of 3, broken in 2"
    contradicted = outcome("contradicted", looked_at(rung(1.0), "a visit", "another"), harmless="it is so")
    assert harmless_row(contradicted)[-1].endswith("to the contrary in a visit, another")
    assert harmless_row(outcome("not asked", rung(1.0), harmless="it is so"))[-1] == "-"
    assert "which is true" in harmless_row(WRONGED)[-2]
    assert "which is true" not in harmless_row(LOUD)[-2]


def test_what_speaks_against_the_harness() -> None:
    assert bad(EVERY_KIND) == [SURVIVES, LOUD]


def test_the_table_has_a_cell_for_every_heading() -> None:
    faults, harmless = in_table(EVERY_KIND)
    assert all(len(row(one)) == len(HEAD) for one in faults)
    assert all(len(harmless_row(one)) == len(HARMLESS_HEAD) for one in harmless)
    assert row(faults[0])[-1] == "PyBullet too"
    assert "nobody looks there" in row(faults[2])[2]
    assert markdown(("a",), [("x|y",)]) == ["| a |", "|---|", "| x\\|y |"]


def test_the_json_has_it_all_and_can_be_read(tmp_path: Path) -> None:
    write_document(tmp_path / "deep" / "selftest.json", EVERY_KIND, about())
    found = json.loads((tmp_path / "deep" / "selftest.json").read_text("utf-8"))
    assert found == json.loads(json.dumps(document(EVERY_KIND, about())))
    assert found["format"] == "safety-harness selftest 1"
    assert found["tally"]["kill_rate"] == pytest.approx(1 / 3)
    first, second = found["faults"][:2]
    assert first["slightest_caught"] == "5 mm"
    assert first["confirmed_in"] == ["PyBullet"]
    assert second["state"] == "survives"
    assert second["rungs"][0]["magnitude"] is None


def test_the_page_says_it_escaped_and_needs_nothing_else() -> None:
    page = render(EVERY_KIND, about(interrupted=True))
    assert "7 of 8 are done" in page
    assert "<b>made up</b>" not in page
    for one in EVERY_KIND:
        assert one.fault in page
    assert not re.search(r"(src|href)=\"(?!#|data:)", page)
    assert page == render(EVERY_KIND, about(interrupted=True))
    assert "Interrupted." not in render(EVERY_KIND, about())


def test_profiles_have_names() -> None:
    assert profile_named("quick") is QUICK
    assert profile_named("nightly") is NIGHTLY
    with pytest.raises(ScenarioError, match="quick or nightly"):
        profile_named("weekly")
