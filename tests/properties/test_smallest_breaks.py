"""The smallest breaks of the page are those that the claims catch today, measured again for a few."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from smallest_breaks import RESULTS, breaks, measured

TRIED = ("onset, late beyond 2", "direction, off", "end, sideways", "a resting hand, beyond the limit")


@pytest.mark.parametrize("what", TRIED)
def test_the_sweep_finds_the_break_that_the_page_states(what: str) -> None:
    """The bisection is repeated; another family of processors may round the last digit otherwise."""
    (stated,) = (one for one in json.loads(RESULTS.read_text("utf-8")) if one["what"] == what)
    (found,) = measured([one for one in breaks() if one.what == what])
    assert {**found, "smallest": None} == {**stated, "smallest": None}
    assert found["smallest"] == pytest.approx(stated["smallest"], rel=0.05)


def test_the_page_states_the_resolution_of_the_fallback_that_was_aimed_at() -> None:
    """One degree, 2 mm at the end, one cycle, and a fifth of the speed are caught."""
    least = {one["what"]: one["smallest"] for one in json.loads(RESULTS.read_text("utf-8"))}
    assert least["direction, off"] <= 1.0
    assert least["end, sideways"] <= 2.0
    assert least["onset, late beyond 2"] == 1.0
    assert least["speed, lost"] <= 20.0
