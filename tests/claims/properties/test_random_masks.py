"""Whatever nobody measured of a run: a verdict stays that of the whole run, or becomes inconclusive."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from examples import shipped

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_kinematic
from safety_harness.claims.properties.base import Evaluation, Property
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.measured import columns_read_by
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    OF_DECISIONS,
    PER_HAND,
    Gap,
    Measurement,
    Source,
)
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

EVERY = tuple(Claim(sentence=entry.example, expected=Verdict.HOLDS) for entry in CATALOGUE)
SEED, MASKS, BATCHES, QUICK = 20261123, 1_000, 13, 1  # each batch has masks of all shipped runs


@cache
def judged(name: str) -> tuple[Trace, list[tuple[Property, Evaluation]]]:
    """A shipped run, and what its own claims and those of the catalogue say of it whole."""
    trace = run_kinematic(admit(shipped()[name]))
    claims = {claim.sentence: claim for claim in (*EVERY, *trace.scenario.claims)}
    props = [property_of(claim, trace.scenario) for claim in claims.values()]
    return trace, [(prop, prop.evaluate(trace)) for prop in props if columns_read_by(prop) is not None]


def measurement(trace: Trace, column: str, rng: np.random.Generator) -> Measurement:
    """Nothing of a column, or all but one or two gaps, some of them of one hand."""
    if column.startswith(OF_DECISIONS) or rng.random() < 0.4:
        return NOT_MEASURED
    hands, gaps = len(trace.scenario.hands), []
    for _ in range(rng.integers(1, 3)):
        first = int(rng.integers(0, len(trace.ticks))) if rng.random() < 0.7 else 0
        hand = int(rng.integers(hands)) if hands and column in PER_HAND and rng.random() < 0.5 else None
        gaps.append(Gap(first=first, after=int(rng.integers(first, len(trace.ticks))) + 1, hand=hand))
    return Measurement(source=Source.LOG, gaps=tuple(gaps))


def masked(trace: Trace, rng: np.random.Generator) -> Trace:
    """Of most masks a few columns, of some many."""
    columns = rng.choice(COLUMNS_OF_A_TRACE, size=rng.choice([1, 2, 3, 5, 15]), replace=False)
    return knowing(trace, {str(name): measurement(trace, str(name), rng) for name in columns})


@pytest.mark.parametrize(
    "batch", [*range(QUICK), *(pytest.param(one, marks=pytest.mark.long) for one in range(QUICK, BATCHES))]
)
def test_no_mask_changes_a_verdict_but_to_inconclusive(batch: int) -> None:
    in_kinematic = [name for name in shipped() if name != "rendered-images"]
    for number in range(batch, MASKS, BATCHES):
        rng = np.random.default_rng([SEED, number])
        trace, evaluations = judged(in_kinematic[number % len(in_kinematic)])
        partly = masked(trace, rng)
        for prop, whole in evaluations:
            found = prop.evaluate(partly)
            what = (number, trace.scenario.name, partly.known, whole, found)
            if not any(partly.known.column(column).limited for column in columns_read_by(prop) or ()):
                assert replace(found, reason="") == replace(whole, reason=""), what
            elif found.verdict is not whole.verdict:
                assert found.verdict is Verdict.INCONCLUSIVE, what
                assert found.unmeasured, what
