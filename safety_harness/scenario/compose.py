"""Compose scenario files: apply the keys ``extends``, ``without`` and ``matrix`` to the trees of files.

The results are ordinary trees. Every part of a tree still states its original file and line. The number of
files, bytes, combinations and values is limited, and no code in a file is executed.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError, near_miss
from safety_harness.base.shipped.contents import located
from safety_harness.scenario.fields import Field
from safety_harness.scenario.files import ALL, decode, foreign, has_a_key, read_bytes, resolved
from safety_harness.scenario.nodes import TESTED, Mapping, Node, Scalar, Sequence, parse_tree
from safety_harness.scenario.references import avoider_seen_from, seen_from
from safety_harness.scenario.robots import FILES, robot_seen_from
from safety_harness.scenario.units import shown

EXTENDS, WITHOUT, MATRIX, SUITE = "extends", "without", "matrix", "suite"
SPACE_KEY = "scenario space"
COMPOSING = (EXTENDS, WITHOUT, MATRIX)
MAX_BYTES = 1_000_000  # of one file
MOST_BYTES = 20_000_000  # of all the files that one path leads to
LONGEST_CHAIN = 8  # files that extend each other; a choice
MOST_COMBINATIONS = 1_000  # a choice
MOST_VALUES = 300_000  # of all combinations together, so that they are read within seconds

_LABEL = re.compile(r"[\w.+%°-]+(?: [\w.+%°-]+)*")  # it becomes part of a file's name
_LONGEST_LABEL, _LONGEST_NAME = 40, 150
_TITLES = {"scenario", SPACE_KEY}  # a file has one of them
_WHOLE = {"one of", "by", "box", "shell", "in"}  # a distribution replaces another as a whole, not key by key
_Rewrite = Callable[[str], str]


@dataclass
class Library:
    """The files to which a path leads.

    Each file is read only once, and the total size of all files is limited.
    """

    _trees: dict[Path, Node] = field(default_factory=dict)
    _bytes: int = 0

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that was read, with symbolic links resolved."""
        return tuple(self._trees)

    def tree(self, path: Path, place: Place | None = None) -> Node:
        """Return the tree of a file, before composition.

        Args:
            path: The file.
            place: The place at which the file's name is written, for error messages. None means the file
                itself.

        Raises:
            ScenarioError: The file cannot be read, is not a tree, or the files exceed the bound.

        """
        key = resolved(path)
        if key not in self._trees:
            data = read_bytes(path, most=MAX_BYTES, place=place or Place(file=path), error=ScenarioError)
            self._bytes += len(data)
            if self._bytes > MOST_BYTES:
                expected = f"at most {MOST_BYTES:,} bytes"
                raise ScenarioError(place=place or Place(file=path), expected=expected, got="more")
            text = decode(data, most=MAX_BYTES, file=path, error=ScenarioError)
            self._trees[key] = tree_of(text, path, place)
        return self._trees[key]


def tree_of(text: str, file: Path, place: Place | None = None) -> Node:
    """Return the tree of a file's text.

    Raise ScenarioError if the text is malformed or does not belong to the harness. The error quotes the file
    only if the file has a key that belongs to the harness. Otherwise the error states only ``place``.
    """
    try:
        tree = parse_tree(text, file)
    except ScenarioError:
        if has_a_key(text):
            raise
        raise foreign(file, place) from None
    if not isinstance(tree, Mapping) or not _keys(tree) & {*ALL}:
        raise foreign(file, place)
    return tree


def is_space(tree: Node) -> bool:
    """Return whether ``tree`` has the key of a scenario space."""
    return isinstance(tree, Mapping) and SPACE_KEY in _keys(tree)


@dataclass(frozen=True)
class Variant:
    """A scenario of a file: its name, and its tree after composition."""

    name: str
    tree: Node


def variants(path: Path, library: Library) -> tuple[Variant, ...]:
    """Return the scenarios of a file.

    A file with a matrix has one scenario for each combination, and any other file has one scenario. The
    scenario's name becomes part of file names and reports. Raise ScenarioError if the name is too long or not
    printable.
    """
    if not path.stem.isprintable() or len(path.stem.encode()) > _LONGEST_NAME:
        expected = f"a file with a name of printable characters, at most {_LONGEST_NAME} bytes"
        raise ScenarioError.of_file(path, expected, repr(path.stem))
    tree = _extended(path, library, ())
    if not isinstance(tree, Mapping) or MATRIX not in _keys(tree):
        return (Variant(path.stem, tree),)
    matrix = dict(Field(tree, path, path="", line=1).entries("a scenario"))[MATRIX]
    plain = without_keys(tree, {MATRIX})
    results = []
    for combination in itertools.product(*_axes(matrix, plain)):
        name = f"{path.stem}[{','.join(label for label, _ in combination)}]"
        if len(name.encode()) > _LONGEST_NAME:
            raise matrix.error(f"labels that make names of at most {_LONGEST_NAME} bytes", got=shown(name))
        whole: Node = plain
        for _, changes in combination:
            whole = merged(whole, changes)
        results.append(Variant(name, whole))
    return tuple(results)


def only_variant(path: Path, library: Library, expected: str) -> Variant:
    """Return the only scenario of a file.

    Raise ScenarioError if the file has a matrix with several combinations. ``expected`` completes "expected
    ..." of the error.
    """
    results = variants(path, library)
    if len(results) > 1:
        place, got = Place(file=path, field=MATRIX), f"a matrix of {len(results)}"
        raise ScenarioError(place=place, expected=expected, got=got)
    return results[0]


def merged(base: Node, top: Node) -> Node:
    """Return ``base`` after the changes in ``top``.

    Mappings merge key by key. Any other value in ``top`` replaces the value in ``base``.
    """
    if not isinstance(base, Mapping) or not isinstance(top, Mapping) or _WHOLE & (_keys(base) | _keys(top)):
        return top
    changes = {key.text: (key, value) for key, value in top.entries}
    entries = []
    for key, value in base.entries:
        if key.text in changes:
            changed, change = changes.pop(key.text)
            entries.append((changed, merged(value, change)))
        else:
            entries.append((key, value))
    return Mapping((*entries, *changes.values()), top.line, top.file)


def _extended(path: Path, library: Library, chain: tuple[Path, ...], place: Place | None = None) -> Node:
    """Return the tree of a file, merged with the tree of the file that it extends.

    ``chain`` lists the files that led to this file; the last of them extends this file. ``place`` is the
    place at which another file states the name of this file.
    """
    tree = library.tree(path, place)
    if not isinstance(tree, Mapping):
        return tree
    given = dict(Field(tree, path, path="", line=1).entries("a scenario"))
    if EXTENDS not in given:
        if WITHOUT in given:
            raise given[WITHOUT].error(f'the key "{EXTENDS}" beside it', got=f'"{WITHOUT}" alone')
        return tree
    extends = given[EXTENDS]
    base_path = located(path.parent / extends.sentence("the file that this one extends"), extends.place)
    here = (*chain, path)
    if resolved(base_path) in [resolved(file) for file in here]:
        circle = " extends ".join(file.name for file in (*here, base_path))
        raise extends.error("files that do not extend each other in a circle", got=circle)
    if len(here) >= LONGEST_CHAIN:
        raise extends.error(f"a chain of at most {LONGEST_CHAIN} files", got="a longer one")
    base = _extended(base_path, library, here, extends.place)
    if not isinstance(base, Mapping) or SUITE in _keys(base):
        raise extends.error("a scenario file", got=f"{base_path}, which is none")
    # A file name is relative to the folder of the file that states it.
    if resolved(base_path.parent) != resolved(path.parent):
        base = _moved(base, base_path.parent, path.parent)
    assert isinstance(base, Mapping)
    if WITHOUT in given:
        base = _reduced(base, given[WITHOUT])
    own = without_keys(tree, {EXTENDS, WITHOUT})
    # A scenario may extend a space and the other way round, so its own title replaces both titles of the
    # base.
    if _TITLES & _keys(own):
        base = without_keys(base, _TITLES - _keys(own))
    return merged(base, own)


def _reduced(base: Mapping, without: Field) -> Mapping:
    """Return ``base`` without the keys and claims that ``without`` lists."""
    claims = next((value for key, value in base.entries if key.text == "claims"), None)
    sentences = _keys(claims) if isinstance(claims, Mapping) else set()
    dropped = set()
    for item in without.items("a list of keys and claims of the file that is extended", least=1):
        name = item.scalar("a key or a claim of the file that is extended")
        if name not in _keys(base) | sentences:
            hint = near_miss(name, _keys(base) | sentences)
            raise item.error("a key or a claim of the file that is extended", hint=hint)
        dropped.add(name)
    left = without_keys(base, dropped).entries
    if isinstance(claims, Mapping):
        fewer = without_keys(claims, dropped)
        left = tuple((key, fewer if value is claims else value) for key, value in left)
    return replace(base, entries=left)


def _axes(matrix: Field, plain: Mapping) -> list[list[tuple[str, Node]]]:
    """Return, for each axis of ``matrix``, the labels and the changes that each label makes.

    Raise ScenarioError if an axis or a label is not allowed.
    """
    expected = "a mapping of axes, each a mapping of labels and what they change"
    axes: list[list[tuple[str, Node]]] = []
    changed_by: dict[tuple[str, ...], str] = {}
    for axis, below in matrix.entries(expected):
        labels = below.entries("a mapping of labels and what they change")
        if not labels:
            raise below.error("at least one label")
        changes = {path for label, change in labels for path in _changes(_checked(label, change).node)}
        for path in sorted(changes):
            for earlier, earlier_axis in changed_by.items():
                # Equal up to the shorter path: one axis changes a value that contains the other axis' value.
                if path[: len(earlier)] == earlier[: len(path)]:
                    raise below.error(
                        f'axes that change different values; "{earlier_axis}" changes {".".join(earlier)}',
                        got=f'"{axis}", which changes {".".join(path)}',
                    )
        changed_by.update(dict.fromkeys(changes, axis))
        axes.append([(label, change.node) for label, change in labels])
    if not axes:
        raise matrix.error(expected)
    # Check the sizes before the combinations are made.
    count = math.prod(map(len, axes))
    if count > MOST_COMBINATIONS:
        raise matrix.error(f"at most {MOST_COMBINATIONS:,} combinations", got=f"{count:,}")
    largest = _size(plain) + sum(max(_size(change) for _, change in axis) for axis in axes)
    if count * largest > MOST_VALUES:
        raise matrix.error(f"at most {MOST_VALUES:,} values in all combinations", got="more")
    return axes


def _checked(label: str, change: Field) -> Field:
    """Return the change that a label stands for.

    Raise ScenarioError if the label or a key is not allowed.
    """
    if not _LABEL.fullmatch(label) or len(label) > _LONGEST_LABEL:
        expected = f"a label of at most {_LONGEST_LABEL} letters, digits, spaces and . + - % _"
        raise change.error(expected, got=shown(label))
    if not isinstance(change.node, Mapping):
        raise change.error("a mapping of the changes, {} for no change")
    for key, field_ in change.entries("a mapping"):
        if key in (*COMPOSING, SUITE):
            raise field_.error("keys of a scenario", got=f'the key "{key}" within a matrix')
    return change


def _changes(node: Node) -> Iterator[tuple[str, ...]]:
    """Yield the paths of the values that the changes in ``node`` set."""
    assert isinstance(node, Mapping)
    for key, value in node.entries:
        if isinstance(value, Mapping) and value.entries and not _WHOLE & _keys(value):
            yield from ((key.text, *path) for path in _changes(value))
        else:
            yield (key.text,)


def _moved(node: Node, folder: Path, target: Path) -> Node:
    """Return ``node`` with new paths in place of its file names.

    The old paths are relative to ``folder``, and the new paths are relative to ``target``.
    """
    rewrites: dict[str, _Rewrite] = {
        **{key: lambda text: avoider_seen_from(target, text, folder) for key in TESTED},
        "recording": lambda text: seen_from(target, text, folder),
        **{key: lambda text: robot_seen_from(target, text, folder) for key in ("robot", "arm")},
        **{key: lambda text: seen_from(target, text, folder) for key in FILES},
    }
    return rewritten(node, rewrites)


def rewritten(node: Node, rewrites: dict[str, _Rewrite], rewrite: _Rewrite | None = None) -> Node:
    """Return the tree ``node`` after changing the texts below certain keys.

    Args:
        node: The tree.
        rewrites: The function that rewrites the texts below each key.
        rewrite: The function that rewrites the texts of this node, which belongs to the key above; None: no
            change.

    """
    if isinstance(node, Scalar):
        if rewrite is None or not node.text:
            return node
        first, options = ("one of ", node.text[7:]) if node.text.startswith("one of ") else ("", node.text)
        parts = options.split(", ") if first else [options]
        return replace(node, text=first + ", ".join(map(rewrite, parts)))
    if isinstance(node, Sequence):
        return replace(node, items=tuple(rewritten(item, rewrites, rewrite) for item in node.items))
    entries = []
    for key, value in node.entries:
        listed = key.text in FILES and isinstance(value, Sequence)  # capsules of a tool, and no file of them
        entries.append((key, rewritten(value, rewrites, None if listed else rewrites.get(key.text, rewrite))))
    return replace(node, entries=tuple(entries))


def _keys(mapping: Mapping) -> set[str]:
    """Return the keys of a mapping."""
    return {key.text for key, _ in mapping.entries}


def without_keys(mapping: Mapping, keys: set[str]) -> Mapping:
    """Return the mapping without some of its entries."""
    return replace(mapping, entries=tuple(entry for entry in mapping.entries if entry[0].text not in keys))


def _size(node: Node) -> int:
    """Return the number of values in a tree."""
    if isinstance(node, Scalar):
        return 1
    below = node.items if isinstance(node, Sequence) else tuple(value for _, value in node.entries)
    return 1 + sum(map(_size, below))
