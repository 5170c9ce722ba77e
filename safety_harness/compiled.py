"""The one way in which this package compiles a function: numba, cached, strict IEEE floats.

Numba's own file cache notices a change of the file that *defines* a function, not of the files
whose functions it calls: after an edit in ``geometry`` an old ``controller`` would go on running.
For a tool that gives evidence that is not acceptable, so the machine code of a file lies in a
folder named by a hash over that file and every file of the package that it imports, directly or
not (and numba's version): a change in any of them compiles afresh, a change elsewhere does not.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config

F = TypeVar("F", bound=Callable[..., Any])

njit: Any = numba.njit  # one of its options is not in its stubs
numba_config: Any = config  # its settings are made at run time, unknown to type checkers

PACKAGE = Path(__file__).parent
# A test holds the package to this one form of import, so that none is overlooked.
_IMPORT = re.compile(r"^\s*from (\w+)\.([\w.]+) import ", re.MULTILINE)


@lru_cache
def _package_of(file: Path) -> Path:
    """Ours if the file lies in it, else the outermost package that it lies in, else its folder."""
    if PACKAGE in file.parents:
        return PACKAGE
    packages = [folder for folder in file.parents if (folder / "__init__.py").is_file()]
    return packages[-1] if packages else file.parent


def _hash(files: Iterable[Path]) -> str:
    """Sixteen hex digits over numba's version and the names and contents of files of the package."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for path in sorted(files):
        digest.update(path.relative_to(_package_of(path)).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _package_sources() -> Iterator[Path]:
    """Every Python file of the package; examples, which a wheel has in a folder of ``shipped``, are none."""
    return (path for path in PACKAGE.rglob("*.py") if PACKAGE / "shipped" not in path.parent.parents)


@lru_cache(maxsize=1)
def source_hash() -> str:
    """The hash over every Python file of the package: what a trace's provenance names."""
    return _hash(_package_sources())


@lru_cache
def _imports(file: Path) -> tuple[Path, ...]:
    """The files of this package, and of the file's own, that a file imports directly."""
    packages = {package.name: package for package in (_package_of(file), PACKAGE)}
    found = _IMPORT.findall(file.read_text(encoding="utf-8"))
    return tuple(
        packages[name] / (rest.replace(".", "/") + ".py") for name, rest in found if name in packages
    )


def sources_of(file: Path, *, without: frozenset[Path] = frozenset()) -> frozenset[Path]:
    """A file of a package and every other that it imports, directly or not, through none of ``without``.

    Files are those of this package and of the file's own.  A file in no package (a benchmark, say) may use
    anything: all of this one.
    """
    if PACKAGE not in file.parents and not (file.parent / "__init__.py").is_file():
        return frozenset(_package_sources())
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        one = waiting.pop()
        if one not in found and one not in without:
            found.add(one)
            waiting.extend(_imports(one))
    return frozenset(found)


def source_hash_of(*files: Path) -> str:
    """The hash over files of the package and every other that they import, directly or not."""
    return _hash(frozenset().union(*map(sources_of, files)))


def cache_root() -> Path:
    """Where machine code is kept: below ``$SAFETY_HARNESS_CACHE``, else the user's cache folder."""
    root = os.environ.get("SAFETY_HARNESS_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "safety_harness"


@lru_cache
def cache_folder(file: Path) -> Path:
    """The folder for the machine code of ``file``; marked as used today if it is there."""
    folder = cache_root() / _hash(sources_of(file))
    if folder.is_dir():
        os.utime(folder)
    return folder


def forget_old_machine_code(days: float = 30.0) -> None:
    """Remove the machine code that no process has used for ``days``."""
    oldest = time.time() - days * 86400.0
    for folder in cache_root().glob("*"):
        if folder.is_dir() and folder.stat().st_mtime < oldest:
            shutil.rmtree(folder, ignore_errors=True)


def compiled(function: F) -> F:
    """Compile ``function`` on its first call and keep the machine code for the next process.

    No ``fastmath`` (results must repeat bit for bit) and no exceptions from divisions: like
    numpy, 0/0 is NaN, which every caller that decides something has to look for.
    """
    return _compiled(function, _nrt=True)  # said, for it would be taken over from the first caller


def njit_no_nrt(function: F) -> F:
    """As ``compiled``, for a function that makes no array.

    Views of arrays are then not counted, which takes longer than what small functions do with them.
    """
    return _compiled(function, _nrt=False)


def inlined(function: F) -> F:
    """As ``njit_no_nrt``, and always part of its callers' machine code: for small steps of many arrays."""
    return _compiled(function, _nrt=False, forceinline=True)


def _compiled(function: F, **options: bool) -> F:
    before = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder(Path(function.__code__.co_filename)))
    try:
        return cast(F, njit(cache=True, error_model="numpy", **options)(function))
    finally:
        numba_config.CACHE_DIR = before
