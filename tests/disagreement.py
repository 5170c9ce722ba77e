"""The largest disagreement with each independent oracle, noted where a test compares with it.

``make oracles`` runs those tests with ``--oracles plans/oracles.json`` and writes what was seen.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike


@dataclass
class Seen:
    """What was compared with an oracle so far."""

    unit: str
    largest: float = 0.0
    numbers: int = 0


SEEN: dict[tuple[str, str], Seen] = {}


def noted(
    oracle: str, what: str, unit: str, ours: ArrayLike, theirs: ArrayLike, per_unit: float = 1.0
) -> None:
    """Keep the largest absolute difference of two arrays, times ``per_unit``; one of NaN is endless."""
    first, second = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    both_nan = np.isnan(first) & np.isnan(second)
    difference = np.where((first == second) | both_nan, 0.0, np.abs(first - second))
    largest = float(np.max(np.nan_to_num(difference, nan=np.inf), initial=0.0)) * per_unit
    seen = SEEN.setdefault((oracle, what), Seen(unit))
    seen.largest = max(seen.largest, largest)
    seen.numbers += difference.size


def write(path: Path) -> None:
    """All of it, in alphabetical order."""
    rows = [
        {"oracle": oracle, "what": what, "unit": seen.unit, "largest": seen.largest, "numbers": seen.numbers}
        for (oracle, what), seen in sorted(SEEN.items())
    ]
    path.write_text(json.dumps(rows, indent=1) + "\n")
