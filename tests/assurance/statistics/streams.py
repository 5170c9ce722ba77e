"""Samples for tests: made in the one way in which samples are made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safety_harness.extensions.assurance.statistics.sample import (
    Declaration,
    EpisodeOutcome,
    IndependentSample,
)


def declared(planned: int, **changes: Any) -> Declaration:
    hashes = {"plan_sha256": "0" * 64, "draws_sha256": "1" * 64}
    fields: dict[str, Any] = hashes | {"stratum": "seen", "seed": 1, "planned": planned}
    return Declaration(**(fields | changes))


def margins_of(outcomes: ArrayLike) -> np.ndarray:
    """Whatever suits them: one of 0.1 where they hold, of -0.1 where they are violated."""
    codes = np.asarray(outcomes)
    return np.select([codes == EpisodeOutcome.HOLDS, codes == EpisodeOutcome.VIOLATED], [0.1, -0.1], np.nan)


def told(outcomes: ArrayLike, *, seeds: ArrayLike | None = None) -> dict[str, np.ndarray]:
    """A seed for each, and an occasion for each that was tested."""
    codes = np.asarray(outcomes)
    roots = np.arange(codes.size).reshape(codes.shape) if seeds is None else np.asarray(seeds)
    return {"seeds": roots, "exercised": (codes != EpisodeOutcome.UNTESTED).astype(np.int64)}


def sample_of(
    outcomes: ArrayLike, margins: ArrayLike | None = None, seeds: ArrayLike | None = None, **changes: Any
) -> IndependentSample:
    codes = np.asarray(outcomes)
    signed = margins_of(codes) if margins is None else np.asarray(margins, float)
    declaration = declared(**({"planned": len(codes)} | changes))
    return IndependentSample.of_stream(
        declaration, np.arange(len(codes)), codes, signed, **told(codes, seeds=seeds), claim="a claim"
    )


def violations(count: int, trials: int, **changes: Any) -> IndependentSample:
    codes = np.where(np.arange(trials) < count, EpisodeOutcome.VIOLATED, EpisodeOutcome.HOLDS)
    return sample_of(codes, **changes)


def with_margins(margins: ArrayLike, **changes: Any) -> IndependentSample:
    signed = np.asarray(margins, float)
    return sample_of(np.where(signed < 0.0, EpisodeOutcome.VIOLATED, EpisodeOutcome.HOLDS), signed, **changes)
