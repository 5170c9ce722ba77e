"""The default search finds four broken avoiders in real runs, one at a time, with a fixed seed."""

from __future__ import annotations

import pytest

from safety_harness.admission.admit import Admitted, Admitter, admit
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.scenario.model import Scenario
from safety_harness.search.cube import Cube
from safety_harness.search.default import Default
from safety_harness.search.findings import Findings
from safety_harness.search.search import find_violations
from safety_harness.search.trials import Trials, in_pybullet
from tests.search.broken_avoiders import SPACE, Hangs, NoNumber, Overreaches, Raises

BUDGET = 120


class AdmitterOf(Admitter):
    """Every scenario with one avoider, which no file names."""

    def __init__(self, avoider: Avoider) -> None:
        super().__init__()
        self.avoider = avoider

    def admit(self, scenario: Scenario) -> Admitted:
        return admit(scenario, avoider=self.avoider)


def searched(avoider: Avoider, budget: int = BUDGET) -> Findings:
    cube = Cube.from_space(SPACE)
    trials = Trials(SPACE, in_pybullet, seed=0)
    trials._admitter = AdmitterOf(avoider)
    searcher = Default(cube, claims=len(trials.goals), seed=0)
    return find_violations(
        cube,
        trials.goals,
        trials,
        searcher,
        budget=budget,
        enough=lambda findings: bool(findings.violated[0]),
    )


@pytest.mark.parametrize("avoider", [Overreaches(), NoNumber()], ids=lambda avoider: avoider.name)
def test_a_wrong_proposal_is_found(avoider: Avoider) -> None:
    found = searched(avoider)
    assert found.violated[0] == 1
    assert found.violated[1] == 0


@pytest.mark.parametrize(
    ("avoider", "words", "budget"),
    [(Raises(), "ZeroDivisionError: no direction", BUDGET), (Hangs(), "NoAnswerError", 60)],
)
def test_an_avoider_that_raises_or_hangs_in_a_corner_is_found_and_the_search_goes_on(
    avoider: Avoider, words: str, budget: int
) -> None:
    found = searched(avoider, budget=budget)
    assert found.tried == budget or found.violated[0]  # as a run without an answer may do besides
    (group,) = found.of_claim(None)
    assert words in group.kind


def test_in_an_avoider_without_a_bug_nothing_is_found() -> None:
    found = searched(OppositePose(0.1), budget=40)
    assert not found.found_any
    assert found.tried == 40
