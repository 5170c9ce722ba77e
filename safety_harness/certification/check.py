"""The answer to one question about a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

MOST_NAMED = 10


@dataclass(frozen=True)
class Examination:
    """What was looked at, and in which ways it does not stand.

    ``notes`` are no fault; ``unchecked`` says what could not be looked at, which may be anything.
    """

    name: str
    looked_at: str
    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()

    @property
    def stands(self) -> bool:
        """Nothing wrong was found."""
        return not self.faults


def few(faults: Sequence[str]) -> tuple[str, ...]:
    """The first of them, and how many more there are."""
    more = len(faults) - MOST_NAMED
    return (*faults[:MOST_NAMED], *([f"and {more} more"] if more > 0 else []))
