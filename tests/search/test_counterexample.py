"""A violation that was found becomes a simple one, in as few slow runs as it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness.admission.admit import Admitted, Admitter, admit
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.search.confirm import Complaint
from safety_harness.search.counterexample import (
    DRAWS,
    Allowance,
    Counterexample,
    Explanation,
    contact_words,
    counterexample_of,
)
from safety_harness.search.trials import ScenarioRunner, in_kinematic
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[2]
FOUND = read_scenario(ROOT / "scenarios" / "fast-reach.yaml")
(CLAIM,) = [one for one in FOUND.claims if one.expected is Verdict.VIOLATED][:1]


REMEMBERS = """
import numpy as np
from safety_harness import Proposal

class Tired:
    name, asked = "tired", 0

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        self.asked += 1
        tcp = np.asarray(tcp_position_in_base_m)
        away = tcp - np.asarray(hand_position_in_base_m)
        return Proposal(tcp + 0.1 / (1 + self.asked) * away, np.zeros(3))
"""


class Counted:
    """A world that counts the scenarios that it was given."""

    def __init__(self, run: ScenarioRunner = in_kinematic) -> None:
        self.run, self.runs = run, 0

    def __call__(self, admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        self.runs += len(admitted)
        return self.run(admitted)


def shrunk(world: ScenarioRunner, sooner: ScenarioRunner | None = None) -> Counterexample:
    one = counterexample_of(FOUND, Complaint(CLAIM), world, budget=200, sooner=sooner)
    assert one is not None
    return one


@pytest.fixture(scope="module")
def alone() -> tuple[Counterexample, int]:
    world = Counted()
    return shrunk(world), world.runs


def test_a_world_asked_sooner_saves_the_other_most_runs_and_changes_nothing(
    alone: tuple[Counterexample, int],
) -> None:
    world, sooner = Counted(), Counted()
    with_it = shrunk(world, sooner)
    assert with_it.shrunk == alone[0].shrunk
    assert sooner.runs > with_it.shrunk.used
    assert world.runs == 2 + DRAWS  # as found, as shrunk, and the draws


def test_one_that_does_not_show_what_was_found_is_not_asked_again(alone: tuple[Counterexample, int]) -> None:
    world, blind = Counted(), Counted(lambda admitted: [RuntimeError("sees nothing")] * len(admitted))
    assert shrunk(world, blind).shrunk == alone[0].shrunk
    assert blind.runs == 1
    assert world.runs <= alone[1]


def test_what_the_confirming_world_does_not_show_is_never_taken(alone: tuple[Counterexample, int]) -> None:
    def stricter(admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        found = in_kinematic(admitted)
        return [
            RuntimeError("too short") if one.scenario.duration_s < 2.0 else run
            for one, run in zip(admitted, found, strict=True)
        ]

    assert shrunk(stricter, in_kinematic).shrunk.scenario.duration_s >= 2.0


class Watched(Admitter):
    """An admitter that lists the scenarios whose programs it starts anew."""

    def __init__(self) -> None:
        super().__init__()
        self.afresh: list[Scenario] = []

    def admit_afresh(self, scenario: Scenario) -> Admitted:
        self.afresh.append(scenario)
        return super().admit_afresh(scenario)


def test_what_is_written_was_shown_by_a_program_without_memory_of_other_runs(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(REMEMBERS)
    found = replace(FOUND, avoider=f"{tmp_path / 'mine.py'}:Tired")
    admitter = Watched()
    case = counterexample_of(found, Complaint(CLAIM), in_kinematic, budget=30, admitter=admitter)
    assert case is not None
    assert case.shrunk.used == 30
    assert admitter.afresh[0] == found
    assert case.shrunk.scenario in admitter.afresh[1:]
    (alone,) = in_kinematic([admit(case.shrunk.scenario)])
    assert Complaint(CLAIM).is_in(alone)


@pytest.mark.parametrize("total_s", [0.0, 30.0, 100.0, 400.0, 3000.0])
def test_no_explanation_no_shrinking_and_no_draw_costs_more_than_the_allowance(total_s: float) -> None:
    def explain(
        scenario: Scenario, claim: Claim, allowance: Allowance, *, confirms: bool = True
    ) -> Explanation:
        allowance.spend(KINEMATIC, [scenario] * 30)
        return Explanation(("why",))

    allowance = Allowance(total_s, until_s=total_s)
    case = counterexample_of(
        FOUND, Complaint(CLAIM), in_kinematic, budget=200, explain=explain, allowance=allowance
    )
    assert case is not None  # a confirmed violation is never lost
    assert case.is_cut == (total_s < 3000.0)
    assert bool(case.attribution) == (total_s >= 400.0)
    assert allowance.spent_s <= total_s


@pytest.mark.parametrize("total_s", [60.0, 1e6])
def test_ctrl_c_while_shrinking_stays_known_although_nothing_is_left_for_a_confirmation(
    total_s: float,
) -> None:
    allowance = Allowance(total_s, until_s=total_s)
    tried = Counted()

    def sooner(admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        if tried.runs == 3:
            allowance.spent_s = max(allowance.spent_s, allowance.total_s - 1.0)
            raise KeyboardInterrupt
        return tried(admitted)

    case = counterexample_of(
        FOUND, Complaint(CLAIM), in_kinematic, budget=200, sooner=sooner, allowance=allowance
    )
    assert case is not None
    assert case.shrunk.interrupted
    assert case.shrunk.scenario == FOUND  # what no run confirmed is not kept


def test_contact_as_found_is_told_although_shrinking_leaves_none(alone: tuple[Counterexample, int]) -> None:
    """``fast-reach`` has a hand 76 mm inside the arm; what it shrinks to only has to violate 50 mm."""
    (found,) = in_kinematic([admit(FOUND)])
    assert isinstance(found, Trace)
    assert alone[0].found_contact == contact_words(found) == "contact"
    assert alone[0].contact == contact_words(alone[0].run)


def test_a_run_without_an_end_is_no_evidence_of_no_contact() -> None:
    calm = read_scenario(ROOT / "scenarios" / "hand-visits-and-leaves.yaml")
    (run,) = in_kinematic([admit(calm)])
    assert isinstance(run, Trace)
    assert contact_words(run) == "no contact"
    assert contact_words(replace(run, ticks=run.ticks[: len(run.ticks) // 8])) == "contact unknown"
    assert contact_words(replace(run, ticks=run.ticks[:0])) == "contact unknown"
    assert contact_words(RuntimeError("the engine broke")) == "contact unknown"
