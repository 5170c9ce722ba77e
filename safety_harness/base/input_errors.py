"""An error that collects the errors of several inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeVar

from safety_harness.base.exceptions import InputError

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")


class InputErrors(InputError):
    """Several inputs cannot be used, and the command has not done any work.

    The message is the message of the first error, and the hint contains the remaining errors.  The attribute
    ``errors`` contains all errors.

    Args:
        errors: At least one error.
        left: The number of inputs that can be used.

    """

    def __init__(self, errors: Sequence[InputError], left: int = 0) -> None:
        self.errors, self.left = tuple(errors), left
        first, *rest = self.errors
        hint = "; ".join(filter(None, [first.hint, *(f"and {error}" for error in rest)]))
        super().__init__(place=first.place, expected=first.expected, got=first.got, hint=hint)

    @property
    def inputs(self) -> int:
        """The number of inputs with an error.

        All errors of one file count once, and each error without a file counts separately.
        """
        files = [error.place.file for error in self.errors]
        return len({file for file in files if file is not None}) + files.count(None)

    def __reduce__(self) -> tuple[partial[InputError], tuple[()]]:
        return partial(InputErrors, self.errors, self.left), ()  # type: ignore[return-value]


def each_once(errors: Iterable[InputError]) -> list[InputError]:
    """Return each distinct error once.

    A mistake in a shared base file otherwise occurs once per file that uses the base file.
    """
    return list({str(error): error for error in errors}.values())


def usable(items: Iterable[_Item], make: Callable[[_Item], _Made]) -> tuple[list[_Made], list[InputError]]:
    """Return the results of ``make`` for the usable items, and the errors for the remaining items."""
    made: list[_Made] = []
    errors: list[InputError] = []
    for item in items:
        try:
            made.append(make(item))
        except InputError as error:
            errors.append(error)
    return made, errors
