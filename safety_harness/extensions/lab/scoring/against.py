"""Compare an avoider with a reference avoider on the same questions; only differences become findings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.avoidance.paired import (
    CHANCE,
    PosedAnswers,
    WrongAnswer,
    more_often_wrong,
    slower_words,
)
from safety_harness.extensions.lab.scoring.scorecard import Kind, RegionScore, Scorecard, ScoreFinding


def findings_against(
    card: Scorecard,
    own_findings: Sequence[ScoreFinding],
    reference: Scorecard,
    of_reference: Sequence[ScoreFinding],
    settings: Sequence[Settings],
) -> tuple[ScoreFinding, ...]:
    """Return the findings that apply to the avoider but not to the reference avoider.

    The result ends with findings on errors that the avoider makes more often than the reference avoider.

    The function ``more_often_wrong`` compares the errors of the two avoiders.

    Args:
        card: The avoider's card.
        own_findings: The findings on the avoider.
        reference: The card of the reference avoider, for the same questions.
        of_reference: The findings on the reference avoider.
        settings: The settings of each region.

    Raises:
        ValueError: The two cards have different questions.

    """
    known = {(each.kind, each.region) for each in of_reference}
    new = [each for each in own_findings if (each.kind, each.region) not in known]
    pairs = zip(card.regions, reference.regions, settings, strict=False)
    posed = [(mine, theirs, own) for mine, theirs, own in pairs if mine.asked_in_runs and len(mine.questions)]
    for mine, theirs, own in posed:
        if not np.array_equal(mine.questions.seeds, theirs.questions.seeds):
            raise ValueError("expected the same questions of both")
        new += _paired(mine, theirs, own, reference.avoider, CHANCE / (2 * len(WrongAnswer) * len(posed)))
    if card.times and reference.times:
        declared_s = card.times.declared_s, reference.times.declared_s
        slower = slower_words(*declared_s, settings[0].clock.control_period_s, reference.avoider)
        new += [ScoreFinding(Kind.SLOW, "", slower)] if slower else []
    return tuple(new)


def _paired(
    mine: RegionScore, theirs: RegionScore, settings: Settings, name: str, most: float
) -> Iterator[ScoreFinding]:
    """Yield a finding for each kind of error that the avoider makes significantly more often."""
    both = _posed(mine, settings), _posed(theirs, settings)
    for error, sentence, rows in more_often_wrong(*both, name, most):
        shown = tuple(map(mine.questions.single, rows[:3].tolist()))
        kind = Kind.FAR_OFF if error is WrongAnswer.FARTHER_OFF else Kind[error.name]
        yield ScoreFinding(kind, mine.region, sentence, shown)


def _posed(score: RegionScore, settings: Settings) -> PosedAnswers:
    hands, tcps, answers = score.questions.hands_in_base_m, score.questions.tcps_in_base_m, score.answers
    optima = optimum_in_base_m(settings, hands, tcps)
    given = answers.positions_in_base_m, answers.spreads_m, answers.thresholds_m
    return PosedAnswers(hands, tcps, optima, *given)
