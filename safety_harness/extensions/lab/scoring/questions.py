"""Store many questions to an avoider, and its answers, as arrays with one row per question."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.cell.avoidance.asking import Question

Rows = NDArray[np.int64] | NDArray[np.bool_] | slice


@dataclass(frozen=True, eq=False)
class Questions:
    """Questions to an avoider: hands and TCPs in the base frame, shape (n, 3) [m], and seeds, shape (n,)."""

    hands_in_base_m: ArrayNx3
    tcps_in_base_m: ArrayNx3
    seeds: NDArray[np.uint64]

    def __len__(self) -> int:
        """Return the number of questions."""
        return len(self.seeds)

    def __getitem__(self, rows: Rows) -> Questions:
        """Return the questions in ``rows``."""
        return Questions(self.hands_in_base_m[rows], self.tcps_in_base_m[rows], self.seeds[rows])

    def single(self, row: int) -> Question:
        """Return the question in ``row`` as an object that can be passed to an avoider."""
        return Question(self.hands_in_base_m[row], self.tcps_in_base_m[row], int(self.seeds[row]))

    @classmethod
    def joined(cls, parts: list[Questions]) -> Questions:
        """Return the concatenated questions of all ``parts``."""
        return cls(
            np.concatenate([np.empty((0, 3)), *(part.hands_in_base_m for part in parts)]),
            np.concatenate([np.empty((0, 3)), *(part.tcps_in_base_m for part in parts)]),
            np.concatenate([np.empty(0, np.uint64), *(part.seeds for part in parts)]),
        )


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of an avoider: proposed positions in the base frame and spreads, shape (n, 3) each [m].

    The values of a missing answer are NaN.

    ``thresholds_m`` contains the avoider's threshold of the spread for each answer, or NaN without a
    threshold, shape (n,).  ``faults`` maps the row of a missing answer to the reason.
    """

    positions_in_base_m: ArrayNx3
    spreads_m: ArrayNx3
    thresholds_m: NDArray[np.float64]  # (n,)
    faults: dict[int, str]

    def __len__(self) -> int:
        """Return the number of answers."""
        return len(self.thresholds_m)

    @property
    def given(self) -> NDArray[np.bool_]:
        """Whether each question has an answer, shape (n,)."""
        return np.asarray(np.isfinite(self.positions_in_base_m + self.spreads_m).all(axis=1))

    def __getitem__(self, rows: Rows) -> Answers:
        """Return the answers in ``rows``."""
        numbers = np.arange(len(self))[rows].tolist()
        faults = {new: self.faults[old] for new, old in enumerate(numbers) if old in self.faults}
        return Answers(self.positions_in_base_m[rows], self.spreads_m[rows], self.thresholds_m[rows], faults)

    @classmethod
    def joined(cls, parts: list[Answers]) -> Answers:
        """Return the concatenated answers of all ``parts``."""
        faults: dict[int, str] = {}
        first = 0
        for part in parts:
            faults |= {first + row: fault for row, fault in part.faults.items()}
            first += len(part)
        return cls(
            np.concatenate([np.empty((0, 3)), *(part.positions_in_base_m for part in parts)]),
            np.concatenate([np.empty((0, 3)), *(part.spreads_m for part in parts)]),
            np.concatenate([np.empty(0), *(part.thresholds_m for part in parts)]),
            faults,
        )
