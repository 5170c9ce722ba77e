"""An avoider beside a reference on the same questions: only what the reference does not do counts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.measures import gained_m, off_m, optimum_in_base_m
from safety_harness.proportions import sign_test
from safety_harness.scoring.figures import WRONG_M
from safety_harness.scoring.scorecard import Kind, RegionScore, Scorecard, ScoreFinding
from safety_harness.settings import Settings

Errors = dict[Kind, NDArray[np.bool_]]
CHANCE = 0.05  # of all tests together that two avoiders alike in their errors differ in one


def findings_against(
    card: Scorecard,
    found: Sequence[ScoreFinding],
    reference: Scorecard,
    of_reference: Sequence[ScoreFinding],
    settings: Sequence[Settings],
) -> tuple[ScoreFinding, ...]:
    """Findings that the reference has not, then more errors than it has, by the exact paired sign test.

    Both were asked the same questions, under the ``settings`` of each region; ValueError if not.
    """
    known = {(one.kind, one.region) for one in of_reference}
    new = [one for one in found if (one.kind, one.region) not in known]
    pairs = zip(card.regions, reference.regions, settings, strict=False)
    asked = [(mine, theirs, of) for mine, theirs, of in pairs if mine.asked_in_runs and len(mine.questions)]
    for mine, theirs, of in asked:
        own, other = _errors(mine, of), _errors(theirs, of)
        if not np.array_equal(mine.questions.seeds, theirs.questions.seeds):
            raise ValueError("expected the same questions of both")
        new += _paired(mine, own, other, reference.avoider, CHANCE / (2 * len(asked)))
    return tuple(new)


def _paired(mine: RegionScore, own: Errors, other: Errors, name: str, most: float) -> Iterator[ScoreFinding]:
    for kind, words in ((Kind.LEADS_TOWARDS, "leads towards the hand"), (Kind.FAR_OFF, _FAR)):
        more = int(np.count_nonzero(own[kind] & ~other[kind]))
        fewer = int(np.count_nonzero(other[kind] & ~own[kind]))
        chance = sign_test(more, fewer)
        if more > fewer and chance < most:
            sentence = (
                f"{words}, or does not answer, on {more} questions on which {name} does neither, and the "
                f"other way round on {fewer}, of {len(mine.questions):,}; "
                f"of two alike that has a chance of {chance:.2g}"
            )
            rows = np.flatnonzero(own[kind] & ~other[kind])[:3]
            yield ScoreFinding(
                kind, mine.region, sentence, tuple(mine.questions.one(int(row)) for row in rows)
            )


_FAR = f"is more than {1e3 * WRONG_M:g} mm off the optimum"


def _errors(score: RegionScore, settings: Settings) -> Errors:
    """(n,) by kind: which answers are errors; none at all is one."""
    hands, tcps = score.questions.hands_in_base_m, score.questions.tcps_in_base_m
    proposed = score.answers.positions_in_base_m
    return {
        Kind.LEADS_TOWARDS: ~(gained_m(hands, tcps, proposed) >= 0.0),
        Kind.FAR_OFF: ~(off_m(proposed, optimum_in_base_m(settings, hands, tcps)) <= WRONG_M),
    }
