"""What every claim says of every trace has all its parts, and they agree with each other."""

from __future__ import annotations

import numpy as np
import pytest
from test_catalogue import IDS, claim, shipped
from test_no_evidence import truncated

from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry, count, quantity
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.units import LENGTH
from safety_harness.trace.trace import Trace


def whole(evaluation: Evaluation, trace: Trace) -> None:
    """Nothing is left out, and the verdict is that of the margin."""
    end_s = float(trace.time_s[-1]) if len(trace.ticks) else 0.0
    assert isinstance(evaluation.reason, str)
    assert evaluation.reason
    assert type(evaluation.exercised) is int
    assert 0 <= evaluation.exercised <= max(2 * len(trace.ticks), 1)
    assert (evaluation.margin is None) == (evaluation.worst_time_s is None)
    if evaluation.margin is not None:
        assert evaluation.worst_time_s is not None
        assert np.isfinite(evaluation.margin)
        assert 0.0 <= evaluation.worst_time_s <= end_s
    if evaluation.verdict is not Verdict.INCONCLUSIVE:
        assert evaluation.margin is not None
        assert (evaluation.margin < 0.0) == (evaluation.verdict is Verdict.VIOLATED)
        assert evaluation.exercised > 0
    for part in evaluation.parts:
        assert part.sentence
        whole(part, trace)


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_its_evaluation_is_whole_whatever_the_trace(entry: CatalogueEntry) -> None:
    own = shipped(entry.scenario)
    for trace in (own, shipped("servoing-alone"), *(truncated(own, n) for n in (0, 1, 3, 200))):
        prop = property_of(claim(entry), trace.scenario)
        evaluation = prop.evaluate(trace)
        assert evaluation.sentence == prop.sentence
        assert evaluation.unit is prop.unit
        whole(evaluation, trace)


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_it_is_understood_in_capitals_and_no_half_of_it_is(entry: CatalogueEntry) -> None:
    assert entry.understands(f"  {entry.example.upper()} ")
    assert not entry.understands(entry.example[: len(entry.example) // 2])
    assert not entry.understands(f"never {entry.example}")


def test_no_two_entries_have_one_sentence() -> None:
    assert len(set(IDS)) == len(CATALOGUE)


def test_a_limit_or_number_that_is_none_is_refused_where_it_stands() -> None:
    place = Place(field="claims[0]")
    for text in ("0 mm", "-1 mm", "11 m"):
        with pytest.raises(InadmissibleError, match="above zero and at most 10 m; got") as caught:
            quantity(text, LENGTH, place)
        assert caught.value.place == place
    assert quantity("10 m", LENGTH, place) == 10.0
    for text in ("0", "1000001", "9999999999", "-1", "1.5", "\u0661", "", "1_0"):
        with pytest.raises(InadmissibleError, match="a whole number from 1 to 1000000; got") as caught:
            count(text, place)
        assert caught.value.place == place
    assert [count(text, place) for text in ("1", "1000000")] == [1, 1_000_000]
