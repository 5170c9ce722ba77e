"""Only a declared stream, all of it, becomes a sample."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from streams import declared, sample_of, violations

import safety_harness
from safety_harness.exceptions import InputError, StatisticsError
from safety_harness.search.findings import Episode
from safety_harness.search.outcomes import Outcomes
from safety_harness.statistics.binomial import bounds_of, violation_bounds
from safety_harness.statistics.sample import IndependentSample, Outcome, fixed_length, independent

NONE = np.full(3, np.nan)


def test_episodes_may_come_in_any_order_and_are_put_into_theirs() -> None:
    codes = [Outcome.VIOLATED, Outcome.HOLDS, Outcome.FAILED]
    found = IndependentSample.of_stream(declared(3), [2, 0, 1], codes, [-0.1, 0.2, np.nan])
    assert found.outcomes.tolist() == [Outcome.HOLDS, Outcome.FAILED, Outcome.VIOLATED]
    np.testing.assert_array_equal(found.margins, [0.2, np.nan, -0.1])


@pytest.mark.parametrize(
    ("episodes", "words"),
    [
        ([0, 1, 1], "once; got 1 more than once"),
        ([0, 1, 3], "some are missing"),
        ([1, 2, 3], "some are missing"),
        ([-1, 0, 1], "some are missing"),
        ([0.0, 1.0, 2.0], "whole numbers"),
        ([[0, 1, 2]], "whole numbers"),
        ([0, 1], "as many episodes as outcomes"),
    ],
)
def test_episodes_that_are_not_the_stream_are_refused(episodes: Any, words: str) -> None:
    with pytest.raises(StatisticsError, match=words):
        IndependentSample.of_stream(declared(3), episodes, [0, 0, 0], NONE)


def test_an_incomplete_stream_is_refused_unless_stopping_early_was_declared() -> None:
    with pytest.raises(StatisticsError, match="incomplete") as raised:
        IndependentSample.of_stream(declared(4), [0, 1, 2], [0, 0, 0], NONE)
    assert isinstance(raised.value, InputError)
    early = declared(4, stop_early=True)
    assert IndependentSample.of_stream(early, [0, 1, 2], [0, 0, 0], NONE).trials == 3
    with pytest.raises(StatisticsError, match="some are missing"):
        IndependentSample.of_stream(early, [0, 1, 3], [0, 0, 0], NONE)


def test_more_than_was_declared_is_refused_and_so_is_nothing() -> None:
    with pytest.raises(StatisticsError, match="more were run than declared"):
        IndependentSample.of_stream(declared(2), [0, 1, 2], [0, 0, 0], NONE)
    with pytest.raises(StatisticsError, match="at least one episode"):
        IndependentSample.of_stream(declared(2, stop_early=True), [], [], [])
    with pytest.raises(StatisticsError, match="at least one"):
        declared(0)


@pytest.mark.parametrize(
    ("code", "margin", "words"),
    [
        (Outcome.HOLDS, -0.1, "which holds"),
        (Outcome.VIOLATED, 0.1, "which violated"),
        (Outcome.HOLDS, np.inf, "finite"),
        (9, 0.1, "an outcome's number"),
    ],
)
def test_what_contradicts_itself_is_refused(code: int, margin: float, words: str) -> None:
    with pytest.raises(StatisticsError, match=words):
        sample_of([0, code], [0.1, margin])


def test_a_sample_is_made_by_its_stream_only_and_cannot_be_changed() -> None:
    sample = violations(1, 5)
    with pytest.raises(TypeError, match="of_stream"):
        IndependentSample(declaration=declared(2), outcomes=np.zeros(2, np.int64), margins=np.zeros(2))
    with pytest.raises(TypeError, match="of_stream"):
        dataclasses.replace(sample, outcomes=np.zeros(5, np.int64))
    with pytest.raises(ValueError, match="read-only"):
        sample.outcomes[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        sample.claim = "another"  # type: ignore[misc]


def test_the_callers_arrays_are_not_the_samples() -> None:
    codes, margins = np.zeros(3, np.int64), np.ones(3)
    sample = IndependentSample.of_stream(declared(3), np.arange(3), codes, margins)
    codes[0], margins[0] = Outcome.VIOLATED, -1.0
    assert (sample.violations, sample.margins[0]) == (0, 1.0)


def searched() -> list[object]:
    margins = np.array([[-0.1], [0.2]])
    return [Outcomes.of_margins(margins), Episode(0, np.zeros(3), margins[0]), [margins], margins]


@pytest.mark.parametrize("chosen", [*searched(), SimpleNamespace(trials=3, violations=0)])
def test_what_a_search_chose_is_refused_at_run_time(chosen: Any) -> None:
    for estimator in (independent, fixed_length, lambda sample: violation_bounds(sample, 0.95)):
        with pytest.raises(TypeError, match="declared stream of independent episodes"):
            estimator(chosen)
    with pytest.raises(TypeError, match="declared stream"):
        bounds_of([violations(0, 3), chosen], 0.95)


SNIPPET = """
from safety_harness.search.findings import Episode, Findings
from safety_harness.search.outcomes import Outcomes
from safety_harness.statistics.binomial import violation_bounds
from safety_harness.statistics.sample import IndependentSample

def estimate(sample: IndependentSample, a: Outcomes, b: Findings, c: Episode) -> None:
    violation_bounds(sample, 0.95)
    violation_bounds(a, 0.95)
    violation_bounds(b, 0.95)
    violation_bounds(c, 0.95)
"""


def test_what_a_search_chose_does_not_type_check(tmp_path: Path) -> None:
    (tmp_path / "snippet.py").write_text(SNIPPET)
    root = Path(safety_harness.__file__).parents[1]
    config = ["--config-file", str(root / "pyproject.toml"), "--cache-dir", str(root / ".mypy_cache")]
    command = [sys.executable, "-m", "mypy", *config, str(tmp_path / "snippet.py")]
    out = subprocess.run(command, capture_output=True, text=True, cwd=root, check=False).stdout
    refused = [line for line in out.splitlines() if "[arg-type]" in line]
    assert [line.split(":")[1] for line in refused] == ["9", "10", "11"], out
    assert "Found 3 errors" in out
