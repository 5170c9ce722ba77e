"""Write score cards as text rows of tables, for the terminal and the page.

The units are millimetres, per cent and degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from safety_harness.base.proportions import Proportion, share_words
from safety_harness.extensions.lab.scoring.scorecard import (
    AnswerChange,
    AskedAgain,
    Figure,
    Jumps,
    RegionScore,
    Scorecard,
)
from safety_harness.report.words import milliseconds_words, point_words, with_minus

NONE = "\u2013"
COLUMNS = (
    "answers",
    "leads away",
    "gained mm",
    "in reach",
    "off mm: p50",
    "p99",
    "max",
    "wrong and sure",
    "jump mm",
)
DETAILS = (
    "bias mm",
    "follows the hand by",
    "off grows with the TCP by",
    "errors within 1, 2, 3 spreads",
    "error to spread",
    "rank",
    "in doubt",
)


@dataclass(frozen=True)
class ScoreRow:
    """A table row about one avoider in one region; ``yardstick`` is True if it is a reference avoider."""

    region: str
    avoider: str
    yardstick: bool
    cells: tuple[str, ...]


def rows_of(
    cards: Sequence[Scorecard], cells: Callable[[RegionScore, Sequence[Jumps]], tuple[str, ...]]
) -> Iterator[ScoreRow]:
    """Yield the table rows, region by region, in the order of the regions in the first card.

    In each region, the avoider's row precedes the rows of the yardsticks.

    Args:
        cards: The avoider's card, followed by the cards of the yardsticks.
        cells: A function that returns the cells of a row.

    """
    for region in cards[0].regions if cards else ():
        for number, card in enumerate(cards):
            for score in card.regions:
                if score.region == region.region and (number == 0 or card.avoider != cards[0].avoider):
                    jumps = [moved for moved in card.jumps if moved.region == region.region]
                    name = score.region + ("" if score.asked_in_runs else " (no run asks)")
                    yield ScoreRow(name, card.avoider, number > 0, cells(score, jumps))


OFTEN_TOWARDS = 0.20  # the largest share in a region for green: twice the optimum's share for near hands


def most_towards(card: Scorecard) -> tuple[float, str]:
    """Return the largest fraction of proposals towards the hand in any region, and the region's name.

    The fraction is NaN if the avoider made no proposal.
    """
    known = [
        (1.0 - score.leads_away.share, score.region)
        for score in card.regions
        if score.asked_in_runs and score.leads_away
    ]
    return max(known, default=(math.nan, ""))


def towards_words(card: Scorecard) -> str:
    """Return a sentence about the region with the largest fraction of proposals towards the hand.

    The sentence does not depend on the yardsticks.
    """
    share, region = most_towards(card)
    if math.isnan(share):
        return "No region got a proposal."
    text = f"Towards the hand, most: {100 * share:.3g} % of its proposals in {region}"
    limit = f", and more than {100 * OFTEN_TOWARDS:g} % are too many for green."
    return text + ("." if is_green(card) else limit)


def is_green(card: Scorecard) -> bool:
    """Return True if the page may show the result in green.

    This requires that only few proposals lead towards the hand in each region.
    """
    return most_towards(card)[0] <= OFTEN_TOWARDS  # False for NaN


def figures(score: RegionScore, jumps: Sequence[Jumps]) -> tuple[str, ...]:
    """Return the cells of the columns ``COLUMNS`` in the row of one region.

    The numbers come from the ``score`` and the ``jumps`` of this region.
    """
    return (
        percent(score.answered),
        percent(score.leads_away),
        NONE if score.gained_m is None else mm(score.gained_m[0].value),
        percent(score.in_reach),
        NONE if score.off_m is None else mm(score.off_m[0].value),
        NONE if score.off_m is None else mm(score.off_m[2].value),
        mm(score.off_most_m),
        percent(score.wrong_and_sure),
        jump_words(jumps),
    )


def details(score: RegionScore, jumps: Sequence[Jumps]) -> tuple[str, ...]:
    """Return the cells of the columns ``DETAILS`` in the row of one region.

    The numbers come from the ``score`` of this region. The function does not use ``jumps``.
    """
    spreads = score.spreads
    shares = (
        NONE
        if spreads is None
        else ", ".join(_percent(min(axis.share for axis in axes)) for axes in spreads.within)
    )
    return (
        NONE if score.bias_in_base_m is None else " ".join(mm(axis.value) for axis in score.bias_in_base_m),
        _diagonal(score.pull),
        _diagonal(score.scale),
        shares,
        NONE if spreads is None else f"{spreads.error_to_spread.value:.2f}",
        NONE if spreads is None or spreads.rank is None else with_minus(f"{spreads.rank.value:.2f}"),
        percent(score.above_threshold),
    )


def _diagonal(matrix: tuple[tuple[float, ...], ...] | None) -> str:
    """Return a text with the numbers on the diagonal of a matrix."""
    return NONE if matrix is None else with_minus(" ".join(f"{matrix[k][k]:.2f}" for k in range(3)))


def jump_words(jumps: Sequence[Jumps]) -> str:
    """Return a text with the largest jump in a region, or a dash if there was no search for jumps."""
    if not jumps:
        return NONE
    changes = [moved.largest.change_m for moved in jumps if moved.largest is not None]
    return mm(max(changes)) if changes else "none"


def change_words(change: AnswerChange) -> str:
    """Return a text with the position and the size of a change of the answer."""
    hand, tcp = change.before.hand_position_in_base_m, change.before.tcp_position_in_base_m
    return (
        f"{mm(change.change_m)} mm where {change.moved.value} moves {1e3 * change.apart_m:.3g} mm, at the "
        f"hand ({point_words(hand)}) and the TCP ({point_words(tcp)}) mm"
    )


def repeat_words(repeat: AskedAgain) -> str:
    """Return a text that states whether the second answers were the same as the first answers."""
    if repeat.differ == 0:
        return f"the same bits, {repeat.questions:,} questions"
    size = f" by {mm(repeat.largest_m)} mm at most" if np.isfinite(repeat.largest_m) else ", some unanswered"
    return f"{repeat.differ:,} of {repeat.questions:,} differ{size}"


def times_words(card: Scorecard) -> str:
    """Return a text with the answer times on this machine, the declared time and the deadline."""
    if card.times is None:
        return ""
    times = card.times
    quantiles = zip(("p50", "p99", "max"), (times.median_s, times.p99_s, times.most_s), strict=True)
    shown = ", ".join(f"{name} {milliseconds_words(value)}" for name, value in quantiles)
    declared = milliseconds_words(times.declared_s) if times.declared_s else "nothing"
    return (
        f"{shown} of {times.questions:,} answers on this machine; declared: {declared}; "
        f"deadline {milliseconds_words(times.deadline_s)}"
    )


def interval(figure: Figure, per_si: float = 1e3) -> str:
    """Return a text with a value and its interval, both multiplied by ``per_si``."""
    shown = f"{per_si * figure.value:.1f}"
    if np.isfinite(figure.low) and np.isfinite(figure.high):
        shown += f" [{per_si * figure.low:.1f}, {per_si * figure.high:.1f}]"
    return with_minus(shown)


def mm(length_m: float | None) -> str:
    """Return the text of a length in millimetres, or a dash for None, NaN or infinity.

    A length below 99.5 mm has one decimal.
    """
    if length_m is None or not np.isfinite(length_m):
        return NONE
    shown = 1e3 * length_m
    return with_minus(f"{shown:.0f}" if abs(shown) >= 99.5 else f"{shown:.1f}")


def percent(part: Proportion | None) -> str:
    """Return the text of a fraction in per cent, or a dash for None.

    The text is "0 %" only if the count is 0, and "100 %" only if it equals the number of trials.
    """
    return NONE if part is None else share_words(part.count, part.trials)


def _percent(share: float) -> str:
    """Return the text of a fraction, rounded to whole per cent."""
    return f"{100 * share:.0f} %"
