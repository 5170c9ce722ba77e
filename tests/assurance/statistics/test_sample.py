"""Only a declared stream, all of it, becomes a sample."""

from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from streams import declared, margins_of, sample_of, told, violations

import safety_harness
from safety_harness.base.exceptions import InputError, StatisticsError
from safety_harness.extensions.assurance.statistics.binomial import bounds_of, violation_bounds
from safety_harness.extensions.assurance.statistics.sample import (
    Declaration,
    EpisodeOutcome,
    IndependentSample,
    fixed_length,
    independent,
)
from safety_harness.search.findings import Outcomes, TriedPoint

HOLDS, VIOLATED, UNTESTED, INCONCLUSIVE, FAILED = map(int, EpisodeOutcome)


def stream(declaration: Declaration, episodes: Any, outcomes: Any, **changes: Any) -> IndependentSample:
    """With margins, seeds and occasions that suit the outcomes, but for what is changed."""
    known = {"margins": margins_of(outcomes)} | told(outcomes) | changes
    return IndependentSample.of_stream(declaration, episodes, outcomes, **known)


def test_episodes_may_come_in_any_order_and_are_put_into_theirs() -> None:
    codes = [EpisodeOutcome.VIOLATED, EpisodeOutcome.HOLDS, EpisodeOutcome.FAILED]
    seeds = [5, 9, 7]
    found = stream(declared(3), [2, 0, 1], codes, margins=[-0.1, 0.2, np.nan], seeds=seeds)
    assert found.outcomes.tolist() == [EpisodeOutcome.HOLDS, EpisodeOutcome.FAILED, EpisodeOutcome.VIOLATED]
    np.testing.assert_array_equal(found.margins, [0.2, np.nan, -0.1])
    assert found.seeds.tolist() == [9, 7, 5]


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
        stream(declared(3), episodes, [0, 0, 0])


def test_an_incomplete_stream_is_refused_unless_stopping_early_was_declared() -> None:
    with pytest.raises(StatisticsError, match="incomplete") as raised:
        stream(declared(4), [0, 1, 2], [0, 0, 0])
    assert isinstance(raised.value, InputError)
    early = declared(4, stop_early=True)
    assert stream(early, [0, 1, 2], [0, 0, 0]).trials == 3
    with pytest.raises(StatisticsError, match="some are missing"):
        stream(early, [0, 1, 3], [0, 0, 0])


def test_more_than_was_declared_is_refused_and_so_is_nothing() -> None:
    with pytest.raises(StatisticsError, match="more were run than declared"):
        stream(declared(2), [0, 1, 2], [0, 0, 0])
    with pytest.raises(StatisticsError, match="at least one episode"):
        stream(declared(2, stop_early=True), [], np.zeros(0, np.int64))
    with pytest.raises(StatisticsError, match="at least one"):
        declared(0)


@pytest.mark.parametrize(
    ("code", "margin", "words"),
    [
        (EpisodeOutcome.HOLDS, -0.1, "which holds"),
        (EpisodeOutcome.VIOLATED, 0.1, "which violated"),
        (EpisodeOutcome.HOLDS, np.inf, "finite"),
        (EpisodeOutcome.HOLDS, np.nan, "got NaN for episode 1, which holds"),
        (EpisodeOutcome.VIOLATED, np.nan, "got NaN for episode 1, which violated"),
        (9, 0.1, "an outcome's number"),
    ],
)
def test_what_contradicts_itself_is_refused(code: int, margin: float, words: str) -> None:
    with pytest.raises(StatisticsError, match=words):
        sample_of([0, code], [0.1, margin])


def test_a_sample_is_made_by_its_stream_only_and_cannot_be_changed() -> None:
    sample = violations(1, 5)
    with pytest.raises(TypeError, match="of_stream"):
        IndependentSample(
            declaration=declared(2), outcomes=sample.outcomes, margins=sample.margins, seeds=sample.seeds
        )
    with pytest.raises(TypeError, match="of_stream"):
        dataclasses.replace(sample, outcomes=np.zeros(5, np.int64))
    with pytest.raises(ValueError, match="read-only"):
        sample.outcomes[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        sample.claim = "another"  # type: ignore[misc]


def test_the_callers_arrays_are_not_the_samples() -> None:
    codes, margins = np.zeros(3, np.int64), np.ones(3)
    seeds = np.arange(3)
    sample = stream(declared(3), np.arange(3), codes, margins=margins, seeds=seeds)
    codes[0], margins[0], seeds[0] = EpisodeOutcome.VIOLATED, -1.0, 99
    assert (sample.violations, sample.margins[0], sample.seeds[0]) == (0, 1.0, 0)


def test_a_hundred_runs_pasted_thirty_times_are_not_three_thousand() -> None:
    """Renumbered, so that the seeds alone give them away."""
    codes, seeds = np.zeros(3000, np.int64), np.tile(np.arange(100), 30)
    with pytest.raises(StatisticsError, match="seeds: expected a seed of its own") as refused:
        stream(declared(3000), np.arange(3000), codes, seeds=seeds)
    assert refused.value.got == "2900 of 3000 runs with another's, such as 0 in episodes 0 and 100"
    assert stream(declared(3000), np.arange(3000), codes, seeds=np.arange(3000)).trials == 3000


def test_a_run_that_was_exercised_cannot_be_called_untested() -> None:
    """It would be no trial: what an upper bound counts as a violation would vanish."""
    honest = stream(declared(3), [0, 1, 2], [HOLDS, INCONCLUSIVE, UNTESTED], exercised=[4, 2, 0])
    assert (honest.trials, honest.at_worst) == (2, 1)
    with pytest.raises(StatisticsError, match="exercised") as refused:
        stream(declared(3), [0, 1, 2], [HOLDS, UNTESTED, UNTESTED], exercised=[4, 2, 0])
    assert refused.value.got == "2 in episode 1, untested"
    assert "it is inconclusive" in refused.value.expected


def test_what_had_no_occasion_cannot_be_said_to_hold() -> None:
    with pytest.raises(StatisticsError, match="exercised") as refused:
        stream(declared(2), [0, 1], [HOLDS, HOLDS], exercised=[1, 0])
    assert refused.value.got == "0 in episode 1, holds"
    with pytest.raises(StatisticsError, match="numbers of occasions"):
        stream(declared(2), [0, 1], [HOLDS, VIOLATED], exercised=[1, -1])


@pytest.mark.parametrize("field", ["plan_sha256", "draws_sha256"])
@pytest.mark.parametrize("text", ["", "abc", "0" * 63 + "g", "A" * 64, "0" * 65])
def test_a_declaration_stands_for_something_by_its_hash(field: str, text: str) -> None:
    with pytest.raises(StatisticsError, match="a SHA-256") as refused:
        declared(3, **{field: text})
    assert refused.value.place.field == field
    assert refused.value.got == repr(text)


@pytest.mark.parametrize(
    ("column", "values"),
    [("seeds", [1, 2]), ("exercised", [1]), ("margins", [0.1] * 4), ("seeds", [[1, 2, 3]])],
)
def test_an_outcome_without_its_episode_seed_or_margin_is_refused(column: str, values: Any) -> None:
    with pytest.raises(StatisticsError, match=r"as many episodes as outcomes|whole numbers"):
        stream(declared(3), [0, 1, 2], [HOLDS] * 3, **{column: values})


def test_seeds_and_occasions_are_whole_numbers() -> None:
    for column in ("seeds", "exercised"):
        with pytest.raises(StatisticsError, match=f"{column}: expected whole numbers"):
            stream(declared(2), [0, 1], [HOLDS] * 2, **{column: [0.5, 1.5]})


def searched() -> list[object]:
    margins = np.array([[-0.1], [0.2]])
    return [Outcomes.of_margins(margins), TriedPoint(0, np.zeros(3), margins[0]), [margins], margins]


@pytest.mark.parametrize("chosen", [*searched(), SimpleNamespace(trials=3, violations=0)])
def test_what_a_search_chose_is_refused_at_run_time(chosen: Any) -> None:
    for estimator in (independent, fixed_length, lambda sample: violation_bounds(sample, 0.95)):
        with pytest.raises(TypeError, match="declared stream of independent episodes"):
            estimator(chosen)
    with pytest.raises(TypeError, match="declared stream"):
        bounds_of([violations(0, 3), chosen], 0.95)


SNIPPET = """
from safety_harness.search.findings import Findings, TriedPoint
from safety_harness.search.findings import Outcomes
from safety_harness.extensions.assurance.statistics.binomial import violation_bounds
from safety_harness.extensions.assurance.statistics.sample import IndependentSample

def estimate(sample: IndependentSample, a: Outcomes, b: Findings, c: TriedPoint) -> None:
    violation_bounds(sample, 0.95)
    violation_bounds(a, 0.95)
    violation_bounds(b, 0.95)
    violation_bounds(c, 0.95)
"""


def test_what_a_search_chose_does_not_type_check(tmp_path: Path) -> None:
    """The snippet and the modules that define its classes, and what else these import taken for ``Any``.

    That makes three errors no likelier, and needs neither numpy's types nor a cache that others may write.
    """
    snippet = tmp_path / "snippet.py"
    snippet.write_text(SNIPPET)
    defined_in = {inspect.getfile(one) for one in (Outcomes, IndependentSample, violation_bounds)}
    alone = ["--config-file=", "--cache-dir=/dev/null", "--follow-imports=skip", "--no-site-packages"]
    command = [sys.executable, "-m", "mypy", *alone, str(snippet), *sorted(defined_in)]
    root = Path(safety_harness.__file__).parents[1]
    out = subprocess.run(command, capture_output=True, text=True, cwd=root, check=False).stdout
    found = [line.removeprefix(f"{snippet}:") for line in out.splitlines() if str(snippet) in line]
    assert [line.split(":")[0] for line in found] == ["9", "10", "11"], out
    assert all("[arg-type]" in line for line in found), out
