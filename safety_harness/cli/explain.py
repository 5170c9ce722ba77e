"""``safety-harness explain``: what a key means, from the table behind the documentation."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from safety_harness.cli.console import AS_EXPECTED, result
from safety_harness.exceptions import Place, ScenarioError
from safety_harness.scenario.codec import REQUIRED, Below, Key, KeyTable, QuantityValue, Several, Value
from safety_harness.scenario.reference_tables import every_table
from safety_harness.scenario.units import Dimension, near_miss


def explain_key(words: Sequence[str]) -> int:
    """Print what a key means, wherever it may stand, or which keys there are; returns the exit code."""
    asked = " ".join(" ".join(words).replace(":", " ").split())
    if not asked:
        result(*(f"{table.where}: {', '.join(table.names)}" for table in every_table()))
        return AS_EXPECTED
    found = [(table, key) for table in every_table() for key in table.keys if asked in _names(table, key)]
    if not found:
        known = dict.fromkeys(name for table in every_table() for name in table.names)
        raise ScenarioError(
            place=Place(field="explain"),
            expected="a key of a scenario file; without one, all of them are listed",
            got=asked,
            hint=near_miss(asked, known, most=3),
        )
    for number, (table, key) in enumerate(found):
        result(*([""] if number else []), *_lines(table, key))
    return AS_EXPECTED


def _names(table: KeyTable, key: Key) -> tuple[str, ...]:
    """What a user may call a key: its name, alone or below that of its mapping."""
    above = {table.name, table.path, table.path.rpartition(".")[2]} - {""}
    return (key.name, *(f"{name}.{key.name}" for name in sorted(above)))


def _lines(table: KeyTable, key: Key) -> Iterator[str]:
    yield f"{key.name}, of {table.where}"
    yield f"  means    {_plain(key.meaning)}"
    yield f"  takes    {_plain(_takes(key))}"
    yield f"  default  {'none: it has to be given' if key.default == REQUIRED else _plain(key.default)}"
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
    return re.sub(r"\[[^]]*\]\(([a-z-]+\.md)[^)]*\)", r"see docs/\1", text)
