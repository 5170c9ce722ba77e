"""An avoider beside a reference on the same questions: only what the reference does not do counts."""

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
CHANCE = 0.05  # of all tests together that two avoiders alike in their errors differ in one
MORE = 0.03  # of the questions: int8 weights and training from another seed lead towards on up to 2 % more


def findings_against(
    card: Scorecard,
    found: Sequence[ScoreFinding],
    reference: Scorecard,
    of_reference: Sequence[ScoreFinding],
    settings: Sequence[Settings],
) -> tuple[ScoreFinding, ...]:
    """Findings that the reference has not, then more errors than it has, by the exact paired sign test.

    Both were asked the same questions, under the ``settings`` of each region; ValueError if not.  Errors are
    more if they are on more than ``MORE`` of the questions, or where the two answers are another way
    altogether.
    """
    known = {(one.kind, one.region) for one in of_reference}
    new = [one for one in found if (one.kind, one.region) not in known]
    pairs = zip(card.regions, reference.regions, settings, strict=False)
    asked = [(mine, theirs, of) for mine, theirs, of in pairs if mine.asked_in_runs and len(mine.questions)]
    for mine, theirs, of in asked:
        if not np.array_equal(mine.questions.seeds, theirs.questions.seeds):
            raise ValueError("expected the same questions of both")
        new += _paired(mine, theirs, of, reference.avoider, CHANCE / (2 * len(WORDS) * len(asked)))
    if card.times and reference.times:
        own_s, other_s = card.times.declared_s, reference.times.declared_s
        if own_s > other_s + settings[0].clock.control_period_s:
            words = f"declares {1e3 * own_s:g} ms for a decision, over a tick more than {1e3 * other_s:g} ms"
            new.append(ScoreFinding(Kind.SLOW, "", f"{words} of {reference.avoider}"))
    return tuple(new)


def _paired(
    mine: RegionScore, theirs: RegionScore, settings: Settings, name: str, most: float
) -> Iterator[ScoreFinding]:
    own, other = _errors(mine, settings), _errors(theirs, settings)
    apart = ~(off_m(mine.answers.positions_in_base_m, theirs.answers.positions_in_base_m) <= WRONG_M)
    for kind, words in WORDS.items():
        for among, least, where in ((np.ones_like(apart), MORE, ""), (apart, 0.0, _ELSEWHERE)):
            worse, better = own[kind] & ~other[kind] & among, other[kind] & ~own[kind] & among
            more, fewer = int(worse.sum()), int(better.sum())
            chance = sign_test(more, fewer + round(least * len(apart)))
            if more > fewer + least * len(apart) and chance < most:
                sentence = (
                    f"{words} on {more} questions on which {name} does neither{where}, and the other way "
                    f"round on {fewer}, of {len(apart):,}; of two alike that has a chance of {chance:.2g}"
                )
                shown = tuple(map(mine.questions.one, np.flatnonzero(worse)[:3].tolist()))
                yield ScoreFinding(kind, mine.region, sentence, shown)
                break


WORDS = {
    Kind.LEADS_TOWARDS: "leads towards the hand, or does not answer,",
    Kind.FAR_OFF: f"is more than {1e3 * WRONG_M:g} mm off the optimum, or does not answer,",
    Kind.SPREAD_MISSES: "has no spread above its threshold, or does not answer,",
}
_ELSEWHERE = f" and answers more than {1e3 * WRONG_M:g} mm elsewhere"


def _errors(score: RegionScore, settings: Settings) -> Errors:
    """(n,) by kind: which answers are errors; none at all is one."""
    hands, tcps = score.questions.hands_in_base_m, score.questions.tcps_in_base_m
    proposed = score.answers.positions_in_base_m
    return {
        Kind.LEADS_TOWARDS: ~(gained_m(hands, tcps, proposed) >= 0.0),
        Kind.FAR_OFF: ~(off_m(proposed, optimum_in_base_m(settings, hands, tcps)) <= WRONG_M),
        Kind.SPREAD_MISSES: is_sure(score.answers.spreads_m, score.answers.thresholds_m),
    }
