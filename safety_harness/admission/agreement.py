"""Agreement of the kinematic world with PyBullet: the measurement of ``benchmarks/agreement.py --write``.

A measurement holds for its source.  ``present_source`` covers every file that a run and its judgement import,
so that a change of a page or of a search does not make it old.
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
    """The largest difference of one quantity between the two worlds, and its scenario."""

    what: str  # with its unit
    largest: float
    scenario: str


@dataclass(frozen=True)
class Agreement:
    """Verdicts of the same scenarios in both worlds.

    ``compared`` counts verdicts with a margin of more than ``near_m`` from zero, or a margin that is no
    length; ``compared_near`` counts the rest.  In the ``optimistic`` disagreements only PyBullet sees a
    violation.
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
        """The number of scenarios in both worlds."""
        return self.shipped + self.random

    @property
    def share(self) -> float:
        """The share of agreements among verdicts away from a limit; NaN without such a verdict."""
        return self.agreed / self.compared if self.compared else float("nan")

    @property
    def is_of_present_source(self) -> bool:
        """Whether the running source is the source of the measurement."""
        return self.source == present_source()


@lru_cache
def present_source() -> str:
    """Return the hash over every file that a run in either world and its judgement import."""
    return source_hash_of(PACKAGE / "admission" / "trial.py")


def from_json(text: str) -> Agreement:
    """Return the agreement of a JSON text; InputError for another text."""
    document = of_format(parsed(text, AGREEMENT_FILE, "an agreement of two worlds"), FORMAT, AGREEMENT_FILE)
    del document["format"]
    return typed(document, Agreement, AGREEMENT_FILE)


@lru_cache
def measured_agreement() -> Agreement:
    """Return the latest measurement that ships with the package."""
    return from_json(AGREEMENT_FILE.read_text(encoding="utf-8"))
