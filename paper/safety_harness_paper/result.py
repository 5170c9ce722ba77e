"""What came out, in a form that page, JSON and text are all made from, and the rule of the three words.

**The rule, fixed before anything was measured.**  The paper states *claims* (this falls, that is smaller) and
*figures*.  A claim holds if the 95 % interval of the difference it is about lies on the claimed side of zero
(or, for counts, the exact paired test has p < 0.05 and that sign).  A figure of the paper agrees if it lies
within 10 % of our mean, or in our 95 % prediction interval for one more training and within 25 %; one that is
a count agrees if our mean lies in its own exact interval.

- *reproduced*: every claim holds, and at least nine in ten of the figures agree;
- *direction only*: every claim holds, but fewer figures agree;
- *not reproduced*: at least one claim does not hold; the reason says which, and whether it came out the other
  way or was not decided at this scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from safety_harness_paper.intervals import Estimate, Paired

AGREEING_SHARE = 0.9
CLOSE, NEAR = 0.1, 0.25  # of our mean
SIGNIFICANT = 0.05


class PaperVerdict(Enum):
    """The verdict on a table or figure of the paper."""

    REPRODUCED = "reproduced"
    DIRECTION_ONLY = "direction only"
    NOT_REPRODUCED = "not reproduced"
    NO_VERDICT = "no figure of the paper"  # a question that the paper does not answer with numbers


class ClaimState(Enum):
    """What became of one claim."""

    HOLDS = "holds"
    CONTRADICTED = "contradicted"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class PaperClaim:
    """One sentence of the paper, and the evidence for or against it in words."""

    sentence: str
    state: ClaimState
    evidence: str


@dataclass(frozen=True, kw_only=True)
class FigureComparison:
    """One number: the paper's (None where it has none) and ours; ``scale`` turns SI into ``unit``."""

    label: str
    ours: Estimate
    paper: float | None = None
    unit: str = ""
    digits: int = 2
    scale: float = 1.0
    counts: bool = True  # whether it takes part in the verdict
    paper_ends: tuple[float, float] | None = None  # of the paper's own exact interval, in its unit

    @property
    def agrees(self) -> bool | None:
        """By the rule; None where the paper has no figure or the comparison does not count."""
        if self.paper is None or not self.counts:
            return None
        value, mine = self.paper / self.scale, self.ours
        if self.paper_ends is not None:
            low, high = self.paper_ends
            return low <= self.scale * mine.value <= high
        away, size = abs(value - mine.value), abs(mine.value)
        likely = mine.next_low <= value <= mine.next_high  # False for NaN
        return away <= CLOSE * size or (likely and away <= NEAR * size)


@dataclass(frozen=True)
class Table:
    """Further numbers as text; the first column names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Series:
    """One curve or cloud of a plot; ``low`` and ``high`` are the ends of intervals, where it has them."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()


@dataclass(frozen=True)
class Panel:
    """One pair of axes; ``kind`` is what draws it (``plots``), ``marks`` are (x, what happens there)."""

    kind: str
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    marks: tuple[tuple[float, str], ...] = ()
    levels: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class Plot:
    """A figure of one or more panels with its caption."""

    title: str
    caption: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True, kw_only=True)
class Result:
    """One part of the reproduction."""

    name: str
    title: str
    source: str  # where in the paper
    paper_says: str
    word: PaperVerdict
    why: str
    claims: tuple[PaperClaim, ...] = ()
    comparisons: tuple[FigureComparison, ...] = ()
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    notes: tuple[str, ...] = field(default=())


def below_zero(
    sentence: str, difference: Estimate, *, unit: str = "", scale: float = 1.0, digits: int = 2
) -> PaperClaim:
    """A claim that a difference is negative."""
    return _claim(sentence, difference, difference.high < 0.0, difference.low > 0.0, unit, scale, digits)


def above_zero(
    sentence: str, difference: Estimate, *, unit: str = "", scale: float = 1.0, digits: int = 2
) -> PaperClaim:
    """A claim that a difference is positive."""
    return _claim(sentence, difference, difference.low > 0.0, difference.high < 0.0, unit, scale, digits)


def within(
    sentence: str, difference: Estimate, bound: float, *, unit: str = "", scale: float = 1.0, digits: int = 2
) -> PaperClaim:
    """A claim that two things are the same up to ``bound``: the whole interval lies within it."""
    same = -bound < difference.low and difference.high < bound
    apart = difference.low > bound or difference.high < -bound
    return _claim(sentence, difference, same, apart, unit, scale, digits)


def fewer(sentence: str, first: str, second: str, pairs: Paired) -> PaperClaim:
    """A claim that fewer trials have it with the first than with the second (McNemar's exact test)."""
    decided = pairs.p_value < SIGNIFICANT
    holds, opposite = pairs.first_only < pairs.second_only, pairs.first_only > pairs.second_only
    state = (
        ClaimState.HOLDS
        if decided and holds
        else ClaimState.CONTRADICTED
        if decided and opposite
        else ClaimState.UNDECIDED
    )
    evidence = (
        f"of {pairs.trials} pairs {pairs.second_only} with {second} alone, "
        f"{pairs.first_only} with {first} alone; "
        f"p = {pairs.p_value:.2g} (McNemar, exact)"
    )
    return PaperClaim(sentence, state, evidence)


def _claim(
    sentence: str, difference: Estimate, holds: bool, fails: bool, unit: str, scale: float, digits: int
) -> PaperClaim:
    state = ClaimState.HOLDS if holds else ClaimState.CONTRADICTED if fails else ClaimState.UNDECIDED
    return PaperClaim(
        sentence, state, "difference " + estimate_words(difference, unit=unit, scale=scale, digits=digits)
    )


def estimate_words(estimate: Estimate, *, unit: str = "", scale: float = 1.0, digits: int = 2) -> str:
    """As in "11.9 mm [11.6, 12.2]"; an infinite interval, of a single training, is said to be none."""
    value = f"{number(scale * estimate.value, digits)}{' ' + unit if unit else ''}"
    if not (math.isfinite(estimate.low) and math.isfinite(estimate.high)):
        return f"{value} [no interval]"
    return f"{value} [{number(scale * estimate.low, digits)}, {number(scale * estimate.high, digits)}]"


def number(value: float, digits: int) -> str:
    """With a real minus sign, and no "-0.00"."""
    text = f"{value:.{digits}f}"
    if text.startswith("-"):
        text = text[1:] if not text.strip("-0.") else "\u2212" + text[1:]
    return text


def judge(claims: Sequence[PaperClaim], comparisons: Sequence[FigureComparison]) -> tuple[PaperVerdict, str]:
    """The word by the rule of this module, and why; ValueError where there is nothing to judge."""
    if not claims:
        raise ValueError("a verdict takes at least one claim")
    agreeing = [one.agrees for one in comparisons if one.agrees is not None]
    figures = (
        f"{sum(agreeing)} of {len(agreeing)} figures agree" if agreeing else "there is no figure to compare"
    )
    lost = [one for one in claims if one.state is not ClaimState.HOLDS]
    if lost:
        reasons = "; ".join(f"{one.sentence} ({one.state.value})" for one in lost)
        verb = "does" if len(lost) == 1 else "do"
        some = f"{len(lost)} of {len(claims)} claims {verb}" if len(claims) > 1 else "the claim does"
        return PaperVerdict.NOT_REPRODUCED, f"{_upper(some)} not hold: {reasons}. {_upper(figures)}."
    all_hold = "the claim holds" if len(claims) == 1 else f"all {len(claims)} claims hold"
    if not agreeing or sum(agreeing) >= AGREEING_SHARE * len(agreeing):
        return PaperVerdict.REPRODUCED, f"{_upper(all_hold)}, and {figures}."
    return PaperVerdict.DIRECTION_ONLY, f"{_upper(all_hold)}, but only {figures}."


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]


def every(sentence: str, having: int, trials: int) -> PaperClaim:
    """A claim about all of them: one that has it not is enough against it.  ValueError without any trial."""
    if not 0 <= having <= trials or not trials:
        raise ValueError(f"{having} of {trials} cannot be judged")
    state = ClaimState.HOLDS if having == trials else ClaimState.CONTRADICTED
    return PaperClaim(sentence, state, f"{having:,} of {trials:,}")


def most(sentence: str, share: Estimate) -> PaperClaim:
    """A claim about the greater part: the share's exact interval lies above one half."""
    state = (
        ClaimState.HOLDS
        if share.low > 0.5
        else ClaimState.CONTRADICTED
        if share.high < 0.5
        else ClaimState.UNDECIDED
    )
    return PaperClaim(sentence, state, "share " + estimate_words(share))
