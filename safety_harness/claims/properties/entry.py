"""The catalogue's description of a property: how to claim it, and its background.

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
# A choice: more ticks, times or iterations than any run has.
LARGEST_COUNT = 1_000_000
NONE = "-"

Maker = Callable[[re.Match[str], Scenario, Place], Property]


@dataclass(frozen=True, kw_only=True, eq=False)
class CatalogueEntry:
    """A property of the catalogue.

    ``prop`` is an example of the property. ``pattern`` matches every whole sentence that claims the property,
    ignoring case. ``make`` turns the match into the property. If ``pattern`` and ``make`` are absent, both
    are derived from the example's ``wording``. If the example has no fields, only the example's own sentence
    claims the property. ``former`` has the wordings of earlier releases, which also claim the property. These
    wordings have the same fields in the same order. ``formula`` is the text of a formula that expresses the
    property, with {} in place of the limit, or an empty text if no formula does so. The other fields are
    texts for readers: ``rationale``, ``source``, ``margin`` and ``parameters``. ``exercised`` states which
    runs exercise the property; all other runs are inconclusive. ``inconclusive`` gives further reasons for an
    inconclusive verdict. ``scenario`` is the shipped scenario that exercises the property. ``broken_by`` is
    the controller or avoider that violates the property in the tests.
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
        """Return the sentence with the field names in place of the values.

        ``Worded`` writes its wording in the same way.
        """
        return getattr(self.prop, "wording", self.example)

    @property
    def key(self) -> str:
        """Return the entry's identifier: its wording without values, such as "hand-distance-never-below"."""
        return "-".join(re.sub(r"[^a-z ]", "", FIELD.sub("", self.wording).lower()).split())

    @property
    def unit(self) -> Unit:
        """Return the unit of the property's margins."""
        return self.prop.unit

    def property_of(self, match: re.Match[str], scenario: Scenario, place: Place) -> Property:
        """Return the property that ``match`` claims about runs of ``scenario``.

        Raise InadmissibleError at ``place`` if a value in the sentence is not allowed.
        """
        if self.make is not None:
            return self.make(match, scenario, place)
        texts = enumerate(FIELD.findall(self.wording), start=1)
        values = {name: _limit(match[k], unit, scenario, place) for k, (name, unit) in texts}
        return replace(self.prop, **values) if values else self.prop  # type: ignore[type-var]

    def understands(self, sentence: str) -> re.Match[str] | None:
        """Return the match of ``sentence`` if it claims this property, ignoring case and outer spaces."""
        return _match(sentence, self.pattern or _pattern(self.wording), *map(_pattern, self.former))

    def in_words_of_today(self, sentence: str) -> str | None:
        """Return the present wording of a sentence in ``former``, or None for any other sentence.

        The values stay as they are written.
        """
        match = _match(sentence, *map(_pattern, self.former))
        if match is None:
            return None
        values = iter(match.groups())
        sentence = FIELD.sub(lambda _: next(values), self.wording)
        return re.sub(r"(\S+)( \w+)\(s\)", lambda m: m[1] + m[2] + "s" * (m[1] != "1"), sentence)


def _match(sentence: str, *patterns: str) -> re.Match[str] | None:
    """Return the match of the first pattern that matches the whole sentence, or None if no pattern does."""
    matches = (re.fullmatch(pattern, sentence.strip(), re.IGNORECASE) for pattern in patterns)
    return next(filter(None, matches), None)


def _pattern(wording: str) -> str:
    """Return a pattern that matches all sentences of ``wording``, with a group for each field."""
    wording = PLURAL.sub(r"\1s?", wording)
    return FIELD.sub(lambda field: r"(\S+)" if field[2] in ("", "1") else "(.+)", wording)


def _limit(text: str, unit: str, scenario: Scenario, place: Place) -> float:
    """Convert the ``text`` of a field in a sentence to the field's value; ``unit`` is the field's unit."""
    if unit == "ms":
        return time_within(text, scenario, place)
    if unit in DIMENSIONS:
        return quantity(text, DIMENSIONS[unit], place)
    return share(text, place) if unit == "%" else count(text, place)


def quantity(text: str, dimension: Dimension, place: Place) -> float:
    """Return a quantity above zero.

    A limit of zero or less is refused, because it would be met either by every run or by no run.
    """
    value, most = parse_quantity(text, dimension, place), dimension.most_of_limits
    if not 0.0 < value <= most:
        expected = f"{dimension.expected}, above zero and at most {most:g} {dimension.si}"
        hint = OTHER_UNIT if value > most else ""
        raise InadmissibleError(place=place, expected=expected, got=repr(text), hint=hint)
    return value


def time_within(text: str, scenario: Scenario, place: Place) -> float:
    """Return a time above zero that is not longer than a run of ``scenario``.

    A later time is refused, because every run would keep it.
    """
    value_s = quantity(text, TIME, place)
    if value_s > scenario.duration_s:
        expected = f"a time that ends within the scenario's duration, {scenario.duration_s:g} s"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return value_s


def share(text: str, place: Place) -> float:
    """Return a fraction of at least 0 % and less than 100 %.

    A limit of 100 % is refused, because every run would keep it.
    """
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
    """Yield (name, text) for each text of ``entry`` that people read, in reading order."""
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
