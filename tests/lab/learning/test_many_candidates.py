"""Many sets of candidates at once are the sets that are drawn one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.extensions.lab.learning.many_candidates import draw_many

CAP = CandidateCap.from_settings(DEFAULTS)


def drawn(cap: CandidateCap, seed: int) -> np.ndarray:
    return cap.draw(np.random.default_rng(seed))


@pytest.mark.parametrize("cone_deg", [5.0, 60.0, 170.0])
def test_many_sets_at_once_are_the_sets_drawn_one_by_one(cone_deg: float) -> None:
    """A narrow cone leaves most sets short after the first draw, so that the refill is compared too."""
    cap = CandidateCap.from_settings(
        replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, candidate_cone_rad=np.radians(cone_deg)))
    )
    many = draw_many(cap, [np.random.default_rng(seed) for seed in range(20)])
    assert many == pytest.approx(np.array([drawn(cap, seed) for seed in range(20)]), abs=1e-15)


def test_one_generator_may_serve_many_sets() -> None:
    rng = np.random.default_rng(3)
    first, second = draw_many(CAP, [rng, rng])
    assert not np.isin(first, second).any()
    assert first == pytest.approx(drawn(CAP, 3), abs=1e-15)
