"""An avoider beside a reference avoider on the same questions: only their differences become findings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.proportions import sign_test
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.measures import gained_m, is_sure, off_m, optimum_in_base_m
from safety_harness.extensions.lab.scoring.figures import WRONG_M
from safety_harness.extensions.lab.scoring.scorecard import Kind, RegionScore, Scorecard, ScoreFinding

Errors = dict[Kind, NDArray[np.bool_]]
CHANCE = 0.05  # of any finding, over all tests together, if two avoiders err equally often
MORE = 0.03  # share of questions; int8 weights or another training seed lead towards on up to 2 % more


def findings_against(
    card: Scorecard,
    own_findings: Sequence[ScoreFinding],
    reference: Scorecard,
    of_reference: Sequence[ScoreFinding],
    settings: Sequence[Settings],
) -> tuple[ScoreFinding, ...]:
    """Return findings that the reference does not have, then the errors that the avoider makes more often.

    An exact paired sign test compares the errors of both.  A kind of error is a finding if the avoider makes
    it more often by over ``MORE`` of all questions.  It is also a finding if the avoider makes it more often
    on the questions where both answers are more than ``WRONG_M`` apart.

    Args:
        card: The avoider's card.
        own_findings: The findings on it.
        reference: The reference's card, for the same questions.
        of_reference: The findings on it.
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
        new += _paired(mine, theirs, own, reference.avoider, CHANCE / (2 * len(SENTENCES) * len(posed)))
    if card.times and reference.times:
        own_s, other_s = card.times.declared_s, reference.times.declared_s
        if own_s > other_s + settings[0].clock.control_period_s:
            text = f"declares {1e3 * own_s:g} ms for a decision, over a tick more than {1e3 * other_s:g} ms"
            new.append(ScoreFinding(Kind.SLOW, "", f"{text} of {reference.avoider}"))
    return tuple(new)


def _paired(
    mine: RegionScore, theirs: RegionScore, settings: Settings, name: str, most: float
) -> Iterator[ScoreFinding]:
    """Yield a finding for each kind of error that the avoider makes significantly more often."""
    own, rival = _errors(mine, settings), _errors(theirs, settings)
    differ = ~(off_m(mine.answers.positions_in_base_m, theirs.answers.positions_in_base_m) <= WRONG_M)
    for kind, text in SENTENCES.items():
        for among, least, where in ((np.ones_like(differ), MORE, ""), (differ, 0.0, _ELSEWHERE)):
            worse, better = own[kind] & ~rival[kind] & among, rival[kind] & ~own[kind] & among
            more, fewer = int(worse.sum()), int(better.sum())
            chance = sign_test(more, fewer + round(least * len(differ)))
            if more > fewer + least * len(differ) and chance < most:
                sentence = (
                    f"{text} on {more} questions where {name} does not{where}, and the reverse on {fewer}, "
                    f"of {len(differ):,}; two equal avoiders differ so with a chance of {chance:.2g}"
                )
                shown = tuple(map(mine.questions.single, np.flatnonzero(worse)[:3].tolist()))
                yield ScoreFinding(kind, mine.region, sentence, shown)
                break


SENTENCES = {
    Kind.LEADS_TOWARDS: "leads towards the hand, or does not answer,",
    Kind.FAR_OFF: f"is more than {1e3 * WRONG_M:g} mm off the optimum, or does not answer,",
    Kind.SPREAD_MISSES: "has no spread above its threshold, or does not answer,",
}
_ELSEWHERE = f" and answers more than {1e3 * WRONG_M:g} mm elsewhere"


def _errors(score: RegionScore, settings: Settings) -> Errors:
    """Return for each kind whether (n,) each answer is an error; a missing answer is an error."""
    hands, tcps = score.questions.hands_in_base_m, score.questions.tcps_in_base_m
    proposed = score.answers.positions_in_base_m
    return {
        Kind.LEADS_TOWARDS: ~(gained_m(hands, tcps, proposed) >= 0.0),
        Kind.FAR_OFF: ~(off_m(proposed, optimum_in_base_m(settings, hands, tcps)) <= WRONG_M),
        Kind.SPREAD_MISSES: is_sure(score.answers.spreads_m, score.answers.thresholds_m),
    }
