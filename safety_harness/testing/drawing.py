"""``scenarios``: what a file, a folder or a space holds, as a Hypothesis strategy."""

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
from safety_harness.scenario.nodes import Scalar
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace, each_to_hold
from safety_harness.space.strategy import strategy
from safety_harness.testing.simulating import as_asked, digest_of, looker, sought_from

_MARK = "_safety_harness_scenarios"


def scenarios(source: str | Path | ScenarioSpace) -> st.SearchStrategy[Scenario]:
    """Scenarios to put a test through.

    ``source`` is a scenario space (a file, or an object): draws of it that can be tried; or a scenario
    file, a matrix, a suite or a folder: one of its scenarios.  A relative path is sought from the folder
    of the file that asks for it, then from pytest's root; ``shipped:NAME`` is one of ours.  All of it is
    read and checked here: InputError says where the mistake stands, and a note which line asked.
    """
    frame = inspect.currentframe()
    asked = frame.f_back if frame is not None else None
    try:
        if isinstance(source, ScenarioSpace):
            return drawn(source)
        expected = "a path or a scenario space"
        refuse_other_type("scenarios(source)", source, str, Path, expected=expected)
        path = as_path(source, "scenarios(source)", of_text="parse_space")
        return _of_files(sought_from(path, asked))
    except InputError as error:
        if asked is not None:
            error.add_note(f"asked for at {asked.f_code.co_filename}:{asked.f_lineno}")
        raise


def _of_files(path: Path) -> st.SearchStrategy[Scenario]:
    gathered = gather([path], spaces=True)
    if gathered.errors:
        raise gathered.errors[0]
    for scenario in gathered.scenarios:
        looker.look(as_asked(scenario))
    parts: list[st.SearchStrategy[Scenario]] = []
    if gathered.scenarios:
        parts.append(_marked(st.sampled_from(gathered.scenarios)))
    for variant, file in gathered.spaces:
        parts.append(drawn(space_of(variant.tree, file, name=variant.name)))
    return _marked(st.one_of(parts)) if len(parts) > 1 else parts[0]


def drawn(space: ScenarioSpace) -> st.SearchStrategy[Scenario]:
    """Draws of a space that admission lets through, each with a name of its own.

    InputError for a space of which next to nothing can be tried.
    """
    looker.look(as_asked(first_of(space)))
    return _marked(_admissible(space), one_system(space))


def first_of(space: ScenarioSpace) -> Scenario:
    """A draw that can be tried, as far as its avoider goes not into it; InputError if next to none can be."""
    return draw_admissible(space, seed=0, count=1).scenarios[0]


def gives_scenarios(strategy: object) -> bool:
    """Is it a strategy from here?"""
    return hasattr(strategy, _MARK)


def one_system(space: ScenarioSpace) -> Scenario | None:
    """A scenario with the avoider or the controller of all draws; None for a space that varies it."""
    tested = [one for key, one in space.template.entries if key.text in ("avoider", "controller")]
    return space.simplest if all(isinstance(one, Scalar) for one in tested) else None


def one_system_of(strategy: object) -> Scenario | None:
    """That of a strategy from here; None as well where its scenarios come from several files."""
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
        looker.look(as_asked(scenario))
    except InputError:  # out of reach, out of view: what one draw in so many is
        reject()
    name = f"{space.name}#{digest_of(scenario)[:6]}"
    return replace(scenario, name=name, claims=each_to_hold(scenario.claims))
