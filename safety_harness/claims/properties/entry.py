"""The catalogue's description of a property: how to claim it, and what to know before.

Pages are generated from the entries, so that they agree with the code.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.claims.properties.base import FIELD, PLURAL, Property, Unit
from safety_harness.claims.properties.measured import columns_read_by
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    FRACTION,
    LENGTH,
    NUMBER,
    OTHER_UNIT,
    SPEED,
    TIME,
    Dimension,
    parse_quantity,
)

DIMENSIONS = {
    **{"1": NUMBER, "mm": LENGTH, "s": TIME, "mm/s": SPEED, "m/s": SPEED},
    **{"m/s2": ACCELERATION, "deg/s2": ANGULAR_ACCELERATION},
}
LARGEST_COUNT = 1_000_000
NONE = "-"

Maker = Callable[[re.Match[str], Scenario, Place], Property]


@dataclass(frozen=True, kw_only=True, eq=False)
class CatalogueEntry:
    """A property of the catalogue.

    ``prop`` is an example of the property. ``pattern`` matches every whole sentence that claims the property,
    ignoring case. ``make`` turns the match into the property. By default both follow from the example's
    ``wording``; if it has no fields, only its own sentence claims it. ``former`` are wordings of earlier
    releases with the same fields in the same order, which claim it too. ``formula`` is the property as a
    formula, with {} for its limit, if there is one. The other fields are for people: ``rationale``,
    ``source``, the ``margin``'s formula, and the ``parameters`` in sentence and settings. ``exercised`` tells
    which runs exercise it (others are inconclusive), and ``inconclusive`` gives other reasons. ``scenario``
    is the shipped scenario that exercises it, and ``broken_by`` the controller or avoider that violates it in
    the tests.
    """

    prop: Property
    pattern: str = ""
    make: Maker | None = None
    former: tuple[str, ...] = ()
    formula: str = ""
    rationale: str
    source: str
    margin: str
    parameters: str
    exercised: str
    inconclusive: str = NONE
    scenario: str = "hand-visits-and-leaves"
    broken_by: str

    @property
    def example(self) -> str:
        """Return a sentence that claims the property."""
        return self.prop.sentence

    @property
    def wording(self) -> str:
        """Return the sentence with the names of fields in place of their values, as in ``Worded``."""
        return getattr(self.prop, "wording", self.example)

    @property
    def key(self) -> str:
        """Return the entry's identifier: the words without values, such as "hand-distance-never-below"."""
        return "-".join(re.sub(r"[^a-z ]", "", FIELD.sub("", self.wording).lower()).split())

    @property
    def unit(self) -> Unit:
        """Return the unit of its margins."""
        return self.prop.unit

    def property_of(self, match: re.Match[str], scenario: Scenario, place: Place) -> Property:
        """Return the property that ``match`` claims of ``scenario``; raise InadmissibleError at ``place``."""
        if self.make is not None:
            return self.make(match, scenario, place)
        texts = enumerate(FIELD.findall(self.wording), start=1)
        values = {name: _limit(match[k], unit, scenario, place) for k, (name, unit) in texts}
        return replace(self.prop, **values) if values else self.prop  # type: ignore[type-var]

    def understands(self, sentence: str) -> re.Match[str] | None:
        """Return the match of a sentence that claims this property, ignoring case and outer spaces."""
        return _match(sentence, self.pattern or _pattern(self.wording), *map(_pattern, self.former))

    def in_words_of_today(self, sentence: str) -> str | None:
        """Return a ``former`` sentence in today's words, with its values as written; None for any other."""
        match = _match(sentence, *map(_pattern, self.former))
        if match is None:
            return None
        values = iter(match.groups())
        sentence = FIELD.sub(lambda _: next(values), self.wording)
        return re.sub(r"(\S+)( \w+)\(s\)", lambda m: m[1] + m[2] + "s" * (m[1] != "1"), sentence)


def _match(sentence: str, *patterns: str) -> re.Match[str] | None:
    """Return the match of the first pattern that the whole sentence has; None without one."""
    matches = (re.fullmatch(pattern, sentence.strip(), re.IGNORECASE) for pattern in patterns)
    return next(filter(None, matches), None)


def _pattern(wording: str) -> str:
    """Return a pattern that matches all sentences of ``wording``, with a group for each field."""
    wording = PLURAL.sub(r"\1s?", wording)
    return FIELD.sub(lambda field: r"(\S+)" if field[2] in ("", "1") else "(.+)", wording)


def _limit(text: str, unit: str, scenario: Scenario, place: Place) -> float:
    """Return the value of a field of ``Worded.wording`` from its ``text`` in a sentence."""
    if unit == "ms":
        return time_within(text, scenario, place)
    if unit in DIMENSIONS:
        return quantity(text, DIMENSIONS[unit], place)
    return share(text, place) if unit == "%" else count(text, place)


def quantity(text: str, dimension: Dimension, place: Place) -> float:
    """Return a quantity above zero, as every run or none would keep a limit of zero or less."""
    value, most = parse_quantity(text, dimension, place), dimension.most_of_limits
    if not 0.0 < value <= most:
        expected = f"{dimension.expected}, above zero and at most {most:g} {dimension.si}"
        hint = OTHER_UNIT if value > most else ""
        raise InadmissibleError(place=place, expected=expected, got=repr(text), hint=hint)
    return value


def time_within(text: str, scenario: Scenario, place: Place) -> float:
    """Return a time above zero that ends within a run of ``scenario``, as all runs would keep a later end."""
    value_s = quantity(text, TIME, place)
    if value_s > scenario.duration_s:
        expected = f"a time that ends within the scenario's duration, {scenario.duration_s:g} s"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return value_s


def share(text: str, place: Place) -> float:
    """Return a share of at least 0 % and less than 100 %, as every run would keep 100 %."""
    value = parse_quantity(text, FRACTION, place)
    if not 0.0 <= value < 1.0:
        expected = f"{FRACTION.expected}, of at least 0 % and less than 100 %"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return value


def count(text: str, place: Place) -> int:
    """Return a whole number of at least one."""
    if not (text.isascii() and text.isdigit() and 0 < int(text[:9]) <= LARGEST_COUNT and len(text) < 9):
        expected = f"a whole number from 1 to {LARGEST_COUNT}"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return int(text)


def entry_fields(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield (name, text) of all that ``entry`` has for people, in the order of reading."""
    yield "why", entry.rationale
    yield "source", entry.source
    yield "margin", f"{entry.margin} ({entry.unit.symbol or 'a number'})"
    yield "parameters", entry.parameters
    yield "exercised", entry.exercised
    also = entry.inconclusive
    yield "inconclusive", "only for the reasons that make any claim so" if also == NONE else also
    yield "reads", ", ".join(columns_read_by(entry.prop) or ())
    yield "tried in", f"shipped:{entry.scenario}"
    yield "broken by", entry.broken_by
