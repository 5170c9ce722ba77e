"""Every claim declares all columns that it reads, and says nothing of a run in which one was not measured."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from test_catalogue import IDS, claim, shipped

from safety_harness.admission.claims import property_of
from safety_harness.properties.base import Evaluation, Property, unreadable
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.measured import columns_read_by
from safety_harness.scenario.model import Verdict
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    OF_DECISIONS,
    PRESENCE,
    knowing,
)
from safety_harness.trace.trace import Trace

SEED = 20261123


@cache
def case(entry: CatalogueEntry) -> tuple[Property, Trace, Evaluation]:
    trace = shipped(entry.scenario)
    prop = property_of(claim(entry), trace.scenario)
    return prop, trace, prop.evaluate(trace)


def of_garbage(trace: Trace, column: str, seed: int) -> Trace:
    """``column`` was not measured, and holds anything instead of blanks."""
    rng = np.random.default_rng([SEED, seed])
    unknown = knowing(trace, {column: NOT_MEASURED})
    records = unknown.decisions if column.startswith(OF_DECISIONS) else unknown.ticks
    records.setflags(write=True)
    values = records[column.removeprefix(OF_DECISIONS)]
    if values.dtype.kind == "f":
        values[...] = rng.choice([rng.normal(scale=3.0, size=values.shape), np.full(values.shape, np.inf)])
    elif values.dtype.kind == "U":
        values[...] = "anything"
    else:
        values[...] = rng.integers(0, 2 if values.dtype.kind == "b" else 5, values.shape)
    records.setflags(write=False)
    return unknown


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_what_a_claim_does_not_declare_may_hold_anything(entry: CatalogueEntry) -> None:
    prop, trace, whole = case(entry)
    reads = columns_read_by(prop)
    assert reads is not None
    changed = [
        column
        for column in COLUMNS_OF_A_TRACE
        if column not in reads
        for seed in range(2)
        if prop.evaluate(of_garbage(trace, column, seed)) != whole
    ]
    assert not changed, changed


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_what_a_claim_declares_and_nobody_measured_makes_it_inconclusive(entry: CatalogueEntry) -> None:
    prop, trace, whole = case(entry)
    for column in columns_read_by(prop) or ():
        found = prop.evaluate(knowing(trace, {column: NOT_MEASURED}))
        if column == PRESENCE and whole.verdict is found.verdict is Verdict.VIOLATED:
            continue  # by the hands that were measured
        assert found.verdict is Verdict.INCONCLUSIVE, column
        assert found.unmeasured == (column,), column
        assert found.reason.startswith("not measured: "), column


class Watched(np.ndarray):
    """Records that know which of their fields were asked for."""

    asked: set[str]

    def __array_finalize__(self, other: Any) -> None:
        self.asked = getattr(other, "asked", set())

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            self.asked.add(key)
        found = super().__getitem__(key)
        return found.view(np.ndarray) if isinstance(key, str) else found


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_a_claim_touches_no_column_that_it_does_not_declare(entry: CatalogueEntry) -> None:
    prop, trace, whole = case(entry)
    watched = replace(trace, ticks=trace.ticks.view(Watched), decisions=trace.decisions.view(Watched))
    assert unreadable(watched, ()) is None  # which looks at everything, and is not asked again
    watched.ticks.asked.clear(), watched.decisions.asked.clear()
    assert prop.evaluate(watched) == whole
    asked = watched.ticks.asked | {f"{OF_DECISIONS}{name}" for name in watched.decisions.asked}
    assert asked - {"time_s"} <= set(columns_read_by(prop) or ())
