"""An error that collects the errors of several inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeVar

from safety_harness.base.exceptions import InputError

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")


class InputErrors(InputError):
    """Several inputs cannot be used, and the command did no work.

    The message is that of the first error, with the other errors in its hint.  ``errors`` holds all of them.

    Args:
        errors: At least one error.
        left: The number of usable inputs.

    """

    def __init__(self, errors: Sequence[InputError], left: int = 0) -> None:
        self.errors, self.left = tuple(errors), left
        first, *rest = self.errors
        hint = "; ".join(filter(None, [first.hint, *(f"and {error}" for error in rest)]))
        super().__init__(place=first.place, expected=first.expected, got=first.got, hint=hint)

    @property
    def inputs(self) -> int:
        """The number of files with an error; an error without a file counts as one more."""
        files = [error.place.file for error in self.errors]
        return len({file for file in files if file is not None}) + files.count(None)

    def __reduce__(self) -> tuple[partial[InputError], tuple[()]]:
        return partial(InputErrors, self.errors, self.left), ()  # type: ignore[return-value]


def each_once(errors: Iterable[InputError]) -> list[InputError]:
    """Return each error once, because a mistake in a shared base file occurs in every file that uses it."""
    return list({str(error): error for error in errors}.values())


def usable(items: Iterable[_Item], make: Callable[[_Item], _Made]) -> tuple[list[_Made], list[InputError]]:
    """Return the results of ``make`` for the items, and the errors of those items for which it failed."""
    made: list[_Made] = []
    errors: list[InputError] = []
    for item in items:
        try:
            made.append(make(item))
        except InputError as error:
            errors.append(error)
    return made, errors
