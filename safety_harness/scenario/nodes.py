"""The text of a scenario file as a tree whose parts know their file and line.

The YAML 1.2 parser only produces events. The reader refuses features that the small language does not need,
and states their names in the error.

These features are tags, anchors and aliases, several documents in a file, tabs, and deep nesting. These are
tags, anchors and aliases, several documents, tabs, and deep nesting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionStartEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from safety_harness.base.exceptions import Place, ScenarioError

_MAX_DEPTH = 16  # the language itself needs six
_MOST_NODES = 20_000  # in one file; reading that many takes a second or two


@dataclass(frozen=True)
class Scalar:
    """A single value, given by its text without quotes and folding.

    In a drawn scenario, ``drawn`` is a number with its unit, which replaces the text.
    """

    text: str
    line: int
    file: Path | None = field(default=None, compare=False, repr=False)
    drawn: tuple[float, str] | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class Sequence:
    """A list."""

    items: tuple[Node, ...]
    line: int
    file: Path | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class Mapping:
    """Keys and values in the order of the file.

    The reader refuses a duplicate key.
    """

    entries: tuple[tuple[Scalar, Node], ...]
    line: int
    file: Path | None = field(default=None, compare=False, repr=False)


Node = Scalar | Sequence | Mapping


@lru_cache(maxsize=128)  # a trace is read several times, a space with each of its plans
def parse_tree(text: str, file: Path | None) -> Node:
    """Return the tree of a YAML text with exactly one document.

    Args:
        text: The text.
        file: The file that contains the text, for error messages. None means that there is no file.

    Raises:
        ScenarioError: The text is malformed, or it uses a feature outside the language.

    """
    if "\t" in text:
        line = text.count("\n", 0, text.index("\t")) + 1
        hint = "a scenario file has no tabs, neither to indent nor within a line"
        raise _error(file, line, "spaces", "a tab", hint=hint)
    events = _events(text, file)
    root: Node | None = None
    for event in events:
        if isinstance(event, DocumentStartEvent):
            if root is not None:
                raise _error(file, _line(event), "one document", "a second one")
            root = _Builder(events, file).node(next(events), path="", depth=0)
    if root is None or (isinstance(root, Scalar) and not root.text):
        raise _error(file, 1, "a scenario", "an empty file")
    return root


def join(path: str, key: str) -> str:
    """Return the path of the key ``key`` in the mapping at ``path``.

    An example of a path is ``tcp start.offset``. The result is always printable.
    """
    if not key.isprintable():
        key = "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in key)
    return f"{path}.{key}" if path else key


@dataclass
class _Builder:
    """A builder of nodes from the parser's events.

    In its methods, ``path`` is the name of the current field.
    """

    events: Iterator[Event]
    file: Path | None
    nodes: int = 0

    def node(self, event: Event, *, path: str, depth: int) -> Node:
        """Return the node that begins with ``event``."""
        self.nodes += 1
        if self.nodes > _MOST_NODES:
            expected = f"at most {_MOST_NODES:,} keys and values in a file"
            raise _error(self.file, _line(event), expected, "more", path)
        self._refuse_what_has_no_use(event, path, depth)
        line = _line(event)
        if isinstance(event, SequenceStartEvent):
            return Sequence(tuple(self._items(path, depth + 1)), line, self.file)
        if isinstance(event, MappingStartEvent):
            return Mapping(tuple(self._entries(path, depth + 1)), line, self.file)
        assert isinstance(event, ScalarEvent)
        # In a block text (| or >), the last line break belongs to the notation, not to the text.
        text = event.value.rstrip("\n") if event.style in ("|", ">") else event.value
        return Scalar(text, line, self.file)

    def _items(self, path: str, depth: int) -> Iterator[Node]:
        """Yield the items of a list."""
        index = 0
        while not isinstance(event := next(self.events), SequenceEndEvent):
            yield self.node(event, path=f"{path}[{index}]", depth=depth)
            index += 1

    def _entries(self, path: str, depth: int) -> Iterator[tuple[Scalar, Node]]:
        """Yield the keys and values of a mapping.

        Raise ScenarioError if a key occurs twice.
        """
        first_line: dict[str, int] = {}
        while not isinstance(event := next(self.events), MappingEndEvent):
            key = self.node(event, path=path, depth=depth)
            if not isinstance(key, Scalar):
                got = "a list or a mapping as a key"
                raise _error(self.file, key.line, "a key of plain words", got, path)
            below = join(path, key.text)
            if key.text in first_line:
                got = f'"{key.text}" a second time (first on line {first_line[key.text]})'
                raise _error(self.file, key.line, "each key once", got, below)
            first_line[key.text] = key.line
            value = self.node(next(self.events), path=below, depth=depth)
            if isinstance(value, Scalar) and not value.text:
                value = Scalar("", key.line, self.file)  # the parser notices a missing value only lines later
            yield key, value

    def _refuse_what_has_no_use(self, event: Event, path: str, depth: int) -> None:
        """Raise ScenarioError for an alias, an anchor, a tag, or a nesting that is too deep."""
        line = _line(event)
        if isinstance(event, AliasEvent):
            raise _error(self.file, line, "the value itself", f"the alias *{event.anchor}", path)
        assert isinstance(event, ScalarEvent | CollectionStartEvent)
        if event.anchor is not None:
            raise _error(self.file, line, "a value without an anchor", f"the anchor &{event.anchor}", path)
        if event.tag is not None:
            raise _error(self.file, line, "a value without a tag", f"the tag {event.tag}", path)
        if depth > _MAX_DEPTH:
            raise _error(self.file, line, f"at most {_MAX_DEPTH} levels", "a deeper nesting", path)


def _events(text: str, file: Path | None) -> Iterator[Event]:
    """Yield the parser's events.

    Any exception of the parser becomes a ScenarioError with the line.
    """
    try:
        yield from YAML(typ="safe", pure=True).parse(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark is not None else None
        raise _syntax_error(file, line, error.problem or str(error)) from error
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise _syntax_error(file, line, f"the character U+{error.character:04X}") from error
    except Exception as error:  # such as an escape beyond the last code point
        raise _syntax_error(file, None, str(error)) from error


def _syntax_error(file: Path | None, line: int | None, problem: str) -> ScenarioError:
    """Return the error for malformed YAML, with a hint on the usual mistake."""
    hint = 'a text with ": " or " #" in it, or one that begins with a sign such as % or @, needs quotes'
    if problem.startswith(_MISPLACED):  # what the parser found is a sign of its own, such as "?"
        problem = "a line that does not continue the lines above"
        hint = f'indent it as its neighbours, and begin all or none of them with "- "; or {hint}'
    got = f"a syntax error: {' '.join(problem.split())}"
    return _error(file, line, "well-formed YAML", got, hint=hint)


_MISPLACED = ("expected <block end>", "mapping values are not allowed", "did not find expected")


def _error(
    file: Path | None, line: int | None, expected: str, got: str, path: str = "", hint: str = ""
) -> ScenarioError:
    """Return the error for a place in a file."""
    place = Place(file=file, line=line, field=path or None)
    return ScenarioError(place=place, expected=expected, got=got, hint=hint)


def _line(event: Event) -> int:
    """Return the line of an event, from 1."""
    return int(event.start_mark.line) + 1


TESTED = ("avoider", "controller", "safety filter", "predictor")  # keys whose values name parts under test
REFERRING = (*TESTED, "recording")  # keys whose values name files


def references_in(node: Node, keys: tuple[str, ...] = REFERRING, *, inside: bool = False) -> Iterator[str]:
    """Yield each text of a space that may be a file name.

    Only texts below one of the ``keys`` may be file names. Such texts are plain values and alternatives.
    Texts below other keys are never file names. For example, a hand with the name ``/etc/passwd`` therefore
    adds no file to a ledger.
    """
    if isinstance(node, Scalar):
        text = node.text
        if inside:
            yield from text[7:].split(", ") if text.startswith("one of ") else [text]
    elif isinstance(node, Mapping):
        for key, value in node.entries:
            if key.text != "chances":
                yield from references_in(value, keys, inside=inside or key.text in keys)
    else:
        for item in node.items:
            yield from references_in(item, keys, inside=inside)
