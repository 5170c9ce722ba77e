"""Run compiled functions as Python code: without compiling them, or to learn which ones a job calls."""

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
    """A compiled function that Python runs as Python."""

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*map(_with_attributes, args))


def _with_attributes(value: Any) -> Any:
    """Return a view of records whose fields are attributes, as in compiled code; other values unchanged."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        return value.view(np.recarray)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(_with_attributes, value))
    return _Record(value) if isinstance(value, np.void) and value.dtype.names else value


class _Record:
    """A record of an array that is changed in place, which ``np.record`` would copy."""

    _record: np.void

    def __init__(self, record: np.void) -> None:
        object.__setattr__(self, "_record", record)

    def __getitem__(self, name: Any) -> Any:
        return _with_attributes(object.__getattribute__(self, "_record")[name])

    def __setitem__(self, name: Any, value: Any) -> None:
        object.__getattribute__(self, "_record")[name] = value

    __getattr__, __setattr__ = __getitem__, __setitem__


def without_compiling(work: Callable[[], _Made]) -> _Made:
    """Return the result of ``work`` while Python runs every compiled function as Python.

    Use it for work that calls each function only a few times.  Admission of a scenario takes 5 ms this way,
    compared with 12 s for compiling and 0.3 s for loading.  Where numpy has a sine of its own, results may
    differ from machine code by rounding.  So a caller must always choose this way, or never, whether or not
    the machine code exists.

    Where machine code computes NaN or infinity, such as by a division by zero, Python raises ArithmeticError
    or ValueError.  In that case ``work`` runs again, compiled.
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
    """A compiled function that Python runs as Python, and whose outermost calls are noted."""

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
    """The calls so far, in order, and the depth of the present call."""

    calls: dict[tuple[Any, Any], None] = field(default_factory=dict)
    depth: int = 0


_noted = _Notes()


def calls_of(work: Callable[[], object]) -> list[tuple[Any, Any]]:
    """Return the compiled functions, and the types of their arguments, that ``work`` calls, in order.

    Python runs them, so nothing is compiled.  After an error of ``work`` the calls before it are returned.
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
    """Return the cache files that will list the machine code of ``functions`` and of all that they call.

    Functions called only where a condition is constant are included, although numba may leave them out.
    """
    waiting, met = list(functions), dict[Any, None]()
    while waiting:
        function = waiting.pop()
        if function not in met:
            met[function] = None
            waiting.extend(_callees(function.py_func))
    return [function._cache.index_file() for function in filter(_has_cache, met)]


def _has_cache(function: Any) -> bool:
    """Return whether the cache keeps the machine code of a function."""
    return isinstance(function, CompiledFunction)


def _callees(function: Any) -> Iterable[Any]:
    """Return the compiled functions that a function names."""
    names = (step.argval for step in dis.get_instructions(function) if step.opname == "LOAD_GLOBAL")
    named = [function.__globals__.get(name) for name in names]
    named += [cell.cell_contents for cell in function.__closure__ or ()]
    return (value for value in named if isinstance(value, CPUDispatcher))
