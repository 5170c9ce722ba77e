"""Scenarios that an avoider of the command line cannot take: they are skipped, and the others are tried.

A network that was trained for another workspace is one reason, a measured profile of another avoider another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from safety_harness.admission.admit import check
from safety_harness.admission.avoiders import refuse_same, told_avoider, with_avoider
from safety_harness.base.exceptions import InadmissibleError, InputError, Place
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.write import write_scenario

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
    found, tested = [], None
    for reference, option in avoiders:
        try:
            made = scenario if reference is None else with_avoider(scenario, reference, Place(field=option))
            refuse_same(tested, made, option)
            found.append(look(made))
        except InputError as error:
            if reference is None:
                raise
            check(scenario)
            return NotTaken(scenario.name, told_avoider(reference), error)
        tested = made
    return found


def made_equal(scenarios: Sequence[Scenario], reference: str | None, option: str) -> dict[str, NotTaken]:
    """By their names the rows of a matrix that one avoider in place of theirs makes the same scenario.

    Each would hold under a name that says otherwise.
    """
    rows: dict[tuple[Path | None, str], list[Scenario]] = {}
    if reference is None:
        return {}
    for one in scenarios:
        if one.name.endswith("]"):
            with suppress(InputError):  # which is told of it alone
                same = write_scenario(replace(with_avoider(one, reference), claims=scenarios[0].claims))
                rows.setdefault((one.file, same), []).append(one)
    found: dict[str, NotTaken] = {}
    for alike in rows.values():
        if len({one.under_test for one in alike}) > 1:
            names = ", ".join(one.name for one in alike)
            error = InadmissibleError(
                place=Place(file=alike[0].file, field=option),
                expected="rows of a matrix that differ",
                got=f"the same scenario in {names}, with one avoider in place of theirs",
            )
            found |= {one.name: NotTaken(one.name, told_avoider(reference), error) for one in alike}
    return found


def not_taken_words(skipped: Sequence[NotTaken]) -> str:
    """How many cannot be taken by which avoider; empty for none."""
    names = dict.fromkeys(one.avoider for one in skipped)
    return ", ".join(
        f"{sum(one.avoider == name for one in skipped)} cannot be taken by {name}" for name in names
    )
