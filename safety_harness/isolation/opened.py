"""Which files a user's module reads: its process notes each, with the hash of its bytes, and we look there.

An audit hook of Python sees what is imported and what is opened for reading, also by ``numpy.load`` and
``zipfile``.  What a library reads without Python is not seen: a module names it in ``HARNESS_FILES``.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import source_from_cache
from pathlib import Path

DECLARED = "HARNESS_FILES"
_JOURNAL = "SAFETY_HARNESS_JOURNAL"  # the descriptor at which a process notes them
_MARKS = (".git", "pyproject.toml", "setup.py", "setup.cfg")
_LIBRARIES = (str(Path(__file__).parents[1]), sys.prefix)
_SEEN_AS = {"open": 0, "import": 1, "ctypes.dlopen": 0, "sqlite3.connect": 0}  # events, and where the file is

_hooks: list[_Hook] = []  # one, in the process of a user's module
_journals: dict[int, int] = {}  # of processes, which may have been forked from one that has another


def environment() -> tuple[Mapping[str, str], int]:
    """The variables with which a process is started that notes files, and the descriptor to leave open."""
    own = os.getpid()
    if own not in _journals:
        _journals[own] = os.memfd_create("safety-harness-opened")
    return {**os.environ, _JOURNAL: str(_journals[own])}, _journals[own]


def noted(begin: int) -> tuple[list[tuple[str, str]], int]:
    """(path, SHA-256) of what was noted from that byte of the journal on, and where the journal ends now."""
    journal = _journals.get(os.getpid())
    data = b"" if journal is None else os.pread(journal, os.fstat(journal).st_size - begin, begin)
    whole = data[: data.rfind(b"\n") + 1]
    lines = (line.partition(b" ") for line in whole.splitlines())
    return [(os.fsdecode(path), sha256.decode()) for sha256, _, path in lines], begin + len(whole)


def watch(module: Path) -> None:
    """Note what is read below the project of ``module`` from now on, if this process was told to."""
    if _JOURNAL in os.environ:
        journal = int(os.environ.pop(_JOURNAL))
        os.set_inheritable(journal, False)
        _hooks.append(_Hook(journal, module))
        sys.addaudithook(_hooks[0])


def declare(file: Path) -> None:
    """Note a file, wherever it is; OSError if it cannot be read."""
    file.open("rb").close()
    for hook in _hooks:
        hook.note(os.path.abspath(file))


def sha256_of(path: str | Path) -> str:
    """The hash of a file's bytes; empty where there is no file that can be read."""
    with suppress(OSError), open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


class _Hook:
    """Files below the project's folder: the nearest that is marked as one, else the working directory."""

    def __init__(self, journal: int, module: Path) -> None:
        marked = (one for one in module.parents if any((one / mark).exists() for mark in _MARKS))
        here = Path.cwd() if Path.cwd() in module.parents else module.parent
        self._journal, self._module = journal, str(module)
        self._folder = os.path.join(next(marked, here), "")
        self._seen: set[tuple[str, int, int]] = set()

    def __call__(self, event: str, told: tuple[object, ...]) -> None:
        place = _SEEN_AS.get(event)
        if place is None or (event == "open" and isinstance(told[2], int) and told[2] & os.O_ACCMODE):
            return
        if isinstance(told[place], str | bytes | os.PathLike):
            with suppress(OSError, ValueError):  # it is for who opens it to say what is wrong
                self._note(os.path.abspath(os.fsdecode(told[place])))  # type: ignore[arg-type]

    def _note(self, path: str) -> None:
        if "/__pycache__/" in path:
            path = source_from_cache(path) if path.endswith(".pyc") else ""
        if not path.startswith(self._folder) or path == self._module or "-packages/" in path:
            return
        if not any(path.startswith(library + os.sep) for library in _LIBRARIES) and os.path.isfile(path):
            self.note(path)

    def note(self, path: str) -> None:
        """Once, unless it has been written since."""
        status = os.stat(path)
        key = path, status.st_mtime_ns, status.st_size
        if key not in self._seen:
            self._seen.add(key)
            if sha256 := sha256_of(path):
                os.write(self._journal, f"{sha256} ".encode() + os.fsencode(path) + b"\n")
