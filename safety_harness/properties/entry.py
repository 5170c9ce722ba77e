"""What the catalogue says of a property: how to claim it, and everything that one should know before."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from safety_harness.exceptions import InadmissibleError, Place
from safety_harness.properties.base import Property, Unit
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    LENGTH,
    SPEED,
    TIME,
    Dimension,
    parse_quantity,
)

_LARGEST = {  # in SI
    LENGTH.name: 10.0,
    SPEED.name: 10.0,
    TIME.name: 3600.0,
    ACCELERATION.name: 1000.0,
    ANGULAR_ACCELERATION.name: 10_000.0,
}
LARGEST_COUNT = 1_000_000

Maker = Callable[[re.Match[str], Scenario, Place], Property]


@dataclass(frozen=True, kw_only=True, eq=False)
class CatalogueEntry:
    """One property of the catalogue.

    ``example`` is a sentence that claims it, and ``pattern`` matches every such sentence whole, in
    either case; ``make`` turns the match into the property.  The rest is for people: ``rationale``,
    ``source``, the ``margin``'s formula, the ``parameters`` that it takes from the sentence and from the
    settings, when it is ``exercised`` (otherwise it is inconclusive), what else makes it
    ``inconclusive``, the shipped ``scenario`` that exercises it, and what it is ``broken_by``: the
    controller or avoider with which the tests see it violated.
    """

    example: str
    pattern: str
    make: Maker
    unit: Unit
    rationale: str
    source: str
    margin: str
    parameters: str
    exercised: str
    inconclusive: str
    scenario: str
    broken_by: str

    def understands(self, sentence: str) -> re.Match[str] | None:
        """The match of a sentence that claims this property, whatever its case and outer spaces."""
        return re.fullmatch(self.pattern, sentence.strip(), re.IGNORECASE)


def quantity(text: str, dimension: Dimension, place: Place) -> float:
    """A quantity above zero: a limit of zero or less would be kept by anything, or by nothing."""
    value = parse_quantity(text, dimension, place)
    most = _LARGEST[dimension.name]
    if not 0.0 < value <= most:
        expected = f"{dimension.expected}, above zero and at most {most:g} {dimension.si}"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return value


def count(text: str, place: Place) -> int:
    """A whole number of at least one."""
    if not (text.isascii() and text.isdigit() and 0 < int(text[:9]) <= LARGEST_COUNT and len(text) < 9):
        expected = f"a whole number from 1 to {LARGEST_COUNT}"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return int(text)
