"""Determine the kind of a file from its content, and the command for files of that kind.

Commands use this module for messages about a file of the wrong kind.
"""

from __future__ import annotations

import ast
import os
import re
import shlex
import warnings
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safety_harness.base.distribution import DISTRIBUTION
from safety_harness.base.exceptions import InputError, MissingPackageError, Place, ScenarioError
from safety_harness.base.extension_points import OWN_TITLES, ExtensionPoint, InputFile, input_files, parts
from safety_harness.scenario.files import TITLES, TOP_KEY

if TYPE_CHECKING:  # the model is slow to import, and pytest loads this file in every project
    from safety_harness.scenario.model import Claim

SUFFIXES = (".yaml", ".yml")
HEAD_BYTES = 1_000_000  # of a file, the largest size of a scenario
TAIL_BYTES = 100_000  # of a ZIP file, which has the names of its members at its end
MOST_ENTRIES = 100  # of a folder
_LOG = re.compile(r"^log:(?=[ \t\r\n]|$)", re.MULTILINE), re.compile(r"^(claims|clock|robot):", re.MULTILINE)
_FORMAT = re.compile(r'"(?:format|schema)": ?"safety-harness ([a-z ]+) \d+"')
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


class FileKind(Enum):
    """A kind of file or folder.

    Each kind has a noun with an article for messages, and the command that accepts it. ``names`` are titles
    for YAML files, and formats for JSON files; a file is of this kind if it has one of these titles or
    formats.
    """

    SCENARIO = "a scenario", "safety-harness run {file}", "scenario"
    SPACE = (
        "a scenario space",
        "safety-harness fuzz {file}, or sample {file} for scenarios that run takes",
        "scenario space",
    )
    SUITE = "a suite of scenarios", "safety-harness run {file}", "suite"
    PLAN = "a plan", "safety-harness certify {file}, or campaign run {file} for its runs alone", "plan"
    PROOF = "a plan of proofs", "safety-harness prove {file}", "proof"
    LOG = "the log of a cell", "safety-harness judge {file}", "log"
    TRACE = "a trace", "safety-harness replay {file}, or judge {file}"
    LEDGER = "the ledger of a campaign", "safety-harness campaign status {file}"
    MODEL = "a model", "safety-harness evaluate {file}, or run FILE --avoider {file}"
    ONNX = "a model in ONNX", "safety-harness evaluate {file}, or run FILE --avoider {file}"
    TORCH = (
        "a model of PyTorch",
        'torch.onnx.export(model, example, "{onnx}", external_data=False), then --avoider {onnx} '
        "(safety-harness docs reference/onnx)",
    )
    PYTHON = "a Python file", "safety-harness evaluate {file}:{name}, or run FILE --avoider {file}:{name}"
    PAGE = "a page for a browser", "open it there"
    RUNS = "the figures of runs", "", "report"
    EVIDENCE = "a part of an evidence report", "safety-harness verify {folder}", "evidence", "manifest"
    SCORES = "the figures of an evaluation", "its page is {folder}/evaluation.html", "scores"
    SELFTEST = "the figures of a selftest", "safety-harness certify PLAN --selftest {file}", "selftest"
    DECLARATION = "the declaration of a plan", "safety-harness verify REPORT --declared {file}", "declaration"
    SEAL = "the seal of a report", "safety-harness verify REPORT --seal {file}", "seal"
    CERTIFICATE = "the certificate of a proof", "safety-harness prove --check {file}", "certificate"
    CELL = "a recorded cell beside the worlds", "safety-harness certify PLAN --cell {file}", "recorded cell"
    TIMES = (
        "measured decision times",
        "a scenario draws from them: safety-harness explain decision time",
        "decision times",
    )
    TABLE = "a table", "a recorded motion is named by a scenario: safety-harness explain recording"
    REPORT = "the folder of an evidence report", "safety-harness verify {file}"
    DATASET = "the folder of a data set", "safety-harness train mc-dropout --data {file}"
    RUN_FOLDER = "the folder of a run", "safety-harness judge {file}/traces/*.trace"
    FOLDER = "a folder", ""
    EMPTY = "an empty file", "safety-harness new OTHER.yaml writes a scenario to start from"
    BINARY = "a binary file", ""

    def __init__(self, noun: str, command: str, *names: str) -> None:
        self.words, self.command, self.names = noun, command, names


Kind = FileKind | InputFile  # of the core's own messages, or of a package that adds it


_NAMED = {name: kind for kind in FileKind for name in kind.names}
_TITLED = {FileKind.SCENARIO, FileKind.SPACE, FileKind.SUITE, FileKind.PLAN, FileKind.PROOF}
_BY_SUFFIX = {".py": FileKind.PYTHON, ".onnx": FileKind.ONNX, ".csv": FileKind.TABLE}
_IN_FOLDERS = (
    ("manifest.json", "manifest", FileKind.REPORT),
    ("manifest.json", "dataset", FileKind.DATASET),
    ("report.json", "report", FileKind.RUN_FOLDER),
)
JSON = frozenset(_NAMED.values()) - _TITLED - {FileKind.LOG}
FOLDERS = frozenset({FileKind.REPORT, FileKind.DATASET, FileKind.RUN_FOLDER, FileKind.FOLDER})
_BINARIES = frozenset({FileKind.TRACE, FileKind.LEDGER, FileKind.MODEL, FileKind.ONNX})


def kind_of(path: Path) -> Kind | None:
    """Return the kind of the file or folder at ``path``, or None if it is absent or of unknown kind.

    If a file has no title and extends another file, its kind is unknown, because the function does not read
    the other file.
    """
    try:
        if path.is_dir():
            return _folder_kind(path)
        if not path.is_file():
            return None
        head = _head(path)
    except (OSError, ValueError):
        return None
    return _binary_kind(path, head) or _text_kind(path, head.decode("utf-8", "replace"))


def added_input(path: Path) -> InputFile | None:
    """Return the entry of the package that defines the kind of a file.

    Return None for the kinds of the core.
    """
    kind = kind_of(path)
    if isinstance(kind, InputFile):
        return kind
    titles = kind.names[:1] if kind in _TITLED or kind is FileKind.LOG else ()
    return next((input_files().get(title) for title in titles if title in added_titles()), None)


def added_titles() -> set[str]:
    """Return the titles of the kinds of file that packages add.

    The function loads no package.
    """
    return {part.name for part in parts(ExtensionPoint.INPUTS)} - {*OWN_TITLES}


def is_log(path: Path) -> bool:
    """Return whether a file describes the log of a cell, or another recorded run."""
    kind = kind_of(path)
    return kind is FileKind.LOG or (isinstance(kind, InputFile) and kind.recorded is not None)


def recorded_run(path: Path, claims: Sequence[Claim] = ()) -> Any:
    """Return the recorded run that a file describes.

    Args:
        path: The file.
        claims: Claims that replace the file's own claims. An empty sequence leaves the file's own claims in
            place.

    Raises:
        MissingPackageError: No package reads such a file.
        InputError: A part of the file is unusable.

    """
    added = added_input(path) or titled("log")
    if added.recorded is None:
        raise ScenarioError(place=Place(file=path), expected="a recorded run", got=added.words)
    return added.recorded(path, tuple(claims))


def titled(title: str) -> InputFile:
    """Return the kind of files with a title.

    Raise MissingPackageError if no package adds this kind.
    """
    if (added := input_files().get(title)) is None:
        expected = f"a package that adds the entry point {title} to safety_harness.inputs"
        hint = f"pip install --force-reinstall {DISTRIBUTION}"
        raise MissingPackageError.of_option(f'files with the key "{title}"', expected, "none", hint)
    return added


def refuse_other_kind(
    path: Path,
    *wanted: Kind,
    error: type[InputError] = ScenarioError,
    place: Place | None = None,
    expected: str = "",
) -> None:
    """Raise ``error`` for a file of another kind.

    The error states the kind of the file, and the command that accepts files of this kind. A file of unknown
    kind passes. A damaged file passes too if it may be of a wanted kind. The function that later reads such a
    file refuses it.

    Args:
        path: The file or folder.
        *wanted: The allowed kinds.
        error: The type of the error.
        place: The place at which the file's name is written. None means the file itself.
        expected: A text that completes "expected ...". An empty text means the wanted kinds.

    """
    kind = kind_of(path)
    damaged = (kind is FileKind.BINARY and _BINARIES & {*wanted}) or (
        kind is FileKind.FOLDER and FOLDERS & {*wanted}
    )
    if kind is None or kind in wanted or damaged:
        return
    raise error(
        place=place or Place(file=path),
        expected=expected or _either([allowed.words for allowed in wanted]),
        got=f"{path}, {kind.words}" if place else kind.words,
        hint=command_for(path, kind, *wanted),
    )


def command_for(path: Path, kind: Kind, *wanted: Kind) -> str:
    """Return the command for a file of an unexpected kind.

    The text is empty if there is no such command.

    Args:
        path: The file or folder.
        kind: Its kind.
        *wanted: The kinds that the caller expected.

    """
    if kind is FileKind.FOLDER:
        inside = _first_in(path, {*wanted})
        return f"name a file in it, such as {shlex.quote(str(inside))}" if inside else ""
    if kind is FileKind.EMPTY and not {*wanted} & _TITLED:
        return ""
    if kind in (FileKind.PAGE, FileKind.RUNS, FileKind.EVIDENCE):
        beside = kind_of(path.parent)
        if beside in (FileKind.REPORT, FileKind.RUN_FOLDER):  # whose page or figures these are
            path, kind = path.parent, beside
    return kind.command.format(
        file=shlex.quote(str(path)),
        folder=shlex.quote(str(path.parent)),
        onnx=shlex.quote(f"{path.stem}.onnx"),
        name=avoider_in(path) if kind is FileKind.PYTHON else "",
    )


def _either(texts: Sequence[str]) -> str:
    """Join ``texts`` as alternatives, as in ``a, b or c``."""
    return " or ".join([", ".join(texts[:-1])] * (len(texts) > 1) + [texts[-1]])


def _first_in(folder: Path, wanted: set[Kind]) -> Path | None:
    """Return the first file in a folder whose kind is in ``wanted``, or None."""
    try:
        entries = sorted(folder.iterdir())[:MOST_ENTRIES]
    except OSError:
        return None
    return next((file for file in entries if not file.is_dir() and kind_of(file) in wanted), None)


def _head(file: Path) -> bytes:
    """Return the first bytes of a file."""
    with file.open("rb") as stream:
        return stream.read(HEAD_BYTES)


def _folder_kind(folder: Path) -> FileKind:
    """Return the kind of a folder, determined by a file in it."""
    for name, form, kind in _IN_FOLDERS:
        file = folder / name
        if file.is_file() and _format_of(_head(file).decode("utf-8", "replace")) == form:
            return kind
    return FileKind.FOLDER


def _binary_kind(path: Path, head: bytes) -> FileKind | None:
    """Return the kind of a binary file, or None if the file is a text."""
    if head.startswith(b"PK\3\4"):
        return _zip_kind(path)
    if head.startswith(b"SQLite format 3\0"):
        return FileKind.LEDGER
    # A file of safetensors: eight bytes with the length of the header, then the header in JSON.
    if head[8:10] == b'{"' and int.from_bytes(head[:8], "little") < HEAD_BYTES:
        return FileKind.MODEL
    # The beginning of a pickle, which older files of PyTorch are.
    if head[:1] == b"\x80" and head[1:2] in b"\2\3\4\5" and path.suffix in (".pt", ".pth", ".bin", ".ckpt"):
        return FileKind.TORCH
    if b"\0" in head and not head.startswith(_UTF_16):
        return FileKind.ONNX if path.suffix == ".onnx" else FileKind.BINARY
    return None


def _zip_kind(path: Path) -> FileKind:
    """Return the kind of a ZIP file, determined by the names in the directory at the file's end.

    The function unpacks nothing, because a file of foreign origin may unpack to any size.
    """
    with path.open("rb") as stream:
        stream.seek(max(stream.seek(0, os.SEEK_END) - TAIL_BYTES, 0))
        tail = stream.read()
    if b"trace.json" in tail:
        return FileKind.TRACE
    return FileKind.TORCH if b"/data.pkl" in tail else FileKind.BINARY


def _text_kind(path: Path, text: str) -> Kind | None:
    """Return the kind of a text file, determined by its suffix, its format or its title."""
    if not text.strip():
        return FileKind.EMPTY
    if path.suffix in _BY_SUFFIX:
        return _BY_SUFFIX[path.suffix]
    begin = text.lstrip()[:20].lower()
    if begin.startswith(("<!doctype html", "<html")):
        return FileKind.PAGE
    form = _format_of(text) if begin.startswith("{") else None
    if form is not None:
        return _NAMED.get(form)
    if all(key.search(text) for key in _LOG):
        return FileKind.LOG
    keys = {*TOP_KEY.findall(text)}
    titles = keys & {*TITLES, "plan", "proof"}
    if not titles:
        added = (title for title in added_titles() if title not in _NAMED)
        title = next((key for key in added if re.search(rf"^{re.escape(key)}:", text, re.M)), "")
        return input_files().get(title) if title else None
    return _NAMED[titles.pop()] if len(titles) == 1 else None


def _format_of(text: str) -> str | None:
    """Return the format that a JSON text of the harness declares."""
    declared = _FORMAT.search(text)
    return declared[1] if declared else None


def avoider_in(path: Path) -> str:
    """Return the first class with a ``propose`` in a Python file, or "NAME" if there is no such class.

    The file is not executed.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(_head(path))
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return "NAME"
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and "propose" in {getattr(item, "name", "") for item in node.body}:
            return node.name
    return "NAME"
