"""Small regions, and a plan of proofs in a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cell.avoidance.random_models import SEEN
from numpy.typing import NDArray

from safety_harness.extensions.lab.proof.plan import ProofRegion, seen_region

SEEN_REGION = seen_region(SEEN)
PLAN = """\
proof: steps of the student
avoider: student
regions:
  corner:
    hand: {from: [600 mm, -500 mm, -200 mm], to: [700 mm, -400 mm, -100 mm]}
    tcp: {from: [650 mm, -140 mm, 260 mm], to: [700 mm, -90 mm, 300 mm]}
claims:
  - claim: steps at most 150 mm
  - claim: within 40 mm of the optimum
    in: corner
"""


def plan_file(folder: Path, text: str = PLAN) -> Path:
    path = folder / "proofs.yaml"
    path.write_text(text)
    return path


def random_boxes(
    region: ProofRegion, count: int, size: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (count, 6) of boxes within a region, their sides up to ``size`` of its own."""
    rng = np.random.default_rng(seed)
    low, high = region.corners()
    sides = (high - low) * size * rng.random((count, 6))
    start = low + (high - low - sides) * rng.random((count, 6))
    return start, start + sides
