"""The nearest points of two segments are where the exact distance is taken."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.base.geometry.segments import nearest_of_segments, segment_segment_distance


def between(ends: np.ndarray, shares: tuple[float, float]) -> float:
    s, t = shares
    a, b = ends[0] + s * (ends[1] - ends[0]), ends[2] + t * (ends[3] - ends[2])
    return float(np.linalg.norm(a - b))


@pytest.mark.parametrize("kind", ["any", "parallel", "crossing", "point", "points"])
def test_the_points_found_are_as_far_apart_as_the_segments(kind: str) -> None:
    rng = np.random.default_rng(7)
    for _ in range(300):
        ends = rng.normal(size=(4, 3))
        if kind == "parallel":
            ends[3] = ends[2] + rng.normal() * (ends[1] - ends[0])
        elif kind == "crossing":
            ends[2:] = 0.5 * (ends[0] + ends[1]) + np.outer([-1.0, 1.0], rng.normal(size=3))
        elif kind in ("point", "points"):
            ends[1] = ends[0]
            ends[3] = ends[2] if kind == "points" else ends[3]
        *_, s, t = nearest_of_segments(*ends)
        shares = (s, t)
        assert min(shares) >= 0.0
        assert max(shares) <= 1.0
        assert between(ends, shares) == pytest.approx(segment_segment_distance(*ends), abs=1e-12)


@pytest.mark.parametrize("which", range(4))
def test_a_nan_comes_out(which: int) -> None:
    ends = np.random.default_rng(1).normal(size=(4, 3))
    ends[which, 1] = np.nan
    assert np.isnan(nearest_of_segments(*ends)).all()
