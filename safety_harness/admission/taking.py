"""Skip scenarios that cannot run with an avoider from the command line.

For example, the network was trained for another workspace, or the measured profile belongs to another
avoider.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from safety_harness.admission.admit import check
from safety_harness.admission.avoiders import told_avoider, with_avoider
from safety_harness.admission.comparison import UNFILTERED, refuse_same, with_reference
from safety_harness.base.exceptions import InadmissibleError, InputError, Place
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.write import write_scenario

_Checked = TypeVar("_Checked")


@dataclass(frozen=True)
class Incompatible:
    """A valid scenario that cannot run with ``avoider``, and the reason."""

    scenario: str
    avoider: str
    error: InputError

    def __str__(self) -> str:
        e = self.error
        return f"{self.scenario} is unsuitable for {self.avoider}: expected {e.expected}, got {e.got}"


def accept(
    scenario: Scenario, avoiders: Sequence[tuple[str | None, str]], inspect: Callable[[Scenario], _Checked]
) -> list[_Checked] | Incompatible:
    """Return the results of checking a scenario with each of several avoiders.

    If an avoider cannot run the scenario, the function returns an ``Incompatible`` instead.

    Args:
        scenario: The scenario.
        avoiders: Pairs of an avoider's reference and the option that states it.  The reference None means the
            scenario's own avoider.
        inspect: A function that checks a scenario and returns the result.

    Raises:
        InputError: The scenario cannot run with its own avoider, or cannot run with any avoider.

    """
    results, tested = [], None
    for reference, option in avoiders:
        try:
            made = tested or scenario if reference == UNFILTERED else scenario
            if reference is not None:
                made = with_reference(made, reference, Place(field=option))
            refuse_same(tested, made, option)
            results.append(inspect(made))
        except InputError as error:
            if reference is None:
                raise
            # Raises if the scenario cannot run with its own avoider either.
            check(scenario)
            return Incompatible(scenario.name, told_avoider(reference), error)
        tested = made
    return results


def made_equal(scenarios: Sequence[Scenario], reference: str | None, option: str) -> dict[str, Incompatible]:
    """Return the rows of a matrix that differ only in the avoider that ``reference`` replaces.

    The keys are the names of the rows.  The name of such a row would be misleading, because it states the
    replaced avoider.
    """
    rows: dict[tuple[Path | None, str], list[Scenario]] = {}
    if reference is None:
        return {}
    for row in scenarios:
        if row.name.endswith("]"):
            with suppress(InputError):  # ``accept`` reports it for that scenario alone
                same = write_scenario(replace(with_avoider(row, reference), claims=scenarios[0].claims))
                rows.setdefault((row.file, same), []).append(row)
    equal: dict[str, Incompatible] = {}
    for alike in rows.values():
        if len({row.under_test for row in alike}) > 1:
            names = ", ".join(row.name for row in alike)
            error = InadmissibleError(
                place=Place(file=alike[0].file, field=option),
                expected="rows of a matrix that differ",
                got=f"the same scenario in {names}, with one avoider in place of theirs",
            )
            equal |= {row.name: Incompatible(row.name, told_avoider(reference), error) for row in alike}
    return equal


def not_taken_words(skipped: Sequence[Incompatible]) -> str:
    """Return a text with the number of scenarios that each avoider cannot run.

    The text is empty if the avoiders can run all scenarios.
    """
    names = dict.fromkeys(case.avoider for case in skipped)
    return ", ".join(
        f"{sum(case.avoider == name for case in skipped)} unsuitable for {name}" for name in names
    )
