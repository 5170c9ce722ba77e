"""Scorecards of a small avoider, for what is made of them: figures by hand, not by the scoring under test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from safety_harness.base.proportions import Proportion
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.measures import gained_m, off_m, optimum_in_base_m
from safety_harness.extensions.lab.scoring.question_file import QuestionFile
from safety_harness.extensions.lab.scoring.questions import Answers, Questions
from safety_harness.extensions.lab.scoring.results import Scored, ScoredAvoider, ShownQuestion
from safety_harness.extensions.lab.scoring.scorecard import (
    AnswerChange,
    AnswerTimes,
    AskedAgain,
    Figure,
    Jumps,
    Kind,
    Moved,
    RegionScore,
    Scorecard,
    ScoreFinding,
    Spreads,
    WayOfAsking,
)
from safety_harness.extensions.lab.scoring.worst import Objective, QuestionSearch, Tried
from safety_harness.scenario.model import Claim, Verdict


def region_score(name: str = "seen", *, questions: int = 200, shift_m: float = 0.0) -> RegionScore:
    """The closed form, ``shift_m`` too far along x for hands with y below the nominal one."""
    rng = np.random.default_rng(3)
    hands = np.array([0.84, -0.35, 0.005]) + rng.uniform(-0.3, 0.3, (questions, 3))
    tcps = np.array([0.7, 0.0, 0.35]) + rng.uniform(-0.1, 0.1, (questions, 3))
    asked = Questions(hands, tcps, np.arange(questions, dtype=np.uint64))
    optimum = optimum_in_base_m(DEFAULTS, hands, tcps)
    positions = optimum + np.where(hands[:, 1:2] < -0.35, [[shift_m, 0.0, 0.0]], 0.0)
    answers = Answers(positions, np.full((questions, 3), 0.002), np.full(questions, np.nan), {})
    error, gained = off_m(positions, optimum), gained_m(hands, tcps, positions)

    def figure(values: np.ndarray, share: float) -> Figure:
        value = float(np.quantile(values, share))
        return Figure(value, value - 0.001, value + 0.001)

    share = Proportion.from_rows(error < 0.06)
    return RegionScore(
        region=name,
        about=f"{name} hands & <TCPs>",
        asked_in_runs=name != "far",
        questions=asked,
        answers=answers,
        answered=Proportion.from_rows(np.ones(questions, bool)),
        leads_away=Proportion.from_rows(gained >= 0.0),
        in_reach=None,
        gained_m=(figure(gained, 0.5), figure(gained, 0.05)),
        least_gained_m=float(gained.min()),
        angle_rad=(Figure(0.5, 0.4, 0.6), Figure(1.0, 0.9, 1.1)),
        off_rms_m=Figure(float(np.sqrt((error**2).mean())), 0.0, 0.1),
        off_m=(figure(error, 0.5), figure(error, 0.95), figure(error, 0.99)),
        off_most_m=float(error.max()),
        bias_in_base_m=(Figure(shift_m / 2, 0.0, 0.1), Figure(0.0, 0.0, 0.0), Figure(0.0, 0.0, 0.0)),
        pull=((-0.05, 0.0, 0.0), (0.0, -0.05, 0.0), (0.0, 0.0, -0.05)),
        scale=None,
        spreads=Spreads(
            within=((share, share, share),) * 3,
            error_to_spread=Figure(1.5, 1.4, 1.6),
            by_axis=(1.5, 1.4, 1.6),
            rank=None,
            honest_rank=0.5,
            rms_m=0.002,
        ),
        wrong_and_sure=Proportion.from_rows(error > 0.06),
        above_threshold=None,
        worst_off=(),
        worst_gained=(),
    )


def scorecard(avoider: str = "mc-dropout", *, shift_m: float = 0.0, measured: bool = True) -> Scorecard:
    """Two regions, the second of which no run can ask about."""
    regions = (region_score(shift_m=shift_m), region_score("far", shift_m=shift_m))
    question = regions[0].questions.single(0)
    change = AnswerChange(Moved.HAND, question, regions[0].questions.single(1), 0.081, 1e-5)
    share = Proportion.from_rows(np.array([True, False]))
    return Scorecard(
        avoider=avoider,
        name=f"the <{avoider}>",
        seed=7,
        seen="the paper",
        regions=regions,
        jumps=(
            Jumps(region="seen", moved=Moved.HAND, segments=2, jumped=share, largest=change, steepest=None),
        ),
        repeats=(AskedAgain(way=WayOfAsking.ORDER, questions=50, differ=2, largest_m=0.01, first=question),)
        * measured,
        times=AnswerTimes(100, 0.0008, 0.0021, 0.0105, 0, 0.0, 0.1) if measured else None,
    )


def scored(avoider: str = "mc-dropout", *, file: str = "worst-1.yaml", **others: object) -> Scored:
    """One avoider with two findings beside two yardsticks, and a worst question that is a file."""
    tried = Tried(
        region="seen",
        scenario_seed=5,
        hand_in_base_m=np.array([0.8, -0.3, 0.1]),
        tcp_in_base_m=np.array([0.7, 0.0, 0.35]),
        proposed_in_base_m=np.array([0.7, 0.0, 0.45]),
        largest_spread_m=0.004,
        gained_m=-0.0234,
        off_m=0.081,
        optimum_gained_m=0.012,
        sure=True,
    )
    claim = Claim(sentence="proposals lead away to within 10 mm", expected=Verdict.VIOLATED)
    found = (
        ScoreFinding(Kind.FAR_OFF, "seen", "1 % of the answers are more than 70.1 mm off the optimum"),
        ScoreFinding(Kind.NOT_REPEATED, "", "2 of 50 answers differ"),
    )
    one = ScoredAvoider(
        reference=avoider,
        sha256="ab" * 32,
        settings=(DEFAULTS, DEFAULTS),
        card=scorecard(avoider, shift_m=0.07),
        yardsticks=(scorecard("closed-form optimum", measured=False),),
        findings=found,
        searches=[QuestionSearch("seen", 500, asked=500)],
        worst=[ShownQuestion(Objective.TOWARDS, tried, QuestionFile(Path(file), "", (claim,), "text"))],
        left_out=["a hand within the robot"],
    )
    return replace(Scored(seed=7, budget=500, avoiders=[one]), **others)  # type: ignore[arg-type]
