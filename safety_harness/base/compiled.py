"""Compile functions with numba, with strict IEEE floats and a cache on disk.

Every compiled function of the package is compiled by this module.  Numba's own file cache compares the file
that *defines* a function, but not the files whose functions it calls.  After an edit in ``geometry``, the old
machine code of ``controller`` would remain in use and produce wrong evidence.

Therefore this module stores the machine code of a file in a folder whose name is a hash.  The hash covers
that file and every file of the package that it imports, whether directly or indirectly.  The hash also covers
the versions of Python and numba, and the major version of numpy.  The array layout and the type rules depend
on these versions.  A change in any of these causes a new compilation.  A change in any other file has no
effect.

Numba first searches the user's cache, and then the folder that a wheel contains (``machine_code``).  If both
lack the code, numba compiles the function.
"""

from __future__ import annotations

import gc
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import config, event, sigutils, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.imputils import lower_cast
from numba.core.registry import CPUDispatcher

from safety_harness.base.compile_lock import hold, lock_file, release
from safety_harness.base.compiling import Compilation, Compiled, watchers
from safety_harness.base.machine_code import FOLDER, STAMP, InstalledCode

F = TypeVar("F", bound=Callable[..., Any])

njit: Any = numba.njit  # numba's stubs lack one of its options
numba_types: Any = types
numba_sigutils: Any = sigutils
numba_config: Any = config  # its settings are made at run time, unknown to type checkers
numba_event: Any = event
_cache_impl: Any = CompileResultCacheImpl
_library: Any = CPUCodeLibrary

PACKAGE = Path(__file__).parents[1]
# A test allows the package only this form of import, so that no import is overlooked.
_IMPORT = re.compile(r"^\s*from (\w+)\.([\w.]+) import ", re.MULTILINE)


@cache
def _package_of(file: Path) -> Path:
    """Return the folder of the package to which a file belongs.

    If the file is outside this package, return the folder of the outermost package that contains the file.
    If no package contains the file, return the file's own folder.
    """
    if PACKAGE in file.parents:
        return PACKAGE
    packages = [folder for folder in file.parents if (folder / "__init__.py").is_file()]
    return packages[-1] if packages else file.parent


def _in_no_package(file: Path) -> bool:
    """Return whether a file, such as a single script, lies outside every package."""
    return PACKAGE not in file.parents and not (file.parent / "__init__.py").is_file()


@cache
def _name(file: Path) -> bytes:
    """Return the path of a file inside its package, as bytes for the hash."""
    return file.relative_to(_package_of(file)).as_posix().encode()


@cache  # read once, although sixty files import the same files
def _content(file: Path) -> bytes:
    """Return the bytes of a file."""
    return file.read_bytes()


def _hash(files: Iterable[Path]) -> str:
    """Return a hash of the versions of numba and numpy and of the given files, as 16 hex digits.

    The hash covers the names and contents of the files, and the major version of numpy.
    """
    digest = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__.split('.')[0]}".encode())
    for path in sorted(files):
        digest.update(_name(path))
        digest.update(_content(path))
    return digest.hexdigest()[:16]


def _package_sources() -> Iterator[Path]:
    """Yield every Python file of the package, except the examples that a wheel contains below ``shipped``."""
    return (path for path in PACKAGE.rglob("*.py") if PACKAGE / "base" / "shipped" not in path.parent.parents)


@cache
def source_hash() -> str:
    """Return the hash over every Python file of the package, which a trace stores in its provenance."""
    return _hash(_package_sources())


@cache
def _imports(file: Path) -> tuple[Path, ...]:
    """Return the files that a file imports directly.

    Only files of this package and of the file's own package are included.
    """
    packages = {package.name: package for package in (_package_of(file), PACKAGE)}
    imported = _IMPORT.findall(_content(file).decode())
    return tuple(
        packages[name] / (rest.replace(".", "/") + ".py") for name, rest in imported if name in packages
    )


def sources_of(file: Path, *, without: frozenset[Path] = frozenset()) -> frozenset[Path]:
    """Return a file and every file that it imports, directly or not.

    The result only includes files of this package and of the package to which the file belongs.  If the file
    is in no package, such as a benchmark, it may import any module.  In that case the result is every file of
    this package.

    Args:
        file: The file at which the search for imports begins.
        without: Files to omit.  If a file is imported only by omitted files, it is omitted as well.

    """
    if _in_no_package(file):
        return frozenset(_package_sources())
    sources: set[Path] = set()
    waiting = [file]
    while waiting:
        source = waiting.pop()
        if source not in sources and source not in without:
            sources.add(source)
            waiting.extend(_imports(source))
    return frozenset(sources)


def source_hash_of(*files: Path) -> str:
    """Return the hash over some files of the package and every file that they import, directly or not."""
    return _hash(frozenset().union(*map(sources_of, files)))


def cache_root() -> Path:
    """Return the folder of all machine code, below ``$SAFETY_HARNESS_CACHE`` or the user's cache folder."""
    root = os.environ.get("SAFETY_HARNESS_CACHE") or os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(root) if root else Path.home() / ".cache") / "safety_harness"
    except RuntimeError:  # the user has no home folder
        return Path(os.devnull) / "safety_harness"  # this is no folder, as ``cache_problem`` reports


@cache
def cache_problem(root: Path) -> str:
    """Create the folder ``root``, and return the reason why the folder cannot store machine code.

    If the folder can store machine code, the reason is an empty text.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=root).close()
    except OSError as error:
        return _cannot_keep(root, error)
    return ""


def _cannot_keep(root: Path, error: OSError) -> str:
    """Return the text of the warning that machine code cannot be written to a folder."""
    return (
        f"cannot write machine code to {root} ({error.strerror or error}), so every process compiles missing "
        "code again, which takes minutes; set SAFETY_HARNESS_CACHE to another folder"
    )


@cache
def cache_folder(file: Path) -> Path:
    """Return the folder for the machine code of ``file``, and set the folder's time of last use to now.

    If the folder is absent or read-only, its time of last use stays unchanged.
    """
    folder = cache_root() / f"{_hash(sources_of(file))}-{sys.implementation.cache_tag}"
    with suppress(OSError):
        os.utime(folder)
    return folder


def installed_folder(file: Path) -> Path:
    """Return the folder of a wheel that may contain the machine code of ``file``.

    The folder may be absent.
    """
    return PACKAGE / FOLDER / cache_folder(file).name


def code_in_use() -> str:
    """Return a text that states where the control stack's machine code was compiled.

    The place of compilation never changes a result.
    """
    stack = PACKAGE / "cell" / "controller" / "stack.py"
    compiled_here = any(cache_folder(stack).rglob("*.nbc")) or not installed_folder(stack).is_dir()
    return "machine code compiled here" if compiled_here else "machine code as installed, for any x86-64"


def forget_old_machine_code(days: float = 30.0) -> int:
    """Remove machine code that no process has used for ``days``, and return the number of removed folders."""
    oldest = time.time() - days * 86400.0
    old = [folder for folder in machine_code() if folder.stat().st_mtime < oldest]
    for folder in old:
        shutil.rmtree(folder, ignore_errors=True)
    return len(old)


def machine_code() -> list[Path]:
    """Return all existing folders of machine code, including those of earlier sources."""
    return [folder for folder in cache_root().glob("*") if folder.is_dir()]


def compiled(function: F) -> F:
    """Return ``function`` as a compiled function.

    The function is compiled at its first call, and the machine code is stored for later processes.
    ``fastmath`` is off, because results must be equal bit for bit.  A division by zero raises no exception,
    and 0/0 is NaN as in numpy.  Therefore every caller that makes a decision must check for NaN.
    """
    return _compiled(function, _nrt=True)  # explicit, since numba would copy it from the first caller


def njit_no_nrt(function: F) -> F:
    """Compile a function that creates no array, and compile it without reference counting.

    In all other respects, this decorator works like ``compiled``.  In small functions, counting references to
    views of arrays would take longer than the work itself.
    """
    return _compiled(function, _nrt=False)


def inlined(function: F) -> F:
    """Compile a small function into the machine code of its callers.

    In all other respects, this decorator works like ``njit_no_nrt``.
    """
    return _compiled(function, _nrt=False, forceinline=True)


def arithmetic(function: F) -> F:
    """Compile a function for use in other compiled functions, and let Python run it as Python code.

    Python may call it with floats or with arrays.  The function must only use operations for which IEEE 754
    fixes every bit of the result.  Then the compiled code and the Python code return the same bits.
    """
    made: Any = njit(error_model="numpy", _nrt=False)(function)
    made.__class__ = _Arithmetic
    return cast(F, made)


class _Arithmetic(CPUDispatcher):
    """A function that is compiled only for its compiled callers.  Python runs it as Python code."""

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*args)


def _compiled(function: F, **options: bool) -> F:
    """Return ``function`` as a compiled function.

    Its machine code is cached in the folder that ``cache_folder`` returns for its file.
    """
    previous = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder(Path(function.__code__.co_filename)))
    try:
        # Numba's wrapper for callers in C, which costs 9 % of the time, has no use here.
        made = njit(error_model="numpy", no_cfunc_wrapper=True, **options)(function)
        made._cache = _Cache(function)
    finally:
        numba_config.CACHE_DIR = previous
    made.__class__ = _kind
    _functions.append(made)
    return cast(F, made)


class CompiledFunction(CPUDispatcher):
    """A compiled function for which numba compiles fewer versions than usual.

    A version is the machine code for certain argument types.  One version serves all values of an integer
    constant.  One version also serves all shapes of an array in a record.
    """

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return numba's description of a call from another compiled function.

        The argument types in it are generalised.
        """
        kws = {name: _general(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(_general, args)), kws)

    def compile(self, sig: Any) -> Any:
        """Load or compile the version for a signature.

        Afterwards, release the lock, so that other processes can load that version.
        """
        try:
            with _without_waste():
                return super().compile(sig)
        finally:
            store = cast(Any, self)._cache
            if isinstance(store, _Cache):  # a function that came by pickle has none
                store.ended(sig)


@contextmanager
def _without_waste() -> Iterator[None]:
    """Compile without garbage collection, without numba's first optimisation, and in one thread at a time.

    Garbage collection and the first optimisation would take 16 % of the time and have no use.  Garbage
    collection would search many objects and free few of them.  Numba would optimise each function both before
    and after it links the functions of a library.
    """
    with global_compiler_lock:
        collecting, first_passes = gc.isenabled(), _library._optimize_functions
        gc.disable()
        # The lock above keeps other threads from compiling meanwhile with the replaced function.
        _library._optimize_functions = _lay_out
        try:
            yield
        finally:
            _library._optimize_functions = first_passes
            if collecting:
                gc.enable()


def _lay_out(library: Any, module: Any) -> None:
    """Set the data layout of a module.

    The first optimisation of numba, which this module skips, would otherwise set the layout.
    """
    module.data_layout = library._codegen._data_layout


def _general(kind: Any) -> Any:
    """Return a more general type of an argument.

    The result omits the value of a constant, and the shape of an array in a record.
    """
    if isinstance(kind, numba_types.NestedArray):
        return numba_types.Array(kind.dtype, kind.ndim, "C")
    return numba_types.unliteral(kind)


@lower_cast(numba_types.NestedArray, numba_types.Array)  # type: ignore[untyped-decorator, no-untyped-call]
def _without_shape(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    """Convert an array in a record to an array of any shape.

    The value stays unchanged, because numba stores arrays of both types in the same way.
    """
    return value


_functions: list[Any] = []  # all compiled functions of this process
_kind: Any = CompiledFunction  # their class, which ``call_as`` changes for a while


class _Locator(_cache_impl._locator_classes[0]):  # type: ignore[misc]
    """The locator that makes numba use this package's cache folder, even if the folder is read-only.

    If a file belongs to a package, the folder's name already depends on the contents of the file.  Therefore
    a later checkout, a second checkout and an installation of the same sources find the same machine code.
    If a file is outside every package, the locator uses a subfolder.  The subfolder's name depends on the
    file's path and time.
    """

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Locator | None:
        """Return the locator for the file of a function, or None if the file does not exist."""
        return cls(function, file) if os.path.exists(file) else None

    def get_cache_path(self) -> str:
        """Return the folder for the machine code."""
        alone = _in_no_package(Path(self._py_file))
        return str(self._cache_path if alone else os.path.dirname(self._cache_path))

    def get_source_stamp(self) -> Any:
        """Return the value by which numba recognises a changed file.

        If the name of the cache folder already depends on the file's content, the value is a constant.
        """
        return super().get_source_stamp() if _in_no_package(Path(self._py_file)) else STAMP


class _CacheImpl(_cache_impl):  # type: ignore[misc]
    """Numba's cache implementation, which tries our locator before numba's own locators."""

    _locator_classes = (_Locator, *_cache_impl._locator_classes[1:])


class _Cache(FunctionCache):
    """Numba's cache for one function, which also finds the machine code in a wheel.

    If another process is compiling the same function, this process waits and then loads the machine code.  If
    the cache folder is read-only or full, each process compiles the function again.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        folder = installed_folder(Path(function.__code__.co_filename))
        self._installed = InstalledCode(folder, self._impl.filename_base) if folder.is_dir() else None
        self._locks: dict[Any, Path] = {}  # by signature

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for a signature from the cache or from the wheel, or None.

        If the result is None, this process has the function's lock until it calls ``ended``.
        """
        # Most functions exist already, so the first look takes no lock.
        code = self._load(sig, target_context)
        if code is None:
            self._locks[sig] = self._lock(sig)
            hold(self._locks[sig])
            code = self._load(sig, target_context)  # another process may have compiled it meanwhile
        return code

    def index_file(self) -> Path:
        """Return the file that lists the versions of the function in the cache."""
        return Path(self._cache_file._index_path)

    def _lock(self, part: object) -> Path:
        return lock_file(self._cache_path, self._impl.filename_base, part)

    def _load(self, sig: Any, target_context: Any) -> Any:
        with suppress(OSError):
            code = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if code is not None and tuple(code.signature.args) != numba_sigutils.normalize_signature(sig)[0]:
                code = None  # the index of an earlier version may name the code of another signature
            if code is not None or self._installed is None:
                return code
            data = self._installed.load_generic(self._index_key(sig, target_context.codegen()))  # type: ignore[no-untyped-call]
            if data is not None:
                _progress.installed += 1
                return self._impl.rebuild(target_context, data)
        return None

    def ended(self, sig: Any) -> None:
        """Release the lock for a signature, so that other processes can load the function."""
        if sig in self._locks:
            release(self._locks.pop(sig))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code for a signature.

        If this fails, remember the reason, which ``compilation`` reports.  An index contains a number for
        each file of a function.  Only one process at a time may add a file to the index.
        """
        index = self._lock("index")
        hold(index)
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            if not cache_problem(cache_root()):
                _progress.unwritable = _cannot_keep(cache_root(), error)
        finally:
            release(index)


class _Progress(event.Listener):
    """The listener that calls the ``watchers`` each time a function has been compiled.

    The listener does not call the watchers when a function is loaded from the cache.
    """

    depth, began_s, seconds, unwritable = 0, 0.0, 0.0, ""
    installed = 0  # functions whose code came with the package

    def on_start(self, event: Any) -> None:
        """Start the clock when a compilation begins, unless another compilation is in progress.

        Before the first compilation of this process, remove old machine code.
        """
        if not self.seconds:
            forget_old_machine_code()  # before this process adds to it
        if not self.depth:
            self.began_s = time.monotonic()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        """Add the time since the last event to ``seconds``, and call the watchers."""
        self.depth -= 1
        now_s = time.monotonic()
        self.seconds, self.began_s = self.seconds + now_s - self.began_s, now_s
        Compiled.count += 1
        for watcher in watchers:
            watcher(compilation())


_progress = _Progress()
numba_event.register("numba:compile", _progress)


def compilation() -> Compilation:
    """Return how many functions this process has compiled or loaded, and the seconds spent on that."""
    ready = sum(bool(function.signatures) for function in _functions)
    unwritable = _progress.unwritable or cache_problem(cache_root())
    return Compilation(ready, _progress.seconds, _progress.depth > 0, unwritable)


def call_as(kind: type) -> None:
    """Set the class of every compiled function to ``kind``, including functions that are compiled later."""
    global _kind
    _kind = kind
    for function in _functions:
        function.__class__ = kind
