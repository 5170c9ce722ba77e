"""Provide ``scenarios``: the scenarios of a file, a folder or a space as a Hypothesis strategy."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

from hypothesis import reject
from hypothesis import strategies as st

from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.exceptions import InputError, refuse_other_type
from safety_harness.scenario.expand import gather
from safety_harness.scenario.files import as_path
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import TESTED, Scalar
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace, each_to_hold
from safety_harness.space.strategy import strategy
from safety_harness.testing.simulating import as_asked, checker, digest_of, sought_from

_MARK = "_safety_harness_scenarios"


def scenarios(source: str | Path | ScenarioSpace) -> st.SearchStrategy[Scenario]:
    """Return a Hypothesis strategy for the scenarios of ``source``.

    The call reads and checks the whole source at once.

    Args:
        source: a scenario space, as a file or an object, or a file or folder with scenarios.  From a space,
            the strategy draws admissible scenarios.  From a scenario file, a matrix, a suite or a folder, it
            draws one of the scenarios.  A relative path starts at the folder of the calling file or else at
            pytest's root. ``shipped:NAME`` names a scenario of the package.

    Raises:
        InputError: the source is not valid.  The error names the place of the mistake, and a note names the
            calling line.

    """
    frame = inspect.currentframe()
    caller = frame.f_back if frame is not None else None
    try:
        if isinstance(source, ScenarioSpace):
            return drawn(source)
        expected = "a path or a scenario space"
        refuse_other_type("scenarios(source)", source, str, Path, expected=expected)
        path = as_path(source, "scenarios(source)", of_text="parse_space")
        return _of_files(sought_from(path, caller))
    except InputError as error:
        if caller is not None:
            error.add_note(f"asked for at {caller.f_code.co_filename}:{caller.f_lineno}")
        raise


def _of_files(path: Path) -> st.SearchStrategy[Scenario]:
    gathered = gather([path], spaces=True)
    if gathered.errors:
        raise gathered.errors[0]
    for scenario in gathered.scenarios:
        checker.check(as_asked(scenario))
    parts: list[st.SearchStrategy[Scenario]] = []
    if gathered.scenarios:
        parts.append(_marked(st.sampled_from(gathered.scenarios)))
    for variant, file in gathered.spaces:
        parts.append(drawn(space_of(variant.tree, file, name=variant.name)))
    return _marked(st.one_of(parts)) if len(parts) > 1 else parts[0]


def drawn(space: ScenarioSpace) -> st.SearchStrategy[Scenario]:
    """Return a strategy for the admissible draws of ``space``; each draw has its own name.

    Raises:
        InputError: admission refuses nearly every draw of the space.

    """
    checker.check(as_asked(first_of(space)))
    return _marked(_admissible(space), one_system(space))


def first_of(space: ScenarioSpace) -> Scenario:
    """Return an admissible draw, checked without the avoider.

    Raise InputError if admission refuses nearly all draws.
    """
    return draw_admissible(space, seed=0, count=1).scenarios[0]


def gives_scenarios(strategy: object) -> bool:
    """Return whether this module created ``strategy``."""
    return hasattr(strategy, _MARK)


def one_system(space: ScenarioSpace) -> Scenario | None:
    """Return a scenario with the avoider or controller that all draws have.

    The result is None if the space varies the avoider or controller.
    """
    tested = [value for key, value in space.template.entries if key.text in TESTED]
    return space.simplest if all(isinstance(value, Scalar) for value in tested) else None


def one_system_of(strategy: object) -> Scenario | None:
    """Return the result of ``one_system`` for a strategy.

    Return None if the strategy draws from several files.
    """
    return getattr(strategy, _MARK, None)


def _marked(
    strategy: st.SearchStrategy[Scenario], like: Scenario | None = None
) -> st.SearchStrategy[Scenario]:
    setattr(strategy, _MARK, like)
    return strategy


@st.composite
def _admissible(draw: st.DrawFn, space: ScenarioSpace) -> Scenario:
    scenario = draw(strategy(space))
    try:
        checker.check(as_asked(scenario))
    except InputError:  # this draw is out of reach or view, as a small share of draws is
        reject()
    name = f"{space.name}#{digest_of(scenario)[:6]}"
    return replace(scenario, name=name, claims=each_to_hold(scenario.claims))
