"""Samples for tests: made in the one way in which samples are made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safety_harness.statistics.sample import Declaration, IndependentSample, Outcome


def declared(planned: int, **changes: Any) -> Declaration:
    fields: dict[str, Any] = {"plan_sha256": "0" * 64, "stratum": "seen", "seed": 1, "planned": planned}
    return Declaration(**(fields | changes))


def sample_of(outcomes: ArrayLike, margins: ArrayLike | None = None, **changes: Any) -> IndependentSample:
    codes = np.asarray(outcomes)
    signed = np.full(len(codes), np.nan) if margins is None else np.asarray(margins, float)
    declaration = declared(**({"planned": len(codes)} | changes))
    return IndependentSample.of_stream(declaration, np.arange(len(codes)), codes, signed, claim="a claim")


def violations(count: int, trials: int, **changes: Any) -> IndependentSample:
    codes = np.where(np.arange(trials) < count, Outcome.VIOLATED, Outcome.HOLDS)
    return sample_of(codes, **changes)


def with_margins(margins: ArrayLike, **changes: Any) -> IndependentSample:
    signed = np.asarray(margins, float)
    return sample_of(np.where(signed < 0.0, Outcome.VIOLATED, Outcome.HOLDS), signed, **changes)
