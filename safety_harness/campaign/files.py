"""The files that a plan is made of: enough to read it again elsewhere, or after its own have changed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from safety_harness.exceptions import OutputError, Place, ScenarioError
from safety_harness.scenario.compose import Library
from safety_harness.scenario.files import read_bytes, resolved
from safety_harness.scenario.nodes import Mapping, Node, Scalar
from safety_harness.scenario.references import file_and_name
from safety_harness.space.space import ScenarioSpace

MOST_BYTES = 200_000_000  # of all files together
REFERRING = ("avoider", "recording")


@dataclass(frozen=True)
class PlanFile:
    """One file: its name relative to the folder that all of them are in, and its bytes."""

    name: str
    data: bytes = field(repr=False)

    @property
    def sha256(self) -> str:
        """Of the bytes."""
        return hashlib.sha256(self.data).hexdigest()


def files_of_plan(
    plan: Path, library: Library, spaces: Sequence[ScenarioSpace], avoider: str | None
) -> tuple[PlanFile, ...]:
    """The plan's own file first, then its spaces, what they extend, recordings, avoiders and models.

    What an avoider of the user's own imports or opens besides is not known here.
    """
    found = dict.fromkeys([plan.resolve(), *library.files])
    for space in spaces:
        folder = space.file.parent if space.file else Path()
        found.update(dict.fromkeys(_named_in(space.tree, folder)))
    if avoider is not None:
        found.update(dict.fromkeys(_existing([file_and_name(avoider)[0]], plan.parent)))
    root = Path(os.path.commonpath([path.parent for path in found]))
    files, size = [], 0
    for path in found:
        data = read_bytes(path, most=MOST_BYTES, place=Place(file=path), error=ScenarioError)
        size += len(data)
        if size > MOST_BYTES:
            raise ScenarioError(
                place=Place(file=plan), expected=f"at most {MOST_BYTES:,} bytes of files", got="more"
            )
        files.append(PlanFile(path.relative_to(root).as_posix(), data))
    return tuple(files)


def unpacked(files: Iterable[PlanFile], folder: Path) -> Path:
    """Write the files below ``folder``; the path of the first of them, the plan's own.

    LedgerError-like refusal of names that lead elsewhere is the reader's matter: names are checked here too.
    """
    first: Path | None = None
    for file in files:
        path = (folder / file.name).resolve()
        if folder.resolve() not in path.parents:
            raise ScenarioError(
                place=Place(file=Path(file.name)), expected="a file below the plan's folder", got="another"
            )
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.data)
        except OSError as error:
            raise OutputError.of(path, error) from error
        first = first or path
    assert first is not None
    return first


def references_in(node: Node, keys: tuple[str, ...] = REFERRING, *, within: bool = False) -> Iterator[str]:
    """What a space says below ``keys``: plain values, and their alternatives.

    No other text names a file: a hand that is called ``/etc/passwd`` brings that file into no ledger.
    """
    if isinstance(node, Scalar):
        text = node.text
        if within:
            yield from text[7:].split(", ") if text.startswith("one of ") else [text]
    elif isinstance(node, Mapping):
        for key, value in node.entries:
            if key.text != "chances":
                yield from references_in(value, keys, within=within or key.text in keys)
    else:
        for item in node.items:
            yield from references_in(item, keys, within=within)


def _named_in(tree: Node, folder: Path) -> Iterator[Path]:
    avoiders = (file_and_name(text)[0] for text in references_in(tree, ("avoider",)))
    return _existing((*avoiders, *references_in(tree, ("recording",))), folder)


def _existing(references: Iterable[str], folder: Path) -> Iterator[Path]:
    for file in references:
        try:
            path = resolved(folder / os.path.expanduser(file))
            if file and path.is_file():
                yield path
        except (OSError, ValueError):  # too long for a name, or no name at all
            continue
