"""Scenarios that an avoider of the command line cannot take: they are skipped, and the others are tried.

A network that was trained for another workspace is one reason, a measured profile of another avoider another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from safety_harness.admission.admit import check
from safety_harness.admission.avoiders import told_avoider, with_avoider
from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.model import Scenario

_Looked = TypeVar("_Looked")


@dataclass(frozen=True)
class NotTaken:
    """A scenario that is in order, and cannot be tried with ``avoider``."""

    scenario: str
    avoider: str
    error: InputError

    def __str__(self) -> str:
        e = self.error
        return f"{self.scenario} cannot be taken by {self.avoider}: expected {e.expected}, got {e.got}"


def taken(
    scenario: Scenario, avoiders: Sequence[tuple[str | None, str]], look: Callable[[Scenario], _Looked]
) -> list[_Looked] | NotTaken:
    """What ``look`` makes of the scenario with each of ``avoiders`` (None: its own), named by their option.

    InputError if the scenario is not in order whichever avoider it has, or its own is not.
    """
    found = []
    for reference, option in avoiders:
        if reference is None:
            found.append(look(scenario))
            continue
        try:
            found.append(look(with_avoider(scenario, reference, Place(field=option))))
        except InputError as error:
            check(scenario)
            return NotTaken(scenario.name, told_avoider(reference), error)
    return found


def not_taken_words(skipped: Sequence[NotTaken]) -> str:
    """How many cannot be taken by which avoider; empty for none."""
    names = dict.fromkeys(one.avoider for one in skipped)
    return ", ".join(
        f"{sum(one.avoider == name for one in skipped)} cannot be taken by {name}" for name in names
    )
