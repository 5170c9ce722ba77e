"""Support for old names of parameters, which functions still accept for one release."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


def renamed_parameters(
    **names: str,
) -> Callable[[Callable[_Parameters, _Result]], Callable[_Parameters, _Result]]:
    """Return a decorator for a function that shall also accept the old names of its keyword arguments.

    Args:
        names: Keyword arguments of the form old name = new name.

    """

    def decorate(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
        @wraps(function)
        def call(*args: Any, **keywords: Any) -> _Result:
            for old, new in names.items():
                if old in keywords and new in keywords:
                    raise TypeError(f"{function.__name__}() takes {new} or its old name {old}; got both")
            return function(*args, **{names.get(name, name): value for name, value in keywords.items()})

        return call

    return decorate
