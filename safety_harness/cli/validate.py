"""Define ``safety-harness validate``, which reads and checks files without executing any of them."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TypeVar

from safety_harness.admission.admit import Checked, Checker
from safety_harness.admission.avoiders import option_of, with_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.extension_points import CheckedFile, InputFile
from safety_harness.base.input_errors import InputErrors, usable
from safety_harness.base.interpreted import without_compiling
from safety_harness.base.shipped.contents import located
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    INTERRUPTED,
    document,
    explain_each,
    next_step,
    result,
    say,
)
from safety_harness.scenario.compose import Variant
from safety_harness.scenario.expand import Gathered, gather
from safety_harness.scenario.fields import every_mistake
from safety_harness.scenario.kinds import added_input
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import TESTED
from safety_harness.scenario.ours import aside_lines
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace

_Made = TypeVar("_Made")
# Top-level keys whose examples need no remark about an avoider or controller.
_CHANGE_WHAT_IS_TESTED = frozenset({*TESTED, "robot", "settings", "camera"})


def validate(paths: Sequence[Path], avoider: str | None = None) -> int:
    """Print a line for each usable file, and all mistakes in the other files.

    Return the exit code.
    """
    added = [path for path in paths if _is_added(located(path))]
    scenario_paths = [path for path in paths if path not in added]
    try:
        gathered = gather(scenario_paths, spaces=True) if scenario_paths or not added else Gathered()
        added += [file for file in gathered.aside if _is_added(file)]
        say(*aside_lines(file for file in gathered.aside if file not in added))
        checker = Checker()  # a Checker executes nothing
        checked, errors = usable(
            gathered.scenarios,
            lambda scenario: without_compiling(
                lambda: checker.check(scenario if avoider is None else with_avoider(scenario, avoider))
            ),
        )
        untried = without_compiling(lambda: _untried(checked))
        spaces, errors_of_spaces = usable(
            gathered.spaces,
            lambda variant: without_compiling(
                lambda: _whole(lambda: _tried_space(variant, checker, avoider))
            ),
        )
        read, errors_of_added = usable(
            added, lambda path: without_compiling(lambda: _whole(lambda: _checked(located(path), checker)))
        )
    except KeyboardInterrupt:
        say("interrupted")
        return INTERRUPTED
    # Admission stops at a scenario's first mistake; these checks run whatever else is wrong.
    read_in_part = (*gathered.scenarios, *(mended.scenario for mended in gathered.mended))
    claims = [(claim, scenario) for scenario in read_in_part for claim in scenario.claims]
    _, of_claims = usable(claims, lambda pair: property_of(*pair))
    tested = [case.scenario for case in gathered.mended if not case.faulty & _CHANGE_WHAT_IS_TESTED]
    if avoider is None:
        tested += gathered.scenarios
    _, of_tested = usable(tested, checker.check_tested)
    errors = [*gathered.errors, *errors, *of_claims, *of_tested, *errors_of_spaces, *errors_of_added]
    errors = [inner for error in errors for inner in getattr(error, "errors", (error,))]
    errors.sort(key=lambda error: (str(error.place.file or ""), error.place.line or 0))
    bad = {error.place.file for error in errors}
    usable_files: list[dict[str, object]] = []
    for file, scenarios in groupby(checked, key=lambda case: case.scenario.file):
        if file not in bad:
            in_file = [case.scenario for case in scenarios]
            result(f"ok {file}: {_content_text(in_file)}")
            usable_files.append({"file": file, "kind": "scenario", "scenarios": [*map(_data, in_file)]})
    for space in spaces:
        result(f"ok {space.file}: a space, {_count(len(space.parameters), 'value')} that vary")
        usable_files.append({"file": space.file, "kind": "space", "parameters": len(space.parameters)})
    for kind, added_file in read:
        result(f"ok {added_file.file}: {kind.words}, {added_file.words}")
        usable_files.append({"file": added_file.file, "kind": kind.title} | added_file.data)
    document(usable=usable_files)
    for space in (*spaces, *(space for _, checked in read for space in checked.spaces)):
        untried += without_compiling(partial(_untried_of, space))
    say(*(f"note: {line}" for line in untried))
    if errors:
        mistakes = _count(len(explain_each(errors)), "mistake")
        rest = f"{_count(len(checked), 'scenario')} and {_count(len(spaces), 'space')}"
        for title, count in Counter(kind.title for kind, _ in read).items():
            rest += f" and {_count(count, title)}"
        say(f"{mistakes}; {rest} can be used")
    chosen = [] if avoider is None else [option_of(avoider), avoider]
    if checked and not (spaces or read or errors):
        next_step(shlex.join(["safety-harness", "run", *map(str, paths), *chosen]))
    elif len(spaces) == 1 and len(paths) == 1 and paths[0].suffix and not (checked or read or errors):
        next_step(shlex.join(["safety-harness", "fuzz", str(paths[0]), *chosen]))
    return BAD_INPUT if errors else AS_EXPECTED


def _is_added(path: Path) -> bool:
    """Return whether an installed package defines and checks this kind of file."""
    kind = added_input(path)
    return kind is not None and kind.check is not None


def _checked(path: Path, checker: Checker) -> tuple[InputFile, CheckedFile]:
    kind = added_input(path)
    assert kind is not None
    assert kind.check is not None
    return kind, kind.check(path, checker.check)


def _whole(read: Callable[[], _Made]) -> _Made:
    """Return the result of ``read``.

    Raise InputErrors with all mistakes that ``read`` found, if there are any.
    """
    with every_mistake() as mistakes:
        made = read()
    if mistakes:
        raise InputErrors(mistakes)
    return made


def _tried_space(variant_file: tuple[Variant, Path], checker: Checker, avoider: str | None) -> ScenarioSpace:
    """Check one admissible draw of a space, and return the space.

    If ``avoider`` is given, it is checked as the draw's avoider.
    """
    variant, file = variant_file
    space = space_of(variant.tree, file, name=variant.name)
    (drawn,) = draw_admissible(space, seed=0, count=1).scenarios
    if avoider is not None:
        checker.check_tested(with_avoider(drawn, avoider))
    return space


DRAWS = 5  # draws of a space in which untried moves and faults are sought


def _untried_of(space: ScenarioSpace) -> list[str]:
    draws = draw_admissible(space, seed=0, count=DRAWS).scenarios
    return _untried([*map(Checker().check, draws)], space)


def _untried(checked: Sequence[Checked], *spaces: ScenarioSpace) -> list[str]:
    """Return lines that list moves and faults.

    No scenario would exercise them if the arm stood still.
    """
    tried = TriedParts()
    for draw in checked:
        tried.suppose(draw.scenario, links_in_base(draw.arm, draw.joint_position_rad)[-1, :3, 3].copy())
    return tried.lines(*spaces, subject="runs beside an arm that stood still")


def _data(scenario: Scenario) -> dict[str, object]:
    return {
        "scenario": scenario.name,
        "hands": len(scenario.hands),
        "claims": [claim.sentence for claim in scenario.claims],
        "duration_s": scenario.duration_s,
        "controller" if scenario.driven else "avoider": str(scenario.under_test),
    }


def _content_text(scenarios: Sequence[Scenario]) -> str:
    """Return a text on the content of a file, such as ``2 hands, 3 claims, 8 s``.

    For a matrix, the text also states the number of scenarios.
    """
    scenario = scenarios[0]
    parts = [_count(len(scenario.hands), "hand"), _count(len(scenario.claims), "claim")]
    parts += [f"{scenario.duration_s:g} s", scenario.under_test]
    if len(scenarios) > 1:
        parts.insert(0, _count(len(scenarios), "scenario"))
    return ", ".join(parts)


def _count(number: int, noun: str, many: str = "") -> str:
    return f"{number or 'no'} {noun if number == 1 else many or f'{noun}s'}"
