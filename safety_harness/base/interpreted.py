"""Run compiled functions as Python code, to save compilation or to record which functions a job calls."""

from __future__ import annotations

import dis
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numba.core.registry import CPUDispatcher

from safety_harness.base.compiled import CompiledFunction, call_as

_Made = TypeVar("_Made")


class _Interpreted(CompiledFunction):
    """A compiled function that runs as Python code instead."""

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*map(_with_attributes, args))


def _with_attributes(value: Any) -> Any:
    """Convert a value so that Python code can use it in the same way as compiled code.

    Fields of records become attributes, and any other value stays unchanged.
    """
    if isinstance(value, np.ndarray) and value.dtype.names:
        return value.view(np.recarray)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(_with_attributes, value))
    return _Record(value) if isinstance(value, np.void) and value.dtype.names else value


class _Record:
    """A view of a record in an array.  Changes of the view's fields change the array.

    An ``np.record`` would instead be a copy of the record.
    """

    _record: np.void

    def __init__(self, record: np.void) -> None:
        object.__setattr__(self, "_record", record)

    def __getitem__(self, name: Any) -> Any:
        return _with_attributes(object.__getattribute__(self, "_record")[name])

    def __setitem__(self, name: Any, value: Any) -> None:
        object.__getattribute__(self, "_record")[name] = value

    __getattr__, __setattr__ = __getitem__, __setitem__


def without_compiling(work: Callable[[], _Made]) -> _Made:
    """Call ``work`` while every compiled function runs as Python code, and return its result.

    Use this function for work that calls each compiled function only a few times.  For example, the admission
    of a scenario takes 5 ms as Python code.  To compile its functions takes 12 s, and to load their machine
    code takes 0.3 s.  Functions such as numpy's own sine may round differently from machine code.  Therefore
    a caller must either always use this function or never, whether or not the machine code already exists.

    Python raises ArithmeticError or ValueError in cases where machine code returns NaN or infinity, for
    example after a division by zero.  In that case ``work`` runs a second time with compiled functions.
    """
    try:
        call_as(_Interpreted)
        with np.errstate(all="ignore"):
            return work()
    except (ArithmeticError, ValueError):
        pass
    finally:
        call_as(CompiledFunction)
    return work()


class _Noted(_Interpreted):
    """A compiled function that runs as Python code and records its outermost calls."""

    def __call__(self, *args: Any) -> Any:
        if not _noted.depth:
            _noted.calls[self, tuple(map(self.typeof_pyval, args))] = None
        _noted.depth += 1
        try:
            return super().__call__(*args)
        finally:
            _noted.depth -= 1


@dataclass
class _Notes:
    """The recorded calls in their order, and the depth of the current call."""

    calls: dict[tuple[Any, Any], None] = field(default_factory=dict)
    depth: int = 0


_noted = _Notes()


def calls_of(work: Callable[[], object]) -> list[tuple[Any, Any]]:
    """Return the compiled functions that ``work`` calls, in order, with the types of their arguments.

    The functions run as Python code, without compilation.  If ``work`` raises an exception, the result
    contains the calls before the exception.
    """
    _noted.calls = {}
    try:
        call_as(_Noted)
        with np.errstate(all="ignore"), suppress(Exception):
            work()
    finally:
        call_as(CompiledFunction)
    return list(_noted.calls)


def cache_indexes(functions: Iterable[Any]) -> list[Path]:
    """Return the cache files that list the machine code of ``functions`` and of all functions called by them.

    If a branch has a constant condition, numba may omit the calls in this branch.  The result includes the
    called functions in any case.
    """
    waiting, met = list(functions), dict[Any, None]()
    while waiting:
        function = waiting.pop()
        if function not in met:
            met[function] = None
            waiting.extend(_callees(function.py_func))
    return [function._cache.index_file() for function in filter(_has_cache, met)]


def _has_cache(function: Any) -> bool:
    """Return whether this package's cache stores the machine code of a function."""
    return isinstance(function, CompiledFunction)


def _callees(function: Any) -> Iterable[Any]:
    """Return the compiled functions that a function's code refers to."""
    names = (step.argval for step in dis.get_instructions(function) if step.opname == "LOAD_GLOBAL")
    named = [function.__globals__.get(name) for name in names]
    named += [cell.cell_contents for cell in function.__closure__ or ()]
    return (value for value in named if isinstance(value, CPUDispatcher))
