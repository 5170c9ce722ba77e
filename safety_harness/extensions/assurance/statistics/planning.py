"""Compute the number of runs that a target needs, and the probability that a plan shows its target.

Each function uses the same bound as the results, so that a plan and its result agree. ``family`` is the
number of bounds that hold simultaneously. For a plan, ``ends_of`` returns this number. ``allowed`` is the
number of violations that may occur. Inconclusive and failed runs are counted as violations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from safety_harness.base.elementary import log
from safety_harness.base.exceptions import Place, StatisticsError
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import refusal
from safety_harness.extensions.assurance.statistics.sequential import evidence_below

MOST_RUNS = 10**12  # a search for a number of runs stops here
_TAIL = 1e-12  # probability that the sum over tested runs omits at each end
_TARGET = "violated in at most"


@dataclass(frozen=True, kw_only=True)
class Aim:
    """The aim to show how rarely a tested run violates a claim.

    The aim is met if a bound with ``confidence`` shows that a tested run violates the claim with a
    probability of at most ``target``. ``stop_early`` states that the runs may stop at any time.

    Raises:
        StatisticsError: The target or the confidence is not between 0 and 1, or the family is empty.

    """

    target: float
    confidence: float = 0.95
    family: int = 1
    stop_early: bool = False

    def __post_init__(self) -> None:
        if not 0.0 < self.target < 1.0:
            hint = "no number of runs can show a share of zero" if self.target == 0.0 else ""
            raise refusal(_TARGET, "a share between 0 and 1", f"{self.target:g}", hint)
        chance_of_each(self.confidence, self.family)

    def shown_by(self, violations: int, trials: int) -> bool:
        """Return whether the upper bound that follows from the counts is at most the target.

        Args:
            violations: The number of violations. Inconclusive and failed runs are counted as violations.
            trials: The number of tested runs.

        """
        if violations >= trials:
            return False
        chance = chance_of_each(self.confidence, self.family)
        if self.stop_early:
            return bool(evidence_below(self.target, violations, trials) >= -log(chance))
        # Clopper and Pearson's upper bound is at most p exactly if P(Bin(n, p) <= k) is at most the error.
        return bool(scipy.special.bdtr(violations, trials, self.target) <= chance)  # quick, for many numbers


def runs_needed(aim: Aim, *, allowed: int = 0) -> int:
    """Return the least number of tested runs that shows ``aim`` even if ``allowed`` violations occur.

    Args:
        aim: The aim.
        allowed: The number of violations among these runs.

    Raises:
        StatisticsError: Even ``MOST_RUNS`` runs cannot show the target.

    """
    # Doubling finds a sufficient number, and bisection then finds the least.
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
    """Return the largest number of violations with which ``trials`` tested runs still show ``aim``.

    Args:
        aim: The aim.
        trials: The number of tested runs.

    Returns:
        The number, or None if ``trials`` runs without any violation cannot show the aim.

    """
    if not aim.shown_by(0, trials):
        return None
    least, most = 0, trials - 1  # violations in all runs have the upper bound 1
    while least < most:
        middle = (least + most + 1) // 2
        least, most = (middle, most) if aim.shown_by(middle, trials) else (least, middle - 1)
    return least


def power(aim: Aim, runs: int, *, probability: float, tested: float = 1.0) -> float:
    """Return the probability that ``runs`` planned runs show ``aim``.

    If the stream may stop early, the result is the probability at the planned end, which is a lower bound.

    Args:
        aim: The aim.
        runs: The number of planned runs.
        probability: The true probability that a tested run violates the claim.
        tested: The fraction of runs that exercise the claim. The number of tested runs is binomial.

    Raises:
        StatisticsError: ``probability`` is not in [0, 1], or ``tested`` is not in (0, 1].

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
    """Return the least number of tested runs that shows ``aim`` with probability ``wanted``.

    Args:
        aim: The aim.
        probability: The true probability that a tested run violates the claim.
        wanted: The wanted probability that the aim is shown.
        most_allowed: The largest number of violations to consider.

    Raises:
        StatisticsError: The true probability exceeds the target, or is too near to it.

    """
    for allowed in range(most_allowed + 1 if probability < aim.target else 0):
        runs = runs_needed(aim, allowed=allowed)
        if scipy.special.bdtr(allowed, runs, probability) >= wanted:
            return runs
    expected = f"a target clearly above the true probability {probability:g}"
    hint = f"more than {most_allowed} violations would have to be allowed"
    raise refusal(_TARGET, expected, f"{aim.target:g}", hint)


def runs_for_tested(tested: int, *, share: float, wanted: float = 0.9) -> int:
    """Return the least number of runs that contains ``tested`` tested runs with probability ``wanted``.

    The runs are independent, so that the number of tested runs is binomial.

    Args:
        tested: The wanted number of tested runs, at least 1.
        share: The probability that a run exercises the claim, in (0, 1].
        wanted: The wanted probability of at least ``tested`` tested runs, between 0 and 1.

    Raises:
        StatisticsError: An argument is out of its range, or ``MOST_RUNS`` runs are not enough.

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
    """Raise StatisticsError if a plan's runs cannot show ``aim`` even if no run violates the claim.

    Args:
        aim: The aim.
        planned: The number of planned runs.
        tested: The expected fraction of runs that exercise the claim.
        place: The place in the plan that states the number of runs. The default is the field ``runs``.

    Raises:
        StatisticsError: The plan has too few runs. The error states the sufficient number.

    """
    if aim.shown_by(0, math.floor(planned * tested)):
        return
    needed = math.ceil(runs_needed(aim) / tested)
    expected = f"at least {needed} runs, to show {aim.target:g} with {aim.confidence:.6g} confidence"
    if tested < 1.0:
        expected += f" if {tested:.3g} of them test the claim"
    if aim.family > 1:
        expected += f" ({aim.family} bounds together)"
    hint = "this number holds without a violation; each violation needs more runs"
    raise StatisticsError(place=place or Place(field="runs"), expected=expected, got=str(planned), hint=hint)


def _power_of(aim: Aim, trials: int, probability: float) -> float:
    allowed = allowed_violations(aim, trials)
    return 0.0 if allowed is None else float(scipy.special.bdtr(allowed, trials, probability))
