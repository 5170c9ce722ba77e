"""Which YAML files of a folder are ours: one answer for every command and for pytest.

Other programs have files with a ``scenario:``, a ``suite:`` or ``claims:`` too.  A scenario is ours if it has
a key that only we have, or extends one of ours; a suite is ours if it names a file of ours.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.base.shipped.contents import PREFIX, located
from safety_harness.scenario.files import TITLES, resolved, told
from safety_harness.scenario.kinds import HEAD_BYTES, SUFFIXES, FileKind, kind_of
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar, Sequence, parse_tree

# What pytest does not enter either, by its own default.
NOT_ENTERED = (".*", "*.egg", "build", "CVS", "dist", "node_modules", "venv", "__pycache__")
_ALONE = {"scenario space", "tcp start", "hand sensor"}  # nobody else's, whatever is beside them
_TITLED = {"avoider", "hands"}  # nobody else's beside a title
_TOLD = (FileKind.SCENARIO, FileKind.SPACE, FileKind.SUITE)  # by a title that others have as well
_OTHERS = {"plan", "proof", "log"}  # titles of ours that begin something else
_WORTH = re.compile(r"\b(?:scenario|suite|extends|claims|tcp start|hand sensor)\b", re.IGNORECASE)
_LINE = re.compile(r"^[\"']?([A-Za-z ]+?)[\"']?[ \t]*:(?=[ \t\r\n]|$)", re.MULTILINE)
_VERDICTS = ("holds", "violated", "inconclusive")  # of the enum, which takes long to import
Entries = Mapping[str, Node | None]


def is_ours(path: Path, known: dict[Path, bool] | None = None) -> bool:
    """Is a file a scenario, a space or a suite of ours, also one with mistakes?  Never raises.

    ``known`` are answers so far; files that lead to each other in a circle are ours.
    """
    known = {} if known is None else known
    key = resolved(path)
    if key not in known:
        known[key] = True
        known[key] = _is_ours(path, known)
    return known[key]


def is_titled(path: Path) -> bool:
    """Has a file the title of a scenario or a suite, as other programs have it too?"""
    return _has_title(_entries(path))


def yaml_files(folder: Path) -> Iterator[Path]:
    """Every YAML file below ``folder`` in the order of its names, in the subfolders that pytest enters."""
    for at, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if _is_entered(Path(at, name)))
        yield from (Path(at, name) for name in sorted(files) if Path(name).suffix.lower() in SUFFIXES)


def files_of(
    path: Path, wanted: tuple[FileKind, ...], place: Place | None = None
) -> tuple[list[Path], list[Path]]:
    """A file as it is; of a folder, also of subfolders, the ``wanted`` files of ours, and those left aside.

    If none is wanted, all are given, so that whoever reads them says what they are.  ``shipped:NAME`` stands
    for either.  ScenarioError, at ``place``, for a folder without a YAML file.
    """
    path = located(path, place)
    if not path.is_dir():
        return [path], []
    found, known = [*yaml_files(path)], dict[Path, bool]()
    if not found:
        expected = "a folder with scenario files (*.yaml)"
        got = f"none in {path}" if place else "none in it"
        raise ScenarioError(place=place or Place(file=path), expected=expected, got=got)
    taken = [file for file in found if _is_wanted(file, wanted, known)] or found
    return taken, [file for file in found if file not in taken]


def _is_wanted(file: Path, wanted: tuple[FileKind, ...], known: dict[Path, bool]) -> bool:
    kind = kind_of(file)
    if kind is FileKind.PLAN:
        return kind in wanted
    return (kind is None or kind in wanted) and is_ours(file, known)


def aside_lines(files: Iterable[Path]) -> list[str]:
    """What a command left aside in folders, a line for each kind."""
    by_kind: dict[str, list[str]] = {}
    for file in files:
        kind = kind_of(file)
        words = "not ours" if kind is None or (kind in _TOLD and not is_ours(file)) else kind.words
        by_kind.setdefault(words, []).append(str(told(file)))
    return [f"left aside, {words}: {', '.join(names)}" for words, names in by_kind.items()]


def _is_entered(folder: Path) -> bool:
    return not any(fnmatch(folder.name, one) for one in NOT_ENTERED) and not (folder / "pyvenv.cfg").exists()


def _has_title(found: Entries) -> bool:
    """A title has a text on its line; that of a text that cannot be parsed may have."""
    titles = [node for key, node in found.items() if key.lower() in TITLES]
    return any(node is None or (isinstance(node, Scalar) and bool(node.text)) for node in titles)


def _is_ours(path: Path, known: dict[Path, bool]) -> bool:
    found = _entries(path)
    if _OTHERS & {*found}:
        return False
    titled = _has_title(found)
    if {*found} & (_ALONE | (_TITLED if titled else set())) or _has_verdicts(found.get("claims")):
        return True
    base, several = found.get("extends"), found.get("scenarios")
    if isinstance(base, Scalar) and base.text:
        there = path.parent / base.text
        missing = titled and there.suffix.lower() in SUFFIXES and not os.path.lexists(there)
        return missing or _leads_to_ours(path, base.text, known)
    items = several.items if isinstance(several, Sequence) and "suite" in found else ()
    return any(_leads_to_ours(path, one.text, known) for one in items if isinstance(one, Scalar))


def _has_verdicts(claims: Node | None) -> bool:
    values = [value for _, value in claims.entries] if isinstance(claims, MappingNode) else []
    return any(isinstance(one, Scalar) and one.text.startswith(_VERDICTS) for one in values)


def _leads_to_ours(path: Path, text: str, known: dict[Path, bool]) -> bool:
    there = path.parent / text
    if text.startswith(PREFIX):
        return True
    return any(is_ours(one, known) for one in (yaml_files(there) if os.path.isdir(there) else [there]))


def _entries(path: Path) -> Entries:
    """The keys at the top of a file with their values; None for those of a text that cannot be parsed."""
    try:
        if not path.is_file():
            return {}
        with path.open("rb") as file:
            text = file.read(HEAD_BYTES).decode("utf-8", "replace").removeprefix("\ufeff")
    except (OSError, ValueError):
        return {}
    if not _WORTH.search(text):
        return {}
    try:
        tree = parse_tree(text, None)
    except ScenarioError:
        return dict.fromkeys(_LINE.findall(text))
    return {key.text: value for key, value in tree.entries} if isinstance(tree, MappingNode) else {}
