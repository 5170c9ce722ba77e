"""Find the errors that an avoider makes more often than a reference.

Both avoiders answer the same questions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.proportions import sign_test
from safety_harness.cell.avoidance.measures import WRONG_M, gained_m, is_sure, off_m

FARTHER_M = 0.020  # int8 weights or another training seed are so much farther off on 1 % of all questions
CHANCE = 0.05  # of any finding, over all tests together, if two avoiders err equally often
MORE = 0.03  # share of questions; int8 weights or another training seed lead towards on up to 2 % more


class WrongAnswer(Enum):
    """A kind of error in an answer.

    A missing answer counts as an error of each of the first three kinds.
    """

    LEADS_TOWARDS = "leads towards the hand, or does not answer,"
    FAR_OFF = f"is more than {1e3 * WRONG_M:g} mm off the optimum, or does not answer,"
    SPREAD_MISSES = "has no spread above its threshold, or does not answer,"
    FARTHER_OFF = f"answers over {1e3 * FARTHER_M:g} mm farther off the optimum than the other"


@dataclass(frozen=True, eq=False)
class PosedAnswers:
    """The answers of an avoider, with the questions and their closed-form optima.

    Each question has one row, and positions are in the base frame. Positions and spreads have the shape (n,
    3) [m], and are NaN for a missing answer. ``thresholds_m`` (n,) contains the spread threshold for each
    answer, or NaN if there is no threshold.
    """

    hands_in_base_m: ArrayNx3
    tcps_in_base_m: ArrayNx3
    optima_in_base_m: ArrayNx3
    positions_in_base_m: ArrayNx3
    spreads_m: ArrayNx3
    thresholds_m: NDArray[np.float64]  # (n,)

    @property
    def off_m(self) -> NDArray[np.float64]:
        """The distance [m] of each answer from the optimum, shape (n,)."""
        return off_m(self.positions_in_base_m, self.optima_in_base_m)

    def makes_error(self, kind: WrongAnswer, rival: PosedAnswers) -> NDArray[np.bool_]:
        """Return whether each answer makes the error ``kind``, shape (n,).

        The kind ``FARTHER_OFF`` compares the answers with the answers of ``rival``.
        """
        hands, tcps, proposed = self.hands_in_base_m, self.tcps_in_base_m, self.positions_in_base_m
        if kind is WrongAnswer.LEADS_TOWARDS:
            return np.asarray(~(gained_m(hands, tcps, proposed) >= 0.0))
        if kind is WrongAnswer.FAR_OFF:
            return np.asarray(~(self.off_m <= WRONG_M))
        if kind is WrongAnswer.FARTHER_OFF:
            return np.asarray(self.off_m > rival.off_m + FARTHER_M)
        return is_sure(self.spreads_m, self.thresholds_m)


def more_often_wrong(
    mine: PosedAnswers, theirs: PosedAnswers, reference: str, chance: float
) -> Iterator[tuple[WrongAnswer, str, NDArray[np.int64]]]:
    """Yield the errors that an avoider makes more often than ``reference``.

    Each error comes with a sentence about it, and with the rows in which only the avoider makes it. An exact
    paired sign test compares how often the two avoiders make an error. The avoider is worse if it makes an
    error on more questions than the reference, and the difference exceeds the fraction ``MORE`` of all
    questions. The avoider is also worse if it makes the error more often on the questions where the two
    answers are more than ``WRONG_M`` apart.

    Args:
        mine: The answers of the avoider under test (n rows).
        theirs: The answers of the reference (n rows) to the same questions.
        reference: The reference's name.
        chance: The significance of each test.

    """
    differ = ~(off_m(mine.positions_in_base_m, theirs.positions_in_base_m) <= WRONG_M)
    elsewhere = f" and answers more than {1e3 * WRONG_M:g} mm elsewhere"
    far_off = False
    for kind in WrongAnswer:
        if kind is WrongAnswer.FARTHER_OFF and far_off:
            continue  # said already
        own, rival = mine.makes_error(kind, theirs), theirs.makes_error(kind, mine)
        for among, least, where in ((np.ones_like(differ), MORE, ""), (differ, 0.0, elsewhere)):
            worse, better = own & ~rival & among, rival & ~own & among
            more, fewer = int(worse.sum()), int(better.sum())
            p = sign_test(more, fewer + round(least * len(differ)))
            if more > fewer + least * len(differ) and p < chance:
                sentence = (
                    f"{kind.value} on {more} questions where {reference} does not{where}, and the reverse on "
                    f"{fewer}, of {len(differ):,}; two equal avoiders differ so with a chance of {p:.2g}"
                )
                far_off |= kind is WrongAnswer.FAR_OFF
                yield kind, sentence, np.flatnonzero(worse)
                break


def slower_words(own_s: float, other_s: float, tick_s: float, reference: str) -> str:
    """Return a sentence if an avoider's declared decision time exceeds that of ``reference`` by over a tick.

    Otherwise return an empty string.
    """
    if own_s <= other_s + tick_s:
        return ""
    own_ms, other_ms = 1e3 * own_s, 1e3 * other_s
    return f"declares {own_ms:g} ms for a decision, over a tick more than {other_ms:g} ms of {reference}"
