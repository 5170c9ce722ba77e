"""An avoider is scored and its faults are named; what is as good as the yardsticks has no finding."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from doubted import Array, Change, subject

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.scoring import score as scoring
from safety_harness.extensions.lab.scoring.findings import findings
from safety_harness.extensions.lab.scoring.regions import named_regions
from safety_harness.extensions.lab.scoring.repeats import Subject
from safety_harness.extensions.lab.scoring.score import YARDSTICKS, Counts, score, yardsticks
from safety_harness.extensions.lab.scoring.scorecard import Kind, Scorecard
from safety_harness.space.regions import paper_seen

REGIONS = named_regions(paper_seen(DEFAULTS), DEFAULTS)[:2]
COUNTS = Counts(first=3000, other=800, far=100, segments=100, alone=40, sample=120)


@pytest.fixture(autouse=True)
def _later_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No fault here needs that the later questions are much later."""
    monkeypatch.setattr(scoring, "LATER_S", 0.0)


@pytest.fixture(scope="module")
def beside() -> tuple[Scorecard, ...]:
    return yardsticks(REGIONS, seed=3, counts=COUNTS)


SCORED: dict[Change, Scorecard] = {}  # several kinds of finding are looked for in one


def kinds(change: Change, beside: tuple[Scorecard, ...]) -> set[Kind]:
    if change not in SCORED:
        SCORED[change] = score(subject(change), REGIONS, seed=3, counts=COUNTS)
    return {one.kind for one in findings(SCORED[change], beside)}


def test_the_yardsticks_are_asked_the_same_questions(beside: tuple[Scorecard, ...]) -> None:
    card = score(subject(), REGIONS, seed=3, counts=COUNTS)
    assert [one.avoider for one in beside] == list(YARDSTICKS)
    for number, region in enumerate(card.regions):
        trained = beside[-1].regions[number]
        assert trained.questions.hands_in_base_m.tobytes() == region.questions.hands_in_base_m.tobytes()
    assert findings(card, beside) == ()


def test_mc_dropout_has_no_finding(beside: tuple[Scorecard, ...]) -> None:
    card = score(Subject.from_reference("mc-dropout"), REGIONS, seed=3, counts=COUNTS)
    assert findings(card, beside) == ()
    assert card.times is not None
    assert 0.0 < card.times.median_s <= card.times.p99_s <= card.times.most_s
    assert {one.differ for one in card.repeats} == {0}


def test_the_figures_follow_from_the_seed() -> None:
    one, again, other = (
        score(Subject.from_reference("mc-dropout"), REGIONS[:1], seed=seed, counts=COUNTS).regions[0]
        for seed in (5, 5, 6)
    )
    assert one.off_m == again.off_m
    assert one.answers.positions_in_base_m.tobytes() == again.answers.positions_in_base_m.tobytes()
    assert one.off_m != other.off_m


def towards(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return tcps + 0.1 * (hands - tcps), 0.0 * optimum


def shifted(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum - [0.0, 0.015, 0.0], 0.0 * optimum


def deaf(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum + 0.05 * (hands - tcps) - 0.05 * (hands - tcps).mean(axis=0), 0.0 * optimum


def split(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum + np.where(tcps[:, :1] > 0.7, 0.005, -0.005) * [0.0, 1.0, 0.0], 0.0 * optimum


def silent(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return np.where(hands[:, :1] > 0.9, np.nan, optimum), 0.0 * optimum


def buried(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return np.where(hands[:, :1] > 0.9, [0.7, 0.0, -0.35], optimum), 0.0 * optimum


def certain(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum + np.sign(np.sin(1e6 * hands)) * 0.004, 0.0 * optimum + 0.001


def doubtful(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum, 0.0 * optimum + 0.02


def stretched(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum + 0.3 * (tcps - tcps.mean(axis=0)), 0.0 * optimum


def clipped(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return np.minimum(optimum, [1.0, np.quantile(optimum[:, 1], 0.97), 1.0]), 0.0 * optimum


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (towards, Kind.LEADS_TOWARDS),
        (towards, Kind.FAR_OFF),
        (shifted, Kind.BIASED),
        (deaf, Kind.HAND_PULL),
        (split, Kind.JUMPS),
        (silent, Kind.NO_ANSWER),
        (buried, Kind.OUT_OF_REACH),
        (buried, Kind.WORST_CASE),
        (buried, Kind.WRONG_AND_SURE),
        (certain, Kind.SPREAD_MISSES),
        (doubtful, Kind.SPREAD_WIDE),
        (doubtful, Kind.SPREAD_UNRANKED),
        (stretched, Kind.SCALE),
        (clipped, Kind.STUCK),
    ],
)
def test_a_fault_is_named(change: Change, kind: Kind, beside: tuple[Scorecard, ...]) -> None:
    assert kind in kinds(change, beside)


def test_what_drifts_with_the_clock_does_not_repeat(beside: tuple[Scorecard, ...]) -> None:
    begun_s = time.monotonic()
    drifts = kinds(lambda o, h, t: (o + 1e-5 * (time.monotonic() - begun_s), 0.0 * o), beside)
    assert drifts == {Kind.NOT_REPEATED}


def test_one_that_takes_longer_than_the_deadline_is_slow_and_is_asked_little() -> None:
    def late(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        time.sleep(DEFAULTS.avoidance.decision_deadline_s + 0.01)
        return optimum, 0.0 * optimum

    few = Counts(first=6, other=6, far=6, segments=1, alone=2, sample=2)
    card = score(subject(late), REGIONS[:1], seed=0, counts=few)
    beside = yardsticks(REGIONS[:1], seed=0, counts=few)
    assert [one.kind for one in findings(card, beside)] == [Kind.SLOW]
    assert Counts().at_pace(0.02, 0.1).first < Counts().first / 50
    assert Counts().at_pace(1e-4, 1e-4) == Counts()


def test_a_program_is_asked_in_processes_of_its_own(tmp_path: Path) -> None:
    text = """
import os
from safety_harness.cell.avoidance.avoider import Proposal

class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + os.getpid() * 1e-6)
"""
    file = tmp_path / "mine.py"
    file.write_text(text)
    few = Counts(first=20, other=20, far=20, segments=2, alone=4, sample=8)
    card = score(Subject.from_reference(f"{file}:Mine"), REGIONS[:1], seed=0, counts=few)
    told = {(one.way.name, one.apart): one.differ for one in card.repeats}
    assert told["FRESH", True] == 8
    assert told["AGAIN", False] == 0


def test_an_avoider_that_there_is_not_is_refused() -> None:
    with pytest.raises(InadmissibleError):
        Subject.from_reference("mc-dropuot")


def test_a_region_that_holds_nothing_to_ask_has_neither_figures_nor_findings() -> None:
    settings = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, critical_distance_m=0.005))
    regions = named_regions(paper_seen(settings), settings)[1:2]
    card = score(subject(), regions, seed=0, counts=COUNTS)
    assert card.regions[0].off_m is None
    assert not card.regions[0].asked_in_runs
    assert card.times is None
    assert findings(card, yardsticks(regions, seed=0, counts=COUNTS)) == ()
