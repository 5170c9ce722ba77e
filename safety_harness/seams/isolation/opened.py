"""Record the files that a user's module reads, each with the hash of its bytes.

A Python audit hook in the module's process observes imports and files that are opened for reading, also by
``numpy.load`` and ``zipfile``. The hook does not observe files that a library opens without Python. The
module must list such files in ``HARNESS_FILES``.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import source_from_cache
from pathlib import Path

from safety_harness.base.whole_file import sha256_of as whole_hash

DECLARED = "HARNESS_FILES"
_JOURNAL = "SAFETY_HARNESS_JOURNAL"  # the descriptor at which a process notes them
_NOTED = re.compile(rb"([0-9a-f]{64}) ([0-9a-f]{64}|) (.+)$", re.MULTILINE)
_MARKS = (".git", "pyproject.toml", "setup.py", "setup.cfg")
_LIBRARIES = (str(Path(__file__).parents[2]), sys.prefix)
_SEEN_AS = {"open": 0, "import": 1, "ctypes.dlopen": 0, "sqlite3.connect": 0}  # event: argument of the file

_hooks: list[_Hook] = []  # one, in the process of a user's module
_journals: dict[int, int] = {}  # by process, since a fork needs a journal of its own


def environment() -> tuple[Mapping[str, str], int]:
    """Return the environment for a process that records files.

    Also return the descriptor of the journal, which the process must inherit.
    """
    own = os.getpid()
    if own not in _journals:
        # A file in memory: the child writes through an inherited descriptor, and no file remains on the disk.
        _journals[own] = os.memfd_create("safety-harness-opened")
    return {**os.environ, _JOURNAL: str(_journals[own])}, _journals[own]


def noted(begin: int) -> tuple[list[tuple[str, str, str]], int]:
    """Return the records in the journal, beginning with byte ``begin``.

    Also return the position at which the last record ends. Each record is (SHA-256 of the module, path,
    SHA-256 of the file). The last hash is empty for a file that the module writes, because such a file is the
    module's memory rather than a part of the module. The function skips any other text that the module writes
    to the journal.
    """
    journal = _journals.get(os.getpid())
    data = b"" if journal is None else os.pread(journal, os.fstat(journal).st_size - begin, begin)
    whole = data[: data.rfind(b"\n") + 1]
    noted = _NOTED.findall(whole)
    records = [(module.decode(), os.fsdecode(path), sha256.decode()) for module, sha256, path in noted]
    return records, begin + len(whole)


def watch(module: Path, source: bytes) -> None:
    """Record the files below the project of ``module`` that are read from now on.

    If there is no journal, record no files.
    """
    if _JOURNAL in os.environ:
        journal = int(os.environ.pop(_JOURNAL))
        os.set_inheritable(journal, False)
        _hooks.append(_Hook(journal, module, source))
        sys.addaudithook(_hooks[0])


def declare(file: Path) -> None:
    """Record a file in any folder.

    Raise OSError if the file cannot be read.
    """
    file.open("rb").close()
    for hook in _hooks:
        hook.note(os.path.abspath(file))


def sha256_of(path: str | Path) -> str:
    """Return the hash of a file's bytes, or an empty text if the file cannot be read."""
    with suppress(OSError):
        return whole_hash(Path(path))
    return ""


class _Hook:
    """The audit hook that records files below the project's folder.

    That folder is the nearest parent of the module that contains one of ``_MARKS``. If there is no such
    parent and the module is below the working directory, the project's folder is the working directory.
    Otherwise it is the module's own folder.
    """

    def __init__(self, journal: int, module: Path, source: bytes) -> None:
        marked = (folder for folder in module.parents if any((folder / mark).exists() for mark in _MARKS))
        here = Path.cwd() if Path.cwd() in module.parents else module.parent
        self._journal, self._module = journal, str(module)
        self._begins = f"{hashlib.sha256(source).hexdigest()} "
        self._folder = os.path.join(next(marked, here), "")
        self._seen: set[tuple[str, int, int]] = set()
        self._written: set[str] = set()

    def __call__(self, event: str, args: tuple[object, ...]) -> None:
        place = _SEEN_AS.get(event)
        if place is not None and isinstance(args[place], str | bytes | os.PathLike):
            written = event == "open" and isinstance(args[2], int) and bool(args[2] & os.O_ACCMODE)
            with suppress(OSError, ValueError):  # whoever opens the file reports the error
                self._record(os.path.abspath(os.fsdecode(args[place])), written)  # type: ignore[arg-type]

    def _record(self, path: str, written: bool) -> None:
        if "/__pycache__/" in path:
            # A cached module stands for its source.
            path = source_from_cache(path) if path.endswith(".pyc") else ""
        if not path.startswith(self._folder) or path == self._module or "-packages/" in path:
            return
        if any(path.startswith(library + os.sep) for library in _LIBRARIES):
            return
        if written and path not in self._written:
            self._written.add(path)
            self._write("", path)
        elif path not in self._written and os.path.isfile(path):
            self.note(path)

    def note(self, path: str) -> None:
        """Write the file's hash to the journal, once for each version of the file."""
        status = os.stat(path)
        key = path, status.st_mtime_ns, status.st_size
        if key not in self._seen:
            self._seen.add(key)
            if sha256 := sha256_of(path):
                self._write(sha256, path)

    def _write(self, sha256: str, path: str) -> None:
        os.write(self._journal, f"{self._begins}{sha256} ".encode() + os.fsencode(path) + b"\n")
