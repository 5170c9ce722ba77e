"""The measured agreement between the kinematic world and PyBullet, from ``benchmarks/agreement.py --write``.

A measurement is valid for the source code that produced it.  ``present_source`` computes the hash of every
file that a run and its judgement import.  Therefore a changed page or a changed search does not invalidate
the measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from safety_harness.base.compiled import PACKAGE, source_hash_of
from safety_harness.scenario.typed_json import of_format, parsed, typed

AGREEMENT_FILE = Path(__file__).with_name("agreement.json")
FORMAT = "safety-harness agreement 1"


@dataclass(frozen=True)
class LargestDifference:
    """The largest difference between the two worlds in one quantity.

    ``scenario`` is the scenario in which the difference occurred.
    """

    what: str  # with its unit
    largest: float
    scenario: str


@dataclass(frozen=True)
class Agreement:
    """The agreement of the two worlds in the verdicts of the same scenarios.

    ``compared_near`` is the number of verdicts whose margin is a length within ``near_m`` of zero.
    ``compared`` is the number of all other verdicts. ``optimistic`` lists the disagreements in which PyBullet
    shows a violation and the kinematic world does not.
    """

    source: str
    shipped: int
    random: int
    seed: int
    near_m: float
    compared: int
    agreed: int
    compared_near: int
    agreed_near: int
    optimistic: tuple[str, ...]
    disagreements: tuple[str, ...]
    differences: tuple[LargestDifference, ...]
    left_out: tuple[str, ...]

    @property
    def scenarios(self) -> int:
        """The number of scenarios that were run in both worlds."""
        return self.shipped + self.random

    @property
    def share(self) -> float:
        """The fraction of ``compared`` verdicts on which both worlds agree, or NaN if ``compared`` is 0."""
        return self.agreed / self.compared if self.compared else float("nan")

    @property
    def is_of_present_source(self) -> bool:
        """Whether the source code in use is the source code that was measured."""
        return self.source == present_source()


@lru_cache
def present_source() -> str:
    """Return the hash over every file that a run in either world and its judgement import."""
    return source_hash_of(PACKAGE / "admission" / "trial.py")


def from_json(text: str) -> Agreement:
    """Return the agreement stored in a JSON text.

    Raise InputError if the text stores no agreement.
    """
    document = of_format(parsed(text, AGREEMENT_FILE, "an agreement of two worlds"), FORMAT, AGREEMENT_FILE)
    del document["format"]
    return typed(document, Agreement, AGREEMENT_FILE)


@lru_cache
def measured_agreement() -> Agreement:
    """Return the latest measurement that the package contains."""
    return from_json(AGREEMENT_FILE.read_text(encoding="utf-8"))
