"""One layout for every scenario file; comments, units and the order of free keys stay as they were."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

from safety_harness.exceptions import Place, ScenarioError
from safety_harness.scenario.codec import Below, FreeKeys, KeyTable, Several, Value, scalar_text
from safety_harness.scenario.compose import SPACE_KEY, is_space
from safety_harness.scenario.layout_tree import LayoutEntry, WrittenValue, written_tree
from safety_harness.scenario.nodes import Mapping, Node, Scalar, parse_tree
from safety_harness.scenario.reference_tables import COMPOSED, TOP

PROSE_WIDTH, FLOW_WIDTH = 120, 110
_NUMBER = re.compile(r"[+-]?[.0-9][^,\[\]{}]*")
_FIRST = ("scenario", SPACE_KEY, "suite", "about", *COMPOSED.names, "choices")
_WHOLE_FILE = Below(tables=(TOP,))


def laid_out(text: str, file: Path | None = None) -> str:
    """``text`` in the one layout; ScenarioError if it is no tree.  It means what it meant before."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    before = parse_tree(text, file)
    root, comments = written_tree(text)
    # The values of a space vary in the order in which they stand, so that this order means something.
    lines = list(_head(root)) + _block(root, None if is_space(before) else _WHOLE_FILE)
    new = "\n".join(lines).strip("\n") + "\n"
    if meaning(parse_tree(new, file)) != meaning(before) or written_tree(new)[1] != comments:
        raise ScenarioError(
            place=Place(file=file),
            expected="a file that can be laid out without a change of what it says",
            got="one that cannot; it is left as it is",
        )
    return new


def meaning(node: Node) -> object:
    """What a tree says, whatever its lines and the order of its keys; the order of claims counts."""
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return {
            key.text: list(_entries(value)) if key.text == "claims" else meaning(value)
            for key, value in node.entries
        }
    return [meaning(item) for item in node.items]


def _entries(node: Node) -> Iterator[object]:
    if not isinstance(node, Mapping):
        yield meaning(node)
        return
    yield from ((key.text, meaning(value)) for key, value in node.entries)


def _head(root: WrittenValue) -> Iterator[str]:
    """Comments that a blank line parts from the first key belong to the file and stay at its top."""
    if not root.entries:
        return
    first = root.entries[0]
    if "" in first.before:
        cut = len(first.before) - first.before[::-1].index("")
        yield from first.before[:cut]
        first.before = first.before[cut:]


def _block(value: WrittenValue, kind: Value | None) -> list[str]:
    """The lines of a value below its key, not indented."""
    if value.kind == "scalar":
        return [*value.tail, *_scalar_lines(value, "")]
    if not value.entries:
        return ["[]" if value.kind == "list" else "{}", *value.tail]
    lines: list[str] = []
    if value.kind == "list":
        for entry in value.entries:
            lines += _item(entry, kind)
    else:
        ordered, kinds = _ordered(value, kind)
        for number, entry in enumerate(ordered):
            blank = ["" for line in entry.before[:1] if not line and number > 0]
            lines += blank + [line for line in _collapsed(entry.before) if line or number > 0][len(blank) :]
            lines += _pair(entry, kinds[id(entry)])
    return lines + value.tail


def _collapsed(before: list[str]) -> list[str]:
    return [line for at, line in enumerate(before) if line or at == 0 or before[at - 1]]


def _item(entry: LayoutEntry, kind: Value | None) -> list[str]:
    """An item of a list of ``kind``: a dash before its first line, comments that come first above it."""
    kind = kind.of if isinstance(kind, Several) else None
    flow = _flow(entry.value, 2 + len(entry.beside), kind)
    if flow is not None:
        content = [_beside(flow, entry.beside)]
    else:
        content = _block(entry.value, kind)
        if entry.beside:
            content = [entry.beside, *content]
    above = list(entry.before)
    if not any(content):
        return [*_collapsed(above), "-"]  # an item without a value
    while content[0].startswith("#") or not content[0]:
        above.append(content.pop(0))
    return [*_collapsed(above), f"- {content[0]}", *(f"  {line}" if line else "" for line in content[1:])]


def _pair(entry: LayoutEntry, kind: Value | None) -> list[str]:
    """A key with its value."""
    assert entry.key is not None
    key = _scalar(entry.key)
    value = entry.value
    flow = _flow(value, len(key) + 2 + len(entry.beside), kind)
    if flow is not None:
        above = [entry.beside_key] if entry.beside_key else []
        return [*above, _beside(f"{key}: {flow}".rstrip(), entry.beside)]
    above = [entry.beside] if entry.beside else []
    if value.kind == "scalar":
        lines = _scalar_lines(value, f"{key}: ")
        above += [entry.beside_key] if entry.beside_key else []
        return [*above, *lines]
    indent = "  "
    below = _block(value, kind)
    return [
        *above,
        _beside(f"{key}:", entry.beside_key),
        *(indent + line if line else "" for line in below),
    ]


def _beside(line: str, comment: str) -> str:
    return f"{line}  {comment}" if comment else line


def _flow(value: WrittenValue, taken: int, kind: Value | None) -> str | None:
    """The value on one line, if it may stand on one: as it was written, or a list of numbers."""
    if value.comments:
        return None
    if value.kind == "scalar":
        text = _scalar(value)
        return text if not value.raw and not _is_long_prose(value, taken) else None
    numbers = value.kind == "list" and all(
        one.value.kind == "scalar" and not one.value.style and _NUMBER.fullmatch(one.value.text)
        for one in value.entries
    )
    if not value.flow and not numbers:
        return None
    parts = []
    entries, kinds = _ordered(value, kind) if value.kind == "mapping" else (value.entries, {})
    for entry in entries:
        inner = _flow(entry.value, 0, kinds.get(id(entry)))
        if inner is None:
            return None
        parts.append(inner if entry.key is None else f"{_scalar(entry.key)}: {inner}".rstrip())
    text = f"[{', '.join(parts)}]" if value.kind == "list" else f"{{{', '.join(parts)}}}"
    return text if taken + len(text) <= FLOW_WIDTH or not value.entries else None


def _is_long_prose(value: WrittenValue, taken: int) -> bool:
    words = value.text.split(" ")
    return taken + len(value.text) > PROSE_WIDTH and len(words) > 20 and "\n" not in value.text and all(words)


def _scalar(value: WrittenValue) -> str:
    """A scalar on one line: quoted only where it has to be."""
    if value.style or "\n" in value.text:
        return scalar_text(value.text)
    return value.text


def _scalar_lines(value: WrittenValue, before: str) -> list[str]:
    """A scalar that may take several lines."""
    if value.raw:
        header, *lines = value.raw
        widths = [len(line) - len(line.lstrip()) for line in lines if line.strip()]
        first = next((line for line in lines if line.strip()), "")
        width = min(widths, default=0)
        regular = widths and len(first) - len(first.lstrip()) == width
        if not regular or any(character.isdigit() for character in header.split("#")[0]):
            return [before + scalar_text(value.text.rstrip("\n"))]
        return [before + header[0], *(f"  {line[width:]}" if line[width:] else "" for line in lines)]
    if _is_long_prose(value, len(before)):
        return [f"{before}>", *(f"  {line}" for line in _wrapped(value.text))]
    return [before + _scalar(value)]


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, PROSE_WIDTH - 2, break_long_words=False, break_on_hyphens=False)


def _ordered(value: WrittenValue, kind: Value | None) -> tuple[list[LayoutEntry], dict[int, Value | None]]:
    """The entries in the documented order, free keys as they are; and what each entry's value is."""
    kinds: dict[int, Value | None] = {}
    if isinstance(kind, FreeKeys):
        kinds = {id(one): kind.of for one in value.entries}
        return value.entries, kinds
    names: Sequence[str] = ()
    known: dict[str, Value | None] = {}
    if isinstance(kind, Below):
        table = _table_of(kind, {one.key.text for one in value.entries if one.key is not None})
        names = _FIRST + table.names if table is TOP else table.names
        known = {key.name: key.value for key in table.keys}
        if table is TOP:
            known["matrix"] = FreeKeys(of=FreeKeys(of=_WHOLE_FILE, form=""), form="")
    place = {name: at for at, name in reversed(list(enumerate(names)))}
    for entry in value.entries:
        assert entry.key is not None
        kinds[id(entry)] = known.get(entry.key.text)
    ordered = sorted(value.entries, key=lambda one: place.get(one.key.text if one.key else "", len(names)))
    return ordered, kinds


def _table_of(kind: Below, keys: set[str]) -> KeyTable:
    """The table that a mapping with these keys follows."""
    begun = [table for table in kind.tables if table.told_by in keys]
    return begun[-1] if begun else (kind.tables or (COMPOSED,))[0]
