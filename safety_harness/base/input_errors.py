"""The errors of several inputs together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeVar

from safety_harness.base.exceptions import InputError

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")


class InputErrors(InputError):
    """Several inputs cannot be used, and nothing was done: it names the first, and each is in ``errors``.

    Args:
        errors: At least one.
        left: How many inputs could be used without these.

    """

    def __init__(self, errors: Sequence[InputError], left: int = 0) -> None:
        self.errors, self.left = tuple(errors), left
        first, *others = self.errors
        hint = "; ".join(filter(None, [first.hint, *(f"and {one}" for one in others)]))
        super().__init__(place=first.place, expected=first.expected, got=first.got, hint=hint)

    def __reduce__(self) -> tuple[partial[InputError], tuple[()]]:
        return partial(InputErrors, self.errors, self.left), ()  # type: ignore[return-value]


def each_once(errors: Iterable[InputError]) -> list[InputError]:
    """Return each error once: what is wrong in a file that others extend is the same mistake for all."""
    return list({str(error): error for error in errors}.values())


def usable(items: Iterable[_Item], make: Callable[[_Item], _Made]) -> tuple[list[_Made], list[InputError]]:
    """Return what ``make`` makes of each item, and the errors of the items of which it makes nothing."""
    made: list[_Made] = []
    errors: list[InputError] = []
    for item in items:
        try:
            made.append(make(item))
        except InputError as error:
            errors.append(error)
    return made, errors
