"""Find out which YAML files in a folder belong to the harness.

All commands and the pytest plug-in use the same rules. Other programs also have files with the keys
``scenario:``, ``suite:`` or ``claims:``. A scenario file belongs to the harness if it has a key that only the
harness uses, or if it extends such a file. A suite belongs to the harness if it lists such a file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.base.shipped.contents import PREFIX, located
from safety_harness.scenario.files import TITLES, display_path, resolved
from safety_harness.scenario.kinds import HEAD_BYTES, SUFFIXES, FileKind, kind_of
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar, Sequence, parse_tree

# Folders that pytest does not enter by default either.
NOT_ENTERED = (".*", "*.egg", "build", "CVS", "dist", "node_modules", "venv", "__pycache__")
_ALONE = {"scenario space", "tcp start", "hand sensor"}  # ours alone, whatever is beside them
_TITLED = {"avoider", "hands"}  # ours alone beside a title
_SHARED = (FileKind.SCENARIO, FileKind.SPACE, FileKind.SUITE)  # by a title of other programs as well
_FOREIGN = {"plan", "proof", "log"}  # titles of other kinds of our files
_WORTH = re.compile(r"\b(?:scenario|suite|extends|claims|tcp start|hand sensor)\b", re.IGNORECASE)
_LINE = re.compile(r"^[\"']?([A-Za-z ]+?)[\"']?[ \t]*:(?=[ \t\r\n]|$)", re.MULTILINE)
_VERDICTS = ("holds", "violated", "inconclusive")  # those of the enum Verdict, which is slow to import
Entries = Mapping[str, Node | None]


def is_ours(path: Path, known: dict[Path, bool] | None = None) -> bool:
    """Return whether a file is a scenario, a space or a suite of the harness, even if it has mistakes.

    The function never raises. ``known`` contains the results for files that were examined before. Files that
    refer to each other in a circle count as files of the harness.
    """
    known = {} if known is None else known
    key = resolved(path)
    if key not in known:
        known[key] = True
        known[key] = _is_ours(path, known)
    return known[key]


def is_titled(path: Path) -> bool:
    """Return whether a file has a title of a scenario or a suite, which other programs also use."""
    return _has_title(_entries(path))


def yaml_files(folder: Path) -> Iterator[Path]:
    """Yield every YAML file below ``folder``, sorted by name.

    The function skips subfolders that pytest would not enter.
    """
    for at, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if _is_entered(Path(at, name)))
        yield from (Path(at, name) for name in sorted(files) if Path(name).suffix.lower() in SUFFIXES)


def files_of(
    path: Path, wanted: tuple[FileKind, ...], place: Place | None = None
) -> tuple[list[Path], list[Path]]:
    """Return two lists: the files of ``path`` that are of a wanted kind, and the other files of ``path``.

    If ``path`` is a file, it is the only wanted file. If ``path`` is a folder, the function examines its
    files and the files in its subfolders. If no file is of a wanted kind, the first list contains all files.
    Then the function that reads these files reports their kind.

    Args:
        path: A file or a folder. A name of the form ``shipped:NAME`` is also accepted.
        wanted: The kinds to return.
        place: The place at which the path is written, for the error. None means the folder itself.

    Raises:
        ScenarioError: A folder has no YAML file.

    """
    path = located(path, place)
    if not path.is_dir():
        return [path], []
    files, known = [*yaml_files(path)], dict[Path, bool]()
    if not files:
        expected = "a folder with scenario files (*.yaml)"
        got = f"none in {path}" if place else "none in it"
        raise ScenarioError(place=place or Place(file=path), expected=expected, got=got)
    accepted = [file for file in files if _is_wanted(file, wanted, known)] or files
    return accepted, [file for file in files if file not in accepted]


def _is_wanted(file: Path, wanted: tuple[FileKind, ...], known: dict[Path, bool]) -> bool:
    """Return whether a file in a folder belongs to the harness and is of a wanted kind."""
    kind = kind_of(file)
    if kind is FileKind.PLAN:
        return kind in wanted
    return (kind is None or kind in wanted) and is_ours(file, known)


def aside_lines(files: Iterable[Path]) -> list[str]:
    """Return one line for each kind of file that a command skipped in folders.

    The line lists the names of these files.
    """
    by_kind: dict[str, list[str]] = {}
    for file in files:
        kind = kind_of(file)
        noun = "not ours" if kind is None or (kind in _SHARED and not is_ours(file)) else kind.words
        by_kind.setdefault(noun, []).append(str(display_path(file)))
    return [f"left aside, {noun}: {', '.join(names)}" for noun, names in by_kind.items()]


def _is_entered(folder: Path) -> bool:
    """Return whether pytest would enter a folder."""
    return not any(fnmatch(folder.name, pat) for pat in NOT_ENTERED) and not (folder / "pyvenv.cfg").exists()


def _has_title(entries: Entries) -> bool:
    """Return whether a key at the top of a file is a title.

    The value of a title must be a text on one line. If the file cannot be parsed, any title is sufficient.
    """
    titles = [node for key, node in entries.items() if key.lower() in TITLES]
    return any(node is None or (isinstance(node, Scalar) and bool(node.text)) for node in titles)


def _is_ours(path: Path, known: dict[Path, bool]) -> bool:
    """Return whether a file belongs to the harness.

    The function examines the file even if ``known`` contains a result for it.
    """
    entries = _entries(path)
    if _FOREIGN & {*entries}:
        return False
    titled = _has_title(entries)
    if {*entries} & (_ALONE | (_TITLED if titled else set())) or _has_verdicts(entries.get("claims")):
        return True
    base, several = entries.get("extends"), entries.get("scenarios")
    if isinstance(base, Scalar) and base.text:
        there = path.parent / base.text
        missing = titled and there.suffix.lower() in SUFFIXES and not os.path.lexists(there)
        return missing or _leads_to_ours(path, base.text, known)
    items = several.items if isinstance(several, Sequence) and "suite" in entries else ()
    return any(_leads_to_ours(path, item.text, known) for item in items if isinstance(item, Scalar))


def _has_verdicts(claims: Node | None) -> bool:
    """Return whether the value of any claim in ``claims`` begins with one of the harness's verdicts."""
    values = [node for _, node in claims.entries] if isinstance(claims, MappingNode) else []
    return any(isinstance(value, Scalar) and value.text.startswith(_VERDICTS) for value in values)


def _leads_to_ours(path: Path, text: str, known: dict[Path, bool]) -> bool:
    """Return whether the path ``text`` in the file ``path`` leads to a file of the harness."""
    there = path.parent / text
    if text.startswith(PREFIX):
        return True
    return any(is_ours(file, known) for file in (yaml_files(there) if os.path.isdir(there) else [there]))


def _entries(path: Path) -> Entries:
    """Return the keys at the top of a file with their values.

    If the text cannot be parsed, all values are None. If the text contains no key of the harness, the result
    is empty.
    """
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
