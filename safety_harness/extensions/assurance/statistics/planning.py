"""How many runs it takes to show a target, and how likely that is to succeed.

All of it asks the bound itself, so that the plan and what comes of it cannot differ.  ``family`` is the
number of bounds that are to hold together (``ends_of`` a plan), ``allowed`` the number of violations that may
be seen, inconclusive and failed runs included.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from safety_harness.base.exceptions import Place, StatisticsError
from safety_harness.base.proportions import upper_bound
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import refusal
from safety_harness.extensions.assurance.statistics.sequential import anytime_upper

Upper = Callable[[int, int, float], float]
MOST_RUNS = 10**12
_TAIL = 1e-12
_TARGET = "violated in at most"


@dataclass(frozen=True, kw_only=True)
class Aim:
    """Show with ``confidence`` that at most a share ``target`` of the tested runs violates a claim.

    ``stop_early``: the runs may be looked at and stopped at any time.
    """

    target: float
    confidence: float = 0.95
    family: int = 1
    stop_early: bool = False

    def __post_init__(self) -> None:
        if not 0.0 < self.target < 1.0:
            hint = "no number of runs shows that nothing can ever happen" if self.target == 0.0 else ""
            raise refusal(_TARGET, "a share between 0 and 1", f"{self.target:g}", hint)
        chance_of_each(self.confidence, self.family)

    def shown_by(self, violations: int, trials: int) -> bool:
        """Would so many violations of so many tested runs do?"""
        upper: Upper = anytime_upper if self.stop_early else upper_bound
        chance = chance_of_each(self.confidence, self.family)
        return trials > 0 and upper(violations, trials, chance) <= self.target


def runs_needed(aim: Aim, *, allowed: int = 0) -> int:
    """The least number of tested runs that shows ``aim`` with ``allowed`` violations among them."""
    least = most = allowed + 1
    while not aim.shown_by(allowed, most):
        least, most = most + 1, 2 * most
        if most > MOST_RUNS:
            raise refusal(_TARGET, f"a target that {MOST_RUNS:.0e} runs can show", f"{aim.target:g}")
    while least < most:
        middle = (least + most) // 2
        least, most = (least, middle) if aim.shown_by(allowed, middle) else (middle + 1, most)
    return most


def allowed_violations(aim: Aim, trials: int) -> int | None:
    """The most violations among ``trials`` tested runs that still show ``aim``; None if even none do not."""
    if not aim.shown_by(0, trials):
        return None
    least, most = 0, trials - 1  # all of them never do
    while least < most:
        middle = (least + most + 1) // 2
        least, most = (middle, most) if aim.shown_by(middle, trials) else (least, middle - 1)
    return least


def power(aim: Aim, runs: int, *, probability: float, tested: float = 1.0) -> float:
    """How likely ``runs`` runs show ``aim`` if tested runs violate the claim with ``probability``.

    ``tested`` is the share of runs that exercise the claim: their number is binomial too.  For a
    stream that may stop early it is the chance at its planned end: a lower bound.
    """
    if not (0.0 <= probability <= 1.0 and 0.0 < tested <= 1.0):
        raise refusal("power", "shares between 0 and 1", f"{probability:g} and {tested:g}")
    if runs < 1 or tested == 1.0:
        return _power_of(aim, runs, probability)
    first, last = (int(scipy.special.bdtrik(chance, runs, tested)) for chance in (_TAIL, 1.0 - _TAIL))
    likely = np.arange(first, min(runs, last + 1) + 1)
    at_most = scipy.special.bdtr(likely, runs, tested)
    chances = np.diff(at_most, prepend=0.0)  # the first takes the tail below it, which is within _TAIL
    return float(sum(c * _power_of(aim, int(n), probability) for n, c in zip(likely, chances, strict=True)))


def runs_for_power(aim: Aim, *, probability: float, wanted: float = 0.9, most_allowed: int = 2000) -> int:
    """The least number of tested runs that shows ``aim`` with the chance ``wanted``, of a true probability.

    StatisticsError where that is too near to the target, or above.
    """
    for allowed in range(most_allowed + 1 if probability < aim.target else 0):
        runs = runs_needed(aim, allowed=allowed)
        if scipy.special.bdtr(allowed, runs, probability) >= wanted:
            return runs
    expected = f"a target clearly above the true probability {probability:g}"
    hint = f"more than {most_allowed} violations would have to be allowed"
    raise refusal(_TARGET, expected, f"{aim.target:g}", hint)


def runs_for_tested(tested: int, *, share: float, wanted: float = 0.9) -> int:
    """The least number of runs of which, with the chance ``wanted``, at least ``tested`` exercise the claim.

    Each does with the chance ``share``, apart from the others: their number is binomial.
    """
    if not (0.0 < share <= 1.0 and 0.0 < wanted < 1.0 and tested >= 1):
        raise refusal("share", "a share between 0 and 1, of at least one run", f"{share:g} of {tested}")
    if share == 1.0:
        return tested
    least, most = tested, 2 * tested
    while scipy.special.bdtr(tested - 1, most, share) > 1.0 - wanted:
        least, most = most + 1, 2 * most
        if most > MOST_RUNS:
            raise refusal("share", f"a share by which {MOST_RUNS:.0e} runs are enough", f"{share:g}")
    while least < most:
        middle = (least + most) // 2
        enough = scipy.special.bdtr(tested - 1, middle, share) <= 1.0 - wanted
        least, most = (least, middle) if enough else (middle + 1, most)
    return most


def refuse_if_impossible(aim: Aim, planned: int, *, tested: float = 1.0, place: Place | None = None) -> None:
    """StatisticsError, with the number that would do, if ``planned`` runs without any violation do not.

    ``tested`` is the share of runs expected to exercise the claim; ``place`` is where the plan says
    how many runs.
    """
    if aim.shown_by(0, math.floor(planned * tested)):
        return
    needed = math.ceil(runs_needed(aim) / tested)
    words = f"at least {needed} runs, to show {aim.target:g} with {aim.confidence:.6g} confidence"
    if tested < 1.0:
        words += f" if {tested:.3g} of them test the claim"
    if aim.family > 1:
        words += f" ({aim.family} bounds together)"
    hint = "that many without any violation; each one takes more"
    raise StatisticsError(place=place or Place(field="runs"), expected=words, got=str(planned), hint=hint)


def _power_of(aim: Aim, trials: int, probability: float) -> float:
    allowed = allowed_violations(aim, trials)
    return 0.0 if allowed is None else float(scipy.special.bdtr(allowed, trials, probability))
