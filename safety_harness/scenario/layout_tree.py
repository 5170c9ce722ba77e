"""A scenario file with everything that a person sees in it: comments, blank lines, styles."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

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

_HEADER = re.compile(r"[|>][-+0-9]*[ ]+(#.*)")


@dataclass
class Comment:
    """A comment: where it begins in the text, and on which line (from 0) and column."""

    text: str
    index: int
    line: int
    column: int


@dataclass
class WrittenValue:
    """A value as it was written; ``raw`` is the text of a block of prose, its header first."""

    kind: str  # "scalar", "list" or "mapping"
    flow: bool = False
    text: str = ""
    style: str = ""  # of a scalar: "", "'", '"', "|" or ">"
    raw: tuple[str, ...] = ()
    entries: list[LayoutEntry] = field(default_factory=list)
    tail: list[str] = field(default_factory=list)  # comments after the last entry

    @property
    def comments(self) -> int:
        """How many comments are within."""
        own = sum(bool(line) for line in self.tail)
        return own + sum(one.comments + one.value.comments for one in self.entries)


@dataclass
class LayoutEntry:
    """A key with its value, or an item of a list; an empty text in ``before`` is a blank line."""

    key: WrittenValue | None
    value: WrittenValue
    before: list[str] = field(default_factory=list)
    beside_key: str = ""
    beside: str = ""

    @property
    def comments(self) -> int:
        """How many comments it has of its own."""
        return sum(bool(line) for line in self.before) + bool(self.beside_key) + bool(self.beside)


def written_tree(text: str) -> tuple[WrittenValue, int]:
    """The tree of a text that ``parse_tree`` takes, and how many comments there are in the text."""
    events: list[Event] = [
        event
        for event in YAML(typ="safe", pure=True).parse(text)
        if isinstance(event, ScalarEvent | CollectionStartEvent | CollectionEndEvent)
    ]
    comments = list(_comments(text, events))
    builder = _Builder(text, events, list(comments))
    return builder.root(), len(comments)


def _comments(text: str, events: Sequence[Event]) -> Iterator[Comment]:
    """Every # that begins a comment: at the beginning of a word, and not within a scalar."""
    inside = bytearray(len(text) + 1)
    for event in events:
        if isinstance(event, ScalarEvent):
            start, end = event.start_mark.index, event.end_mark.index
            header = _HEADER.match(text, start) if event.style in ("|", ">") else None
            if header is not None:
                yield _comment_at(text, header.start(1))
            inside[start:end] = b"1" * (end - start)
    at = -1
    while (at := text.find("#", at + 1)) >= 0:
        if not inside[at] and (at == 0 or text[at - 1].isspace()):
            yield _comment_at(text, at)
            at = text.find("\n", at) if "\n" in text[at:] else len(text)


def _comment_at(text: str, at: int) -> Comment:
    begin, end = text.rfind("\n", 0, at) + 1, text.find("\n", at)
    words = text[at : end if end >= 0 else len(text)].rstrip()
    return Comment(words, at, text.count("\n", 0, at), at - begin)


class _Builder:
    """Goes through the events once; every comment is given to the entry that it belongs to."""

    def __init__(self, text: str, events: list[Event], comments: list[Comment]) -> None:
        self._text, self._events, self._next = text, events, 0
        self._lines = text.split("\n")
        self._comments = sorted(comments, key=lambda one: one.index)

    def root(self) -> WrittenValue:
        root = self._value()
        if root.kind == "scalar" and self._comments:
            root.tail = [one.text for one in self._comments]
        else:
            root.tail += self._taken(len(self._text) + 1, len(self._lines), first=False)
        return root

    def _value(self) -> WrittenValue:
        event = self._events[self._next]
        self._next += 1
        if isinstance(event, ScalarEvent):
            return self._scalar(event)
        assert isinstance(event, CollectionStartEvent)
        flow = bool(event.flow_style)
        mapping = isinstance(event, MappingStartEvent)
        value = WrittenValue("mapping" if mapping else "list", flow)
        column = event.start_mark.column
        while not isinstance(self._events[self._next], MappingEndEvent | SequenceEndEvent):
            value.entries.append(self._entry(mapping, first=not value.entries))
        end = self._events[self._next]
        self._next += 1
        limit = end.start_mark.index if flow else self._start_of_next()
        deeper = [
            one for one in self._comments if one.index < limit and (flow or one.column >= max(column, 1))
        ]
        if deeper and deeper == self._comments[: len(deeper)]:
            value.tail = self._taken(deeper[-1].index + 1, deeper[-1].line + 1, first=False)
        return value

    def _entry(self, mapping: bool, *, first: bool) -> LayoutEntry:
        start = self._events[self._next].start_mark
        before = self._taken(start.index, start.line, first=first)
        key, beside_key = None, ""
        if mapping:
            key = self._value()
            beside_key = self._beside()
        value = self._value()
        plain = value.flow or (value.kind == "scalar" and not value.raw)
        beside = self._beside() if plain else ""
        if value.raw and self._comments and self._comments[0].index < self._end_mark().index:
            beside = self._comments.pop(0).text  # beside the sign that begins the prose
        return LayoutEntry(key, value, before, beside_key, beside)

    def _end_mark(self) -> StreamMark:
        mark: StreamMark = self._events[self._next - 1].end_mark
        return mark

    def _start_of_next(self) -> int:
        """Where the next thing that is no end of a block begins."""
        for event in self._events[self._next :]:
            if not isinstance(event, CollectionEndEvent):
                return int(event.start_mark.index)
        return len(self._text) + 1

    def _beside(self) -> str:
        """The comment on the line where the last thing ends, after it and before anything else."""
        last, mark = self._events[self._next - 1], self._end_mark()
        if last.start_mark.index == mark.index:
            return ""  # an empty value, which is marked where the next thing begins
        index, line = mark.index, mark.line
        here = [one for one in self._comments if one.line == line and one.index >= index]
        follows = self._events[self._next].start_mark.index if self._next < len(self._events) else None
        if not here or (follows is not None and follows < here[0].index and follows > index):
            return ""
        self._comments.remove(here[0])
        return here[0].text

    def _taken(self, index: int, line: int, *, first: bool) -> list[str]:
        """The comments before ``index``, with the blank lines among and after them up to ``line``."""
        found = [one for one in self._comments if one.index < index]
        self._comments = self._comments[len(found) :]
        begin = found[0].line if found else line
        lines = [] if first else [""] * self._is_blank(begin - 1)
        next_lines = [one.line for one in found[1:]] + [line]
        for one, following in zip(found, next_lines, strict=False):
            lines.append(one.text)
            lines += [""] * (following < len(self._lines) and self._is_blank(following - 1))
        return lines

    def _is_blank(self, line: int) -> bool:
        return 0 <= line < len(self._lines) and not self._lines[line].strip()

    def _scalar(self, event: ScalarEvent) -> WrittenValue:
        style = event.style or ""
        raw: tuple[str, ...] = ()
        if style in ("|", ">"):
            source = self._text[event.start_mark.index : event.end_mark.index]
            raw = tuple(source.rstrip("\n").split("\n"))
        return WrittenValue("scalar", text=event.value, style=style, raw=raw)
