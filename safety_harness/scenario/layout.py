"""Write every scenario file in one layout.

The comments, the units, and the order of free keys do not change. The module reads a file with all its
visible features, such as comments, blank lines and styles. Then the module writes all lines anew.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import StreamMark
from ruamel.yaml.events import (
    CollectionEndEvent,
    CollectionStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
)

from safety_harness.base.exceptions import ScenarioError
from safety_harness.scenario.codec import Below, FreeKeys, KeyTable, Several, Value, scalar_text
from safety_harness.scenario.compose import SPACE_KEY, is_space
from safety_harness.scenario.nodes import Mapping, Node, Scalar, parse_tree
from safety_harness.scenario.reference_tables import COMPOSED, TOP

PROSE_WIDTH, FLOW_WIDTH = 120, 110  # columns of a text, and of a value on one line; a choice
_NUMBER = re.compile(r"[+-]?[.0-9][^,\[\]{}]*")
_FIRST = ("scenario", SPACE_KEY, "suite", "about", *COMPOSED.names, "choices")
_WHOLE_FILE = Below(tables=(TOP,))
_MATRIX = FreeKeys(of=FreeKeys(of=_WHOLE_FILE))
_COMMENT = re.compile(r"(?<!\S)#.*")


@dataclass
class Comment:
    """A comment with its index in the text, its line (counted from 0) and its column."""

    text: str
    index: int
    line: int
    column: int


@dataclass
class WrittenValue:
    """A value as it is written in a file.

    If the value is a block of prose, ``raw`` contains the lines of the block, beginning with its header.
    """

    kind: str  # "scalar", "list" or "mapping"
    flow: bool = False
    text: str = ""
    style: str = ""  # of a scalar: "", "'", '"', "|" or ">"
    raw: tuple[str, ...] = ()
    entries: list[LayoutEntry] = field(default_factory=list)
    tail: list[str] = field(default_factory=list)  # comments after the last entry


@dataclass
class LayoutEntry:
    """A key with its value, or an item of a list.

    An empty text in ``above`` stands for a blank line.
    """

    key: WrittenValue | None
    value: WrittenValue
    above: list[str] = field(default_factory=list)
    beside_key: str = ""
    beside: str = ""

    @property
    def name(self) -> str:
        """The text of the key, or an empty text if the entry is an item of a list."""
        return self.key.text if self.key else ""


def written_tree(text: str) -> tuple[WrittenValue, int]:
    """Return the tree of a text that ``parse_tree`` accepts.

    Also return the number of comments in the text.
    """
    kinds = ScalarEvent | CollectionStartEvent | CollectionEndEvent
    events = [event for event in YAML(typ="safe", pure=True).parse(text) if isinstance(event, kinds)]
    comments = _comments(text, events)
    return _Builder(text, events, comments).root(), len(comments)


def _comments(text: str, events: Sequence[Event]) -> list[Comment]:
    """Return every comment of a text.

    A comment begins with a # that is at the start of a word and outside of scalars, and it lasts until the
    end of the line.
    """
    parts, at = [], 0
    for event in events:
        if isinstance(event, ScalarEvent):
            start, end = event.start_mark.index, event.end_mark.index
            if event.style in ("|", ">"):  # a comment may stand beside the sign that begins the prose
                start += len(text[start:end].partition("\n")[0])
            # A # within a scalar begins no comment.  The replacement has the same length, so all positions
            # stay.
            parts += [text[at:start], text[start:end].replace("#", "x")]
            at = end
    comments = []
    for match in _COMMENT.finditer("".join([*parts, text[at:]])):
        index = match.start()
        column = index - text.rfind("\n", 0, index) - 1
        comments.append(Comment(match[0].rstrip(), index, text.count("\n", 0, index), column))
    return comments


class _Builder:
    """A builder for the tree of a written file; it assigns every comment to the entry where it belongs."""

    def __init__(self, text: str, events: Sequence[Event], comments: list[Comment]) -> None:
        self._text, self._events, self._next = text, events, 0
        self._lines, self._comments = text.split("\n"), list(comments)

    def root(self) -> WrittenValue:
        """Return the tree of the whole text."""
        root = self._value()
        if root.kind == "scalar" and self._comments:
            root.tail = [comment.text for comment in self._comments]
        else:
            root.tail += self._comments_up_to(len(self._text) + 1, len(self._lines), first=False)
        return root

    def _value(self) -> WrittenValue:
        """Return the value that begins at the next event, including the comments inside it."""
        event = self._events[self._next]
        self._next += 1
        if isinstance(event, ScalarEvent):
            source = self._text[event.start_mark.index : event.end_mark.index].rstrip("\n")
            raw = tuple(source.split("\n")) if event.style in ("|", ">") else ()
            return WrittenValue("scalar", text=event.value, style=event.style or "", raw=raw)
        assert isinstance(event, CollectionStartEvent)
        flow = bool(event.flow_style)
        mapping = isinstance(event, MappingStartEvent)
        value = WrittenValue("mapping" if mapping else "list", flow)
        while not isinstance(self._events[self._next], MappingEndEvent | SequenceEndEvent):
            value.entries.append(self._entry(mapping, first=not value.entries))
        end = self._events[self._next]
        self._next += 1
        limit = end.start_mark.index if flow else self._start_of_next()
        least = 0 if flow else max(event.start_mark.column, 1)
        deeper = [comment for comment in self._comments if comment.index < limit and comment.column >= least]
        if deeper and deeper == self._comments[: len(deeper)]:
            value.tail = self._comments_up_to(deeper[-1].index + 1, deeper[-1].line + 1, first=False)
        return value

    def _entry(self, mapping: bool, *, first: bool) -> LayoutEntry:
        """Return the next key with its value, or the next item.

        The comments above and beside a key or an item belong to it.
        """
        start = self._events[self._next].start_mark
        above = self._comments_up_to(start.index, start.line, first=first)
        key, beside_key = None, ""
        if mapping:
            key = self._value()
            beside_key = self._beside()
        value = self._value()
        plain = value.flow or (value.kind == "scalar" and not value.raw)
        beside = self._beside() if plain else ""
        if value.raw and self._comments and self._comments[0].index < self._end_mark().index:
            beside = self._comments.pop(0).text  # beside the sign that begins the prose
        return LayoutEntry(key, value, above, beside_key, beside)

    def _end_mark(self) -> StreamMark:
        """Return the position at which the last event ends."""
        mark: StreamMark = self._events[self._next - 1].end_mark
        return mark

    def _start_of_next(self) -> int:
        """Return the position of the next event that does not end a block."""
        for event in self._events[self._next :]:
            if not isinstance(event, CollectionEndEvent):
                return int(event.start_mark.index)
        return len(self._text) + 1

    def _beside(self) -> str:
        """Return the comment on the line where the last event ends.

        The text is empty if another value comes before the comment.
        """
        last, mark = self._events[self._next - 1], self._end_mark()
        if last.start_mark.index == mark.index:
            return ""  # the parser places an empty value where the next entry begins
        here = [note for note in self._comments if note.line == mark.line and note.index >= mark.index]
        follows = self._events[self._next].start_mark.index if self._next < len(self._events) else -1
        if not here or mark.index < follows < here[0].index:
            return ""
        self._comments.remove(here[0])
        return here[0].text

    def _comments_up_to(self, index: int, line: int, *, first: bool) -> list[str]:
        """Remove the comments before ``index``, and return them with the blank lines around them.

        A blank line before ``line`` also belongs to the result. If the entry is the ``first`` of its block, a
        blank line above the result is omitted.
        """
        comments = [comment for comment in self._comments if comment.index < index]
        self._comments = self._comments[len(comments) :]
        begin = comments[0].line if comments else line
        lines = [] if first else [""] * self._is_blank(begin - 1)
        next_lines = [comment.line for comment in comments[1:]] + [line]
        for comment, following in zip(comments, next_lines, strict=False):
            lines.append(comment.text)
            lines += [""] * (following < len(self._lines) and self._is_blank(following - 1))
        return lines

    def _is_blank(self, line: int) -> bool:
        """Return whether a line of the text is blank."""
        return 0 <= line < len(self._lines) and not self._lines[line].strip()


def laid_out(text: str, file: Path | None = None) -> str:
    """Return ``text`` in the layout, with its meaning unchanged.

    Raise ScenarioError if ``text`` is not a tree.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    original = parse_tree(text, file)
    root, comments = written_tree(text)
    # The order of a space's values decides the order of its parameters, so it has a meaning.
    lines = list(_head(root)) + _block(root, None if is_space(original) else _WHOLE_FILE)
    new = "\n".join(lines).strip("\n") + "\n"
    # The layout must neither change the meaning nor lose a comment.
    if meaning(parse_tree(new, file)) != meaning(original) or written_tree(new)[1] != comments:
        expected = "a file that can be laid out without a change of what it says"
        raise ScenarioError.of_file(file, expected, "one that cannot; it is left as it is")
    return new


def meaning(node: Node) -> object:
    """Return the content of a tree, without its line numbers and without the order of its keys.

    The content includes the order of claims.
    """
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        by_key = {key.text: meaning(value) for key, value in node.entries}
        claims = by_key.get("claims")
        return by_key | ({"claims": list(claims.items())} if isinstance(claims, dict) else {})
    return [meaning(item) for item in node.items]


def _head(root: WrittenValue) -> Iterator[str]:
    """Yield the comments at the top of the file, and remove them from the first entry.

    Comments before a blank line above the first key belong to the file.
    """
    if not root.entries:
        return
    first = root.entries[0]
    if "" in first.above:
        cut = len(first.above) - first.above[::-1].index("")
        yield from first.above[:cut]
        first.above = first.above[cut:]


def _block(value: WrittenValue, kind: Value | None) -> list[str]:
    """Return the lines of a value that stands below its key, without indentation."""
    if value.kind == "scalar":
        return [*value.tail, *_scalar_lines(value, "")]
    if not value.entries:
        return ["[]" if value.kind == "list" else "{}", *value.tail]
    lines: list[str] = []
    if value.kind == "list":
        for entry in value.entries:
            lines += _item(entry, kind)
    else:
        for number, (entry, inner) in enumerate(_ordered(value, kind)):
            blank = ["" for line in entry.above[:1] if not line and number > 0]
            lines += blank + [line for line in _collapsed(entry.above) if line or number > 0][len(blank) :]
            lines += _pair(entry, inner)
    return lines + value.tail


def _collapsed(lines: list[str]) -> list[str]:
    """Return the lines with at most one blank line in a row."""
    return [line for at, line in enumerate(lines) if line or at == 0 or lines[at - 1]]


def _item(entry: LayoutEntry, kind: Value | None) -> list[str]:
    """Return the lines of a list item of the kind ``kind``, with a dash before the first line.

    Comments at the beginning of the item stand above the item.
    """
    kind = kind.of if isinstance(kind, Several) else None
    flow = _flow(entry.value, 2 + len(entry.beside), kind)
    if flow is not None:
        content = [_beside(flow, entry.beside)]
    else:
        content = _block(entry.value, kind)
        if entry.beside:
            content = [entry.beside, *content]
    above = list(entry.above)
    if not any(content):
        return [*_collapsed(above), "-"]  # an item without a value
    while content[0].startswith("#") or not content[0]:
        above.append(content.pop(0))
    return [*_collapsed(above), f"- {content[0]}", *(f"  {line}" if line else "" for line in content[1:])]


def _pair(entry: LayoutEntry, kind: Value | None) -> list[str]:
    """Return the lines of a key with its value."""
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
    below = (f"  {line}" if line else "" for line in _block(value, kind))
    return [*above, _beside(f"{key}:", entry.beside_key), *below]


def _beside(line: str, comment: str) -> str:
    """Return ``line`` with a comment after it."""
    return f"{line}  {comment}" if comment else line


def _flow(value: WrittenValue, used: int, kind: Value | None) -> str | None:
    """Return the value written on one line, or None if it needs several lines.

    A value is on one line if it was on one line before, or if it is a list of numbers.

    Args:
        value: The value.
        used: The columns that its key and its comment use.
        kind: The kind of the value; None: unknown.

    """
    if any(value.tail):
        return None
    if value.kind == "scalar":
        text = _scalar(value)
        return text if not value.raw and not _is_long_prose(value, used) else None
    numbers = value.kind == "list" and all(
        item.value.kind == "scalar" and not item.value.style and _NUMBER.fullmatch(item.value.text)
        for item in value.entries
    )
    if not value.flow and not numbers:
        return None
    parts = []
    for entry, of_entry in _ordered(value, kind if value.kind == "mapping" else None):
        inner = _flow(entry.value, 0, of_entry)
        if inner is None or any((*entry.above, entry.beside_key, entry.beside)):
            return None
        # The space stays before an empty value, because in {x:} the colon would belong to the key.
        parts.append(inner if entry.key is None else f"{_scalar(entry.key)}: {inner}")
    text = f"[{', '.join(parts)}]" if value.kind == "list" else f"{{{', '.join(parts)}}}"
    return text if used + len(text) <= FLOW_WIDTH or not value.entries else None


def _is_long_prose(value: WrittenValue, used: int) -> bool:
    """Return whether a text has more than 20 words and is too long for one line."""
    terms = value.text.split(" ")
    return used + len(value.text) > PROSE_WIDTH and len(terms) > 20 and "\n" not in value.text and all(terms)


def _scalar(value: WrittenValue) -> str:
    """Return a scalar on one line, in quotes only if the scalar needs quotes."""
    return scalar_text(value.text) if value.style or "\n" in value.text else value.text


def _scalar_lines(value: WrittenValue, start: str) -> list[str]:
    """Return the lines of a scalar that may need several lines.

    The text ``start`` precedes the first line.
    """
    if value.raw:
        header, *lines = value.raw
        widths = [len(line) - len(line.lstrip()) for line in lines if line.strip()]
        first = next((line for line in lines if line.strip()), "")
        width = min(widths, default=0)
        regular = widths and len(first) - len(first.lstrip()) == width
        # The layout changes the indentation, so a text whose indentation has a meaning needs quotes.
        if not regular or any(character.isdigit() for character in header.split("#")[0]):
            return [start + scalar_text(value.text.rstrip("\n"))]
        return [start + header[0], *(f"  {line[width:]}" if line[width:] else "" for line in lines)]
    if not _is_long_prose(value, len(start)):
        return [start + _scalar(value)]
    lines = textwrap.wrap(value.text, PROSE_WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return [f"{start}>", *(f"  {line}" for line in lines)]


def _ordered(value: WrittenValue, kind: Value | None) -> list[tuple[LayoutEntry, Value | None]]:
    """Return the entries with their kinds, in the documented order.

    Free keys and items of a list stay in their order.
    """
    if isinstance(kind, FreeKeys):
        return [(entry, kind.of) for entry in value.entries]
    if not isinstance(kind, Below):
        return [(entry, None) for entry in value.entries]
    table = _table_of(kind, {entry.name for entry in value.entries})
    known: dict[str, Value] = {key.name: key.value for key in table.keys}
    names = table.names
    if table is TOP:
        known["matrix"], names = _MATRIX, _FIRST + names
    place = {name: names.index(name) for name in names}
    place |= {key.former: place[key.name] for key in table.keys if key.former}
    ordered = sorted(value.entries, key=lambda item: place.get(item.name, len(names)))
    return [(entry, known.get(entry.name)) for entry in ordered]


def _table_of(kind: Below, keys: set[str]) -> KeyTable:
    """Return the table that describes a mapping with these keys."""
    begun = [table for table in kind.tables if table.told_by in keys]
    return begun[-1] if begun else (kind.tables or (COMPOSED,))[0]
