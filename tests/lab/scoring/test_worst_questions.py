"""The search for the worst questions: it finds a planted fault, repeats, and keeps its own ledger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.cell.avoidance.measures import gained_m, optimum_in_base_m
from safety_harness.extensions.lab.scoring import worst as module
from safety_harness.extensions.lab.scoring.asking import asked_together
from safety_harness.extensions.lab.scoring.question_file import begins_clear, seed_of
from safety_harness.extensions.lab.scoring.questions import Questions
from safety_harness.extensions.lab.scoring.regions import QuestionRegion, named_regions
from safety_harness.extensions.lab.scoring.worst import (
    Objective,
    QuestionSearch,
    search_region,
    worst_questions,
)
from safety_harness.space.regions import paper_seen

Floats = NDArray[np.float64]
SEEN = named_regions(paper_seen(DEFAULTS), DEFAULTS)[0]
PLACE = np.array([0.80, -0.20, 0.15])


@dataclass(eq=False)
class WrongNear:
    """The closed form, but the farther towards the hand the nearer the hand is to ``PLACE``."""

    name: str = "wrong near a place"
    spread_threshold_m: float | None = None
    fails: bool = False

    def propose(
        self, *, hand_position_in_base_m: Floats, tcp_position_in_base_m: Floats, seed: int
    ) -> Proposal:
        if self.fails:
            raise ValueError("no")
        hand, tcp = hand_position_in_base_m, tcp_position_in_base_m
        optimum = optimum_in_base_m(DEFAULTS, hand[None], tcp[None])[0]
        wrong = np.exp(-(np.linalg.norm(hand - PLACE) ** 2) / (2 * 0.08**2))
        return Proposal(optimum + wrong * (hand - optimum))


def searched(avoider: WrongNear, region: QuestionRegion = SEEN, **options: int) -> QuestionSearch:
    wanted = {"budget": 600, "seed": 1} | options
    return search_region(avoider, region, budget=wanted["budget"], seed=wanted["seed"], number=0)


def test_a_fault_in_a_place_is_found_and_nearer_than_chance_finds_it() -> None:
    found = worst_questions([searched(WrongNear())], 10)
    objective, worst = found[0]
    assert objective is Objective.TOWARDS
    assert np.linalg.norm(worst.hand_in_base_m - PLACE) < 0.12
    drawn = SEEN.draw(np.random.default_rng(0), 600)
    rows = [drawn.single(k) for k in range(len(drawn))]
    proposed = np.array(
        [
            WrongNear()
            .propose(**{k: v for k, v in one._asdict().items() if k not in ("limit_s", "seen")})
            .position_in_base_m
            for one in rows
        ]
    )
    assert worst.gained_m < gained_m(drawn.hands_in_base_m, drawn.tcps_in_base_m, proposed).min()


def test_the_worst_of_each_objective_come_in_turn_and_lie_apart() -> None:
    found = worst_questions([searched(WrongNear())], 10)
    assert len(found) == 10
    assert [objective for objective, _ in found[:4]] == [*Objective, *Objective]
    for k, (_, one) in enumerate(found):
        assert all(one.apart_m(other) > module.APART_M for _, other in found[:k])
    badness = [one.badness_m(Objective.TOWARDS) for objective, one in found if objective is Objective.TOWARDS]
    assert badness == sorted(badness, reverse=True)


def test_every_question_is_in_the_region_and_has_a_declared_seed() -> None:
    ledger = searched(WrongNear())
    hands = np.array([one.hand_in_base_m for one in ledger.tried])
    tcps = np.array([one.tcp_in_base_m for one in ledger.tried])
    assert ledger.asked == len(ledger.tried) == 600
    assert SEEN.holds(hands, tcps).all()
    assert all(begins_clear(DEFAULTS, hand, tcp) for hand, tcp in zip(hands, tcps, strict=True))
    assert len({one.scenario_seed for one in ledger.tried}) == module.SEEDS


def test_a_search_repeats_from_its_seed_and_no_other() -> None:
    def hands(seed: int) -> list[list[float]]:
        return [one.hand_in_base_m.tolist() for one in searched(WrongNear(), budget=200, seed=seed).tried]

    assert hands(1) == hands(1)
    assert hands(1) != hands(2)


def test_the_avoider_is_asked_with_the_seed_that_a_run_asks_with() -> None:
    asked: list[int] = []

    class Listens(WrongNear):
        def propose(self, **question: object) -> Proposal:
            asked.append(question["seed"])  # type: ignore[arg-type]
            return super().propose(**question)  # type: ignore[arg-type]

    ledger = searched(Listens(), budget=64)
    assert set(asked) == {seed_of(one.scenario_seed) for one in ledger.tried}


def test_a_sound_answer_is_no_worst_question_however_little_there_is_that_is_worse() -> None:
    @dataclass(eq=False)
    class Sound(WrongNear):
        def propose(self, **question: Floats) -> Proposal:  # type: ignore[override]
            hand, tcp = question["hand_position_in_base_m"], question["tcp_position_in_base_m"]
            return Proposal(tcp + 0.1 * (tcp - hand) / np.linalg.norm(tcp - hand), np.full(3, 0.1))

    assert worst_questions([searched(Sound(spread_threshold_m=0.05), budget=200)], 10) == []


def test_an_avoider_in_doubt_is_not_wrong_and_sure() -> None:
    @dataclass(eq=False)
    class Doubts(WrongNear):
        def propose(self, **question: object) -> Proposal:
            return Proposal(super().propose(**question).position_in_base_m, np.full(3, 0.1))  # type: ignore[arg-type]

    ledger = searched(Doubts(spread_threshold_m=0.05), budget=200)
    assert {objective for objective, _ in worst_questions([ledger], 10)} == {Objective.TOWARDS}


def test_what_is_not_answered_is_counted_and_is_no_worst_question() -> None:
    ledger = searched(WrongNear(fails=True), budget=100)
    assert (ledger.asked, ledger.unanswered, ledger.tried) == (100, 100, [])
    assert worst_questions([ledger], 10) == []


def test_ctrl_c_keeps_what_was_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    left = [3]

    def interrupted(avoider: WrongNear, questions: Questions) -> object:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return asked_together(avoider, questions)

    monkeypatch.setattr(module, "asked_together", interrupted)
    ledger = searched(WrongNear())
    assert ledger.interrupted
    assert 0 < len(ledger.tried) < 600


def test_a_budget_of_none_asks_nothing() -> None:
    assert searched(WrongNear(), budget=0).asked == 0
