"""Which files a user's module reads: its process notes each, with the hash of its bytes, and we look there.

An audit hook of Python sees what is imported and what is opened for reading, also by ``numpy.load`` and
``zipfile``.  What a library reads without Python is not seen: a module names it in ``HARNESS_FILES``.
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
_SEEN_AS = {"open": 0, "import": 1, "ctypes.dlopen": 0, "sqlite3.connect": 0}  # events, and where the file is

_hooks: list[_Hook] = []  # one, in the process of a user's module
_journals: dict[int, int] = {}  # of processes, which may have been forked from one that has another


def environment() -> tuple[Mapping[str, str], int]:
    """The variables with which a process is started that notes files, and the descriptor to leave open."""
    own = os.getpid()
    if own not in _journals:
        _journals[own] = os.memfd_create("safety-harness-opened")
    return {**os.environ, _JOURNAL: str(_journals[own])}, _journals[own]


def noted(begin: int) -> tuple[list[tuple[str, str, str]], int]:
    """What was noted from that byte of the journal on, and where the journal ends now.

    (SHA-256 of the module, path, SHA-256 of the file), which is empty for one that the module writes itself:
    that is its memory, and no part of it.  Whatever else the module writes there is passed over.
    """
    journal = _journals.get(os.getpid())
    data = b"" if journal is None else os.pread(journal, os.fstat(journal).st_size - begin, begin)
    whole = data[: data.rfind(b"\n") + 1]
    noted = _NOTED.findall(whole)
    found = [(module.decode(), os.fsdecode(path), sha256.decode()) for module, sha256, path in noted]
    return found, begin + len(whole)


def watch(module: Path, source: bytes) -> None:
    """Note what is read below the project of ``module`` from now on, if this process was told to."""
    if _JOURNAL in os.environ:
        journal = int(os.environ.pop(_JOURNAL))
        os.set_inheritable(journal, False)
        _hooks.append(_Hook(journal, module, source))
        sys.addaudithook(_hooks[0])


def declare(file: Path) -> None:
    """Note a file, wherever it is; OSError if it cannot be read."""
    file.open("rb").close()
    for hook in _hooks:
        hook.note(os.path.abspath(file))


def sha256_of(path: str | Path) -> str:
    """The hash of a file's bytes; empty where there is no file that can be read."""
    with suppress(OSError):
        return whole_hash(Path(path))
    return ""


class _Hook:
    """Files below the project's folder: the nearest that is marked as one, else the working directory."""

    def __init__(self, journal: int, module: Path, source: bytes) -> None:
        marked = (one for one in module.parents if any((one / mark).exists() for mark in _MARKS))
        here = Path.cwd() if Path.cwd() in module.parents else module.parent
        self._journal, self._module = journal, str(module)
        self._begins = f"{hashlib.sha256(source).hexdigest()} "
        self._folder = os.path.join(next(marked, here), "")
        self._seen: set[tuple[str, int, int]] = set()
        self._written: set[str] = set()

    def __call__(self, event: str, told: tuple[object, ...]) -> None:
        place = _SEEN_AS.get(event)
        if place is not None and isinstance(told[place], str | bytes | os.PathLike):
            written = event == "open" and isinstance(told[2], int) and bool(told[2] & os.O_ACCMODE)
            with suppress(OSError, ValueError):  # it is for who opens it to say what is wrong
                self._look(os.path.abspath(os.fsdecode(told[place])), written)  # type: ignore[arg-type]

    def _look(self, path: str, written: bool) -> None:
        if "/__pycache__/" in path:
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
        """Once, unless it has been written since."""
        status = os.stat(path)
        key = path, status.st_mtime_ns, status.st_size
        if key not in self._seen:
            self._seen.add(key)
            if sha256 := sha256_of(path):
                self._write(sha256, path)

    def _write(self, sha256: str, path: str) -> None:
        os.write(self._journal, f"{self._begins}{sha256} ".encode() + os.fsencode(path) + b"\n")
