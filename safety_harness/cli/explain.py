"""Define ``explain`` and ``claims``, which print the documentation of keys and claims."""

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

WIDTH = 110  # columns, also on a wider terminal, so that lines stay readable


def explain_key(typed: Sequence[str]) -> int:
    """Print the meaning of a key, or list all keys.

    The function explains the key in every mapping that has it, and returns the exit code.

    Args:
        typed: the words of the key, or an empty sequence to list all keys.

    Raises:
        ScenarioError: no mapping has the key.

    """
    added = (kind.tables() for kind in input_files().values() if kind.tables is not None)
    tables = (*every_table(), *(table for tables in added for table in tables))
    query = " ".join(" ".join(typed).replace(":", " ").split())
    if not query:
        result(*(f"{table.where}: {', '.join(table.names)}" for table in tables))
        document(tables=[{"where": table.where, "keys": table.names} for table in tables])
        return AS_EXPECTED
    matches = [(table, key) for table in tables for key in table.keys if query in _names(table, key)]
    known = (name for table in tables for name in table.names)
    document(keys=[_key_data(*pair) for pair in matches])
    expected = "a key of a scenario file or of a plan; without one, all of them are listed"
    return _explain("explain", query, expected, known, [_key_lines(*pair) for pair in matches])


def explain_claims(typed: Sequence[str]) -> int:
    """Print every sentence of the catalogue, or details of the matching sentences.

    Return the exit code.

    Args:
        typed: some words of a sentence, or a whole sentence with the user's own limit.  If empty, all
            sentences are listed.

    Raises:
        ScenarioError: no sentence matches.

    """
    from safety_harness.claims.formulas.signals import SIGNALS
    from safety_harness.claims.properties.catalogue import CATALOGUE  # slow to import

    query = " ".join(" ".join(typed).split())
    examples = [entry.example for entry in CATALOGUE]
    if not query:
        result(*examples)
        document(claims=[{"claim": entry.example} | dict(_described(entry)) for entry in CATALOGUE])
        signals = ", ".join(signal.words for signal in SIGNALS)
        say(f"or a formula (safety-harness docs reference/formulas) over: {signals}")
        return AS_EXPECTED
    matches = [entry for entry in CATALOGUE if entry.understands(query)]
    wanted = set(query.lower().split())
    matches = matches or [entry for entry in CATALOGUE if wanted <= set(entry.example.lower().split())]
    document(claims=[{"claim": entry.example} | dict(_described(entry)) for entry in matches])
    expected = "words of a claim of the catalogue; without any, all claims are listed"
    return _explain("claims", query, expected, examples, [_claim_lines(match) for match in matches])


def _explain(
    field: str, query: str, expected: str, known: Iterable[str], matches: Sequence[Iterator[str]]
) -> int:
    """Print the lines of each match, with an empty line between two matches.

    Raise ScenarioError with similar names if there are no matches.
    """
    if not matches:
        hint = near_miss(query, known, most=3)
        raise ScenarioError(place=Place(field=field), expected=expected, got=query, hint=hint)
    for number, lines in enumerate(matches):
        result(*([""] if number else []), *lines)
    return AS_EXPECTED


def _described(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield (name, text) for each part of the description of a catalogue entry.

    Added packages may contribute further parts.
    """
    from safety_harness.claims.properties.entry import entry_fields

    yield from entry_fields(entry)
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
    """Return the names that a user may type for a key.

    They are the key's own name, and the key's name with the name of its mapping in front.
    """
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
    data = _key_data(table, key)
    yield f"{key.name}, of {table.where}"
    yield f"  means    {data['means']}"
    yield f"  takes    {data['takes']}"
    yield f"  default  {data['default'] or 'none: it has to be given'}"
    for number, line in enumerate(key.lines.splitlines()):
        yield f"  {'example' if number == 0 else '       '}  {line}"


def _takes(key: Key) -> str:
    """Return the text on the allowed values of a key.

    It states the type and units, or the keys below this key.
    """
    if isinstance(key.value, Below):
        names = [name for table in key.value.tables for name in table.names]
        return f"a mapping with the keys {', '.join(dict.fromkeys(names))}"
    if isinstance(key.value, Several) and isinstance(key.value.of, Below):
        firsts = dict.fromkeys(table.told_by for table in key.value.of.tables)
        return f"{key.value.kind}, each a mapping with the key {' or '.join(firsts)}"
    text = key.said if key.said and not _dimension(key.value) else key.value.kind
    dimension = _dimension(key.value)
    if dimension is None or not dimension.units:
        return text
    bare = " or none" if dimension.bare else ""
    return f"{text} (units: {', '.join(dimension.units)}{bare})"


def _dimension(value: Value) -> Dimension | None:
    if isinstance(value, Several):
        return _dimension(value.of)
    return value.dimension if isinstance(value, QuantityValue) and value.dimension.units else None


def _plain(text: str) -> str:
    """Return the text of a table cell of the documentation, with its markup removed."""
    text = re.sub(r" \(\[[^]]*\]\(#[^)]*\)\)", "", text.replace("`", ""))
    return re.sub(r"\[[^]]*\]\(([a-z/-]+)\.md([^)]*)\)", r"safety-harness docs \1\2", text)
