"""``explain`` and ``claims``: what a key means and what can be claimed, as behind the documentation."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from types import FunctionType
from typing import TYPE_CHECKING

from safety_harness.base.exceptions import Place, ScenarioError, near_miss
from safety_harness.base.extension_points import ExtensionPoint, input_files, loaded
from safety_harness.cli.console import AS_EXPECTED, NARROW, columns_of, document, result, say
from safety_harness.scenario.codec import REQUIRED, Below, Key, KeyTable, QuantityValue, Several, Value
from safety_harness.scenario.reference_tables import every_table
from safety_harness.scenario.units import Dimension

if TYPE_CHECKING:
    from safety_harness.claims.properties.entry import CatalogueEntry

WIDTH = 110


def explain_key(words: Sequence[str]) -> int:
    """Print what a key means, wherever it may stand, or which keys there are; returns the exit code."""
    added = (kind.tables() for kind in input_files().values() if kind.tables is not None)
    tables = (*every_table(), *(table for tables in added for table in tables))
    asked = " ".join(" ".join(words).replace(":", " ").split())
    if not asked:
        result(*(f"{table.where}: {', '.join(table.names)}" for table in tables))
        document(tables=[{"where": table.where, "keys": table.names} for table in tables])
        return AS_EXPECTED
    found = [(table, key) for table in tables for key in table.keys if asked in _names(table, key)]
    known = (name for table in tables for name in table.names)
    document(keys=[_key_data(*pair) for pair in found])
    expected = "a key of a scenario file or of a plan; without one, all of them are listed"
    return _explain("explain", asked, expected, known, [_key_lines(*pair) for pair in found])


def explain_claims(words: Sequence[str]) -> int:
    """Print every sentence, or all about those that contain the words; returns the exit code.

    The words may be a whole sentence with a limit of one's own: what understands it is explained.
    """
    from safety_harness.claims.formulas.signals import SIGNALS
    from safety_harness.claims.properties.catalogue import CATALOGUE  # slow to import

    asked = " ".join(" ".join(words).split())
    examples = [entry.example for entry in CATALOGUE]
    if not asked:
        result(*examples)
        document(claims=[{"claim": entry.example} | dict(_described(entry)) for entry in CATALOGUE])
        signals = ", ".join(signal.words for signal in SIGNALS)
        say(f"or a formula (safety-harness docs formulas) over: {signals}")
        return AS_EXPECTED
    found = [entry for entry in CATALOGUE if entry.understands(asked)]
    wanted = set(asked.lower().split())
    found = found or [entry for entry in CATALOGUE if wanted <= set(entry.example.lower().split())]
    document(claims=[{"claim": entry.example} | dict(_described(entry)) for entry in found])
    expected = "words of a claim of the catalogue; without any, all claims are listed"
    return _explain("claims", asked, expected, examples, [_claim_lines(one) for one in found])


def _explain(
    field: str, asked: str, expected: str, known: Iterable[str], found: Sequence[Iterator[str]]
) -> int:
    """The lines on each that was found, apart; ScenarioError with what is near to it where nothing was."""
    if not found:
        hint = near_miss(asked, known, most=3)
        raise ScenarioError(place=Place(field=field), expected=expected, got=asked, hint=hint)
    for number, lines in enumerate(found):
        result(*([""] if number else []), *lines)
    return AS_EXPECTED


def _described(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield (name, text) of all that an entry says for people, and of what packages add to it."""
    from safety_harness.claims.properties.entry import told

    yield from told(entry)
    for _, note in loaded(ExtensionPoint.CLAIM_NOTES, FunctionType):
        yield from note(entry)


def _claim_lines(entry: CatalogueEntry) -> Iterator[str]:
    yield entry.example
    columns = min(columns_of(sys.stdout) or WIDTH, WIDTH)
    if columns < NARROW:
        yield from (f"  {name}: {text}" for name, text in _described(entry))
        return
    for name, text in _described(entry):
        yield from textwrap.wrap(
            text, columns, initial_indent=f"  {name:<13}", subsequent_indent=" " * 15, break_on_hyphens=False
        )


def _names(table: KeyTable, key: Key) -> tuple[str, ...]:
    """What a user may call a key: its name, alone or below that of its mapping."""
    above = {table.name, table.path, table.path.rpartition(".")[2]} - {""}
    return (key.name, *(f"{name}.{key.name}" for name in sorted(above)))


def _key_data(table: KeyTable, key: Key) -> dict[str, object]:
    return {
        "key": key.name,
        "where": table.where,
        "means": _plain(key.meaning),
        "takes": _plain(_takes(key)),
        "default": None if key.default == REQUIRED else _plain(key.default),
        "example": key.lines,
    }


def _key_lines(table: KeyTable, key: Key) -> Iterator[str]:
    said = _key_data(table, key)
    yield f"{key.name}, of {table.where}"
    yield f"  means    {said['means']}"
    yield f"  takes    {said['takes']}"
    yield f"  default  {said['default'] or 'none: it has to be given'}"
    for number, line in enumerate(key.lines.splitlines()):
        yield f"  {'example' if number == 0 else '       '}  {line}"


def _takes(key: Key) -> str:
    """The value with its bounds and units, or the keys below."""
    if isinstance(key.value, Below):
        names = [name for table in key.value.tables for name in table.names]
        return f"a mapping with the keys {', '.join(dict.fromkeys(names))}"
    if isinstance(key.value, Several) and isinstance(key.value.of, Below):
        firsts = dict.fromkeys(table.told_by for table in key.value.of.tables)
        return f"{key.value.words}, each a mapping with the key {' or '.join(firsts)}"
    words = key.said if key.said and not _dimension(key.value) else key.value.words
    dimension = _dimension(key.value)
    if dimension is None or not dimension.units:
        return words
    bare = " or none" if dimension.bare else ""
    return f"{words} (units: {', '.join(dimension.units)}{bare})"


def _dimension(value: Value) -> Dimension | None:
    if isinstance(value, Several):
        return _dimension(value.of)
    return value.dimension if isinstance(value, QuantityValue) and value.dimension.units else None


def _plain(text: str) -> str:
    """A cell of the page's table without the page's marks."""
    text = re.sub(r" \(\[[^]]*\]\(#[^)]*\)\)", "", text.replace("`", ""))
    return re.sub(r"\[[^]]*\]\(([a-z-]+)\.md([^)]*)\)", r"safety-harness docs \1\2", text)
