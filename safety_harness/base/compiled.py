"""The one way in which this package compiles a function: numba, cached, strict IEEE floats.

Numba's own file cache notices a change of the file that *defines* a function, not of the files
whose functions it calls: after an edit in ``geometry`` an old ``controller`` would go on running.
For a tool that gives evidence that is not acceptable, so the machine code of a file lies in a
folder named by a hash over that file and every file of the package that it imports, directly or
not (and the versions of Python, numba and numpy): a change in any of them compiles afresh, a
change elsewhere does not.  A function is looked for in the user's cache, then in the folder that
a wheel brings (``machine_code``), and is compiled if it is in neither.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.registry import CPUDispatcher

from safety_harness.base.compiling import Compilation, watchers
from safety_harness.base.machine_code import FOLDER, STAMP, InstalledCode

F = TypeVar("F", bound=Callable[..., Any])
_Made = TypeVar("_Made")

njit: Any = numba.njit  # one of its options is not in its stubs
numba_config: Any = config  # its settings are made at run time, unknown to type checkers
numba_event: Any = event
_cache_impl: Any = CompileResultCacheImpl

PACKAGE = Path(__file__).parents[1]
# A test holds the package to this one form of import, so that none is overlooked.
_IMPORT = re.compile(r"^\s*from (\w+)\.([\w.]+) import ", re.MULTILINE)


@cache
def _package_of(file: Path) -> Path:
    """Ours if the file lies in it, else the outermost package that it lies in, else its folder."""
    if PACKAGE in file.parents:
        return PACKAGE
    packages = [folder for folder in file.parents if (folder / "__init__.py").is_file()]
    return packages[-1] if packages else file.parent


def _in_no_package(file: Path) -> bool:
    return PACKAGE not in file.parents and not (file.parent / "__init__.py").is_file()


@cache
def _name(file: Path) -> bytes:
    return file.relative_to(_package_of(file)).as_posix().encode()


@cache  # read once, though sixty files import the same ones
def _content(file: Path) -> bytes:
    return file.read_bytes()


def _hash(files: Iterable[Path]) -> str:
    """Sixteen hex digits over the versions of numba and numpy, and names and contents of files."""
    digest = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__}".encode())
    for path in sorted(files):
        digest.update(_name(path))
        digest.update(_content(path))
    return digest.hexdigest()[:16]


def _package_sources() -> Iterator[Path]:
    """Every Python file of the package; examples, which a wheel has in a folder of ``shipped``, are none."""
    return (path for path in PACKAGE.rglob("*.py") if PACKAGE / "base" / "shipped" not in path.parent.parents)


@cache
def source_hash() -> str:
    """The hash over every Python file of the package: what a trace's provenance names."""
    return _hash(_package_sources())


@cache
def _imports(file: Path) -> tuple[Path, ...]:
    """The files of this package, and of the file's own, that a file imports directly."""
    packages = {package.name: package for package in (_package_of(file), PACKAGE)}
    found = _IMPORT.findall(_content(file).decode())
    return tuple(
        packages[name] / (rest.replace(".", "/") + ".py") for name, rest in found if name in packages
    )


def sources_of(file: Path, *, without: frozenset[Path] = frozenset()) -> frozenset[Path]:
    """A file of a package and every other that it imports, directly or not, through none of ``without``.

    Files are those of this package and of the file's own.  A file in no package (a benchmark, say) may use
    anything: all of this one.
    """
    if _in_no_package(file):
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
    try:
        return (Path(root) if root else Path.home() / ".cache") / "safety_harness"
    except RuntimeError:  # a user without a home
        return Path(os.devnull) / "safety_harness"  # no folder, which ``cache_problem`` says


@cache
def cache_problem(root: Path) -> str:
    """Why machine code cannot be kept in ``root``; empty if it can, and then the folder is there."""
    try:
        root.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=root).close()
    except OSError as error:
        return _cannot_keep(root, error)
    return ""


def _cannot_keep(root: Path, error: OSError) -> str:
    return (
        f"machine code cannot be kept in {root} ({error.strerror or error}), and what is missing there is "
        "made again by every process, which takes minutes; SAFETY_HARNESS_CACHE names another folder"
    )


@cache
def cache_folder(file: Path) -> Path:
    """The folder for the machine code of ``file``; marked as used today if it is there, where it can be."""
    folder = cache_root() / f"{_hash(sources_of(file))}-{sys.implementation.cache_tag}"
    with suppress(OSError):
        os.utime(folder)
    return folder


def installed_folder(file: Path) -> Path:
    """Return the folder in which a wheel brings the machine code of ``file``, whether it is there or not."""
    return PACKAGE / FOLDER / cache_folder(file).name


def code_in_use() -> str:
    """Return in words which machine code of the control stack runs here; results are the same with each."""
    stack = PACKAGE / "cell" / "controller" / "stack.py"
    compiled_here = any(cache_folder(stack).rglob("*.nbc")) or not installed_folder(stack).is_dir()
    return "machine code compiled here" if compiled_here else "machine code as installed, for any x86-64"


def forget_old_machine_code(days: float = 30.0) -> int:
    """Remove the machine code that no process has used for ``days``; returns how many folders that were."""
    oldest = time.time() - days * 86400.0
    old = [folder for folder in machine_code() if folder.stat().st_mtime < oldest]
    for folder in old:
        shutil.rmtree(folder, ignore_errors=True)
    return len(old)


def machine_code() -> list[Path]:
    """The folders of machine code that are there, of these and of other sources."""
    return [folder for folder in cache_root().glob("*") if folder.is_dir()]


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
        made = njit(error_model="numpy", **options)(function)
        made._cache = _Cache(function)
    finally:
        numba_config.CACHE_DIR = before
    made.__class__ = _kind
    _functions.append(made)
    return cast(F, made)


_functions: list[Any] = []  # all that are compiled here
_kind: Any = CPUDispatcher  # theirs


class _Locator(_cache_impl._locator_classes[0]):  # type: ignore[misc]
    """The folder that is given, also where it can only be read: else numba looks for one of its own.

    The folder's name covers the content of a package's file, so that another checkout of the same sources, a
    later one and an installation find it.  A file in no package has a folder below it, by its path and time.
    """

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Locator | None:
        return cls(function, file) if os.path.exists(file) else None

    def get_cache_path(self) -> str:
        alone = _in_no_package(Path(self._py_file))
        return str(self._cache_path if alone else os.path.dirname(self._cache_path))

    def get_source_stamp(self) -> Any:
        return super().get_source_stamp() if _in_no_package(Path(self._py_file)) else STAMP


class _CacheImpl(_cache_impl):  # type: ignore[misc]
    _locator_classes = (_Locator, *_cache_impl._locator_classes[1:])


class _Cache(FunctionCache):
    """Numba's own, and then the machine code that a wheel brings.

    A place that is read-only or full costs no more than that a process compiles again.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        folder = installed_folder(Path(function.__code__.co_filename))
        self._installed = InstalledCode(folder, self._impl.filename_base) if folder.is_dir() else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        with suppress(OSError):
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None or self._installed is None:
                return found
            data = self._installed.load_generic(self._index_key(sig, target_context.codegen()))  # type: ignore[no-untyped-call]
            if data is not None:
                _progress.installed += 1
                return self._impl.rebuild(target_context, data)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            if not cache_problem(cache_root()):
                _progress.unwritable = _cannot_keep(cache_root(), error)


class _Progress(event.Listener):
    """Tells the ``watchers`` after each function that numba compiles, and of none that it only loads."""

    depth, began_s, seconds, unwritable = 0, 0.0, 0.0, ""
    installed = 0  # functions whose code came with the package

    def on_start(self, event: Any) -> None:
        if not self.seconds:
            forget_old_machine_code()  # of which there is more from now on
        if not self.depth:
            self.began_s = time.monotonic()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        now_s = time.monotonic()
        self.seconds, self.began_s = self.seconds + now_s - self.began_s, now_s
        for watcher in watchers:
            watcher(compilation())


_progress = _Progress()
numba_event.register("numba:compile", _progress)


def compilation() -> Compilation:
    """How far this process has come."""
    ready = sum(bool(function.signatures) for function in _functions)
    unwritable = _progress.unwritable or cache_problem(cache_root())
    return Compilation(ready, len(_functions), _progress.seconds, _progress.depth > 0, unwritable)


class _Interpreted(CPUDispatcher):
    """Runs the Python function that it would compile."""

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*map(_with_attributes, args))


def _with_attributes(value: Any) -> Any:
    """A view of records that has their fields as attributes, as it is for compiled functions."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        return value.view(np.recarray)
    return _Record(value) if isinstance(value, np.void) and value.dtype.names else value


class _Record:
    """A record of an array, which is written where it lies; ``np.record`` of one would be a copy."""

    _record: np.void

    def __init__(self, record: np.void) -> None:
        object.__setattr__(self, "_record", record)

    def __getitem__(self, name: Any) -> Any:
        return _with_attributes(object.__getattribute__(self, "_record")[name])

    def __setitem__(self, name: Any, value: Any) -> None:
        object.__getattribute__(self, "_record")[name] = value

    __getattr__, __setattr__ = __getitem__, __setitem__


def without_compiling(work: Callable[[], _Made]) -> _Made:
    """What ``work`` returns, every compiled function in it run as the Python that it is written in.

    For what calls each a few times: 5 ms for the admission of a scenario, where compiling takes 12 s and
    loading 0.3 s.  Numbers may differ from machine code's by rounding where numpy has a sine of its own, so
    who decides this way does so whether the machine code is there or not.  Where Python refuses what is NaN
    or infinity for machine code, a division by zero, ``work`` is done again, compiled.
    """
    try:
        _call_as(_Interpreted)
        with np.errstate(all="ignore"):
            return work()
    except (ArithmeticError, ValueError):
        pass
    finally:
        _call_as(CPUDispatcher)
    return work()


def _call_as(kind: type) -> None:
    global _kind
    _kind = kind
    for function in _functions:
        function.__class__ = kind
