"""``safety-harness validate``: read and check files, execute nothing, tell every mistake."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from safety_harness.admission.admit import Checked, Looker
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.spaces import draw_admissible
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, explain_each, result, say
from safety_harness.exceptions import InputError
from safety_harness.scenario.expand import Gathered, gather
from safety_harness.scenario.model import Scenario
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace


def validate(paths: Sequence[Path], avoider: str | None = None) -> int:
    """A line for each file that can be used, every mistake of the others; returns the exit code."""
    try:
        gathered = gather(paths, spaces=True)
        usable, errors = _looked_at(gathered.scenarios, avoider)
        spaces, errors_of_spaces = _spaces(gathered)
    except KeyboardInterrupt:
        say("interrupted")
        return INTERRUPTED
    of_claims = errors_of_claims(gathered.scenarios)
    errors = [*gathered.errors, *errors, *of_claims, *errors_of_spaces]
    bad = {error.place.file for error in errors}
    for file, scenarios in groupby(usable, key=lambda one: one.scenario.file):
        if file not in bad:
            result(f"ok {file}: {_words(list(scenarios))}")
    for space in spaces:
        result(f"ok {space.file}: a space, {_count(len(space.parameters), 'value')} that vary")
    if errors:
        mistakes = _count(explain_each(errors), "mistake")
        rest = f"{_count(len(usable), 'scenario')} and {_count(len(spaces), 'space')}"
        say(f"{mistakes}; {rest} can be used")
    return BAD_INPUT if errors else AS_EXPECTED


def _looked_at(scenarios: Sequence[Scenario], avoider: str | None) -> tuple[list[Checked], list[InputError]]:
    """Those that can be tried, as far as that shows without executing anything, and why others cannot."""
    found: list[Checked] = []
    errors: list[InputError] = []
    looker = Looker()
    for scenario in scenarios:
        try:
            found.append(looker.look(scenario if avoider is None else with_avoider(scenario, avoider)))
        except InputError as error:
            errors.append(error)
    return found, errors


def errors_of_claims(scenarios: Sequence[Scenario]) -> list[InputError]:
    """The mistake in each claim; admission stops at a scenario's first one."""
    errors: list[InputError] = []
    for scenario in scenarios:
        for claim in scenario.claims:
            try:
                property_of(claim, scenario)
            except InputError as error:
                errors.append(error)
    return errors


def _spaces(gathered: Gathered) -> tuple[list[ScenarioSpace], list[InputError]]:
    """The spaces of which a draw can be tried, and the mistakes in the others."""
    found, errors = [], []
    for variant, file in gathered.spaces:
        try:
            space = space_of(variant.tree, file, name=variant.name)
            draw_admissible(space, seed=0, count=1)
            found.append(space)
        except InputError as error:
            errors.append(error)
    return found, errors


def _words(admitted: Sequence[Checked]) -> str:
    """What a file holds: ``2 hands, 3 claims, 8 s``; for a matrix the number of its scenarios as well."""
    scenario = admitted[0].scenario
    words = [_count(len(scenario.hands), "hand"), _count(len(scenario.claims), "claim")]
    words += [f"{scenario.duration_s:g} s", scenario.avoider]
    if len(admitted) > 1:
        words.insert(0, _count(len(admitted), "scenario"))
    return ", ".join(words)


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
