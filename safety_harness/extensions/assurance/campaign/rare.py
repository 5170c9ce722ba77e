"""Estimate the probability of rare violations of a plan with far fewer runs than plain draws would need.

The estimate is the fraction of *all admitted* draws of a stratum that violate a claim. The fraction refers to
all admitted draws, including draws that do not test the claim. A refused draw, or a run that does not test
the claim, gets a margin that exceeds the margins of all runs that test the claim. If a run does not test the
claim, its margin is smaller the nearer a hand came.

Separate independent draws give the fraction of admitted draws and its exact interval. The estimate is the
fraction of violating draws divided by the fraction of admitted draws. The intervals of all claims and strata
hold simultaneously with the plan's confidence (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_all
from safety_harness.base.exceptions import InputError, described
from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.extensions.assurance.campaign.episodes import judgement_of, why_broken
from safety_harness.extensions.assurance.campaign.plan import Plan, PlannedClaim, Stratum
from safety_harness.extensions.assurance.campaign.ready import refuse_unready
from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
from safety_harness.extensions.assurance.statistics.importance import Importance, weigh
from safety_harness.extensions.assurance.statistics.rare import RareEstimate, Splitting, split
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome, Floats, refusal
from safety_harness.search.trials import least_hand_distance_m
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.trace import Trace

ADMITTED_OF = 2_000  # independent draws
_RARE = 3  # in the campaign's branch of the tree of seeds
_BATCH = 64
_UNTESTED, _REFUSED = 1e6, 1e9  # beyond every margin; a refused draw is the farthest
_BARELY = 1e-12  # a violation with the margin 0 needs a value below 0 too


@dataclass(frozen=True, kw_only=True)
class RareViolation:
    """The estimate for a claim in a stratum.

    ``share`` is the estimated fraction of the admitted draws that violate the claim. ``low`` is the lower end
    of its interval. ``high`` is the upper end, which is exact and comes from the plain draws alone. Admission
    accepted ``admitted`` of ``ADMITTED_OF`` draws. ``estimate`` is the estimate over all draws in the unit
    cube, whether they are admitted or refused.
    """

    stratum: str
    claim: PlannedClaim
    share: float
    low: float
    high: float
    admitted: int
    estimate: RareEstimate


def rare_violations(
    plan: Plan,
    how: Importance | Splitting,
    on_run: Callable[[int], None] = lambda done: None,
    watch: AvoiderWatch | None = None,
) -> Iterator[RareViolation]:
    """Yield the estimate for each claim in each stratum.

    After each run, ``on_run`` receives the number of draws that were made for the current claim. ``watch``
    receives all runs, and checks whether the runs represent the avoider.

    Raise InputError if the plan's text causes an error. Raise StatisticsError if a run failed, or if a run
    exercises the claim but has no verdict.
    """
    refuse_unready(plan)
    # All intervals of the plan hold together with its confidence.
    each = (1.0 - plan.confidence) / (len(plan.strata) * len(plan.claims))
    for stratum in plan.strata:
        seed = leaf(plan.seed, Branch.CAMPAIGN, _RARE, stratum.number)
        admitted = _Draws(plan, stratum, plan.claims[0], seed).admitted(ADMITTED_OF)
        if not admitted:
            raise refusal("strata", f"a draw of {stratum.name!r} that can be run", f"none of {ADMITTED_OF}")
        # Half of ``each`` is for both ends of the admitted share, and half for the estimate below.
        least, most = (bound(admitted, ADMITTED_OF, each / 4) for bound in (lower_bound, upper_bound))
        for number, claim in enumerate(plan.claims):
            draws = _Draws(plan, stratum, claim, leaf(seed, Branch.CAMPAIGN, number), on_run, watch)
            estimated = partial(weigh, how=how) if isinstance(how, Importance) else partial(split, how=how)
            estimate = estimated(
                draws,
                stratum.space.dimension,
                seed=leaf(seed, Branch.STATISTICS, number),
                confidence=1.0 - each / 2,
                model_only=plan.world.model_only,
            )
            yield RareViolation(
                stratum=stratum.name,
                claim=claim,
                share=min(1.0, estimate.value * ADMITTED_OF / admitted),
                low=estimate.low / most,
                high=min(1.0, estimate.high / least),
                admitted=admitted,
                estimate=estimate,
            )


class _Draws:
    """A function that returns a claim's margins, shape (n,), at points of the unit cube, shape (n, d).

    Each run has its own seed.
    """

    def __init__(
        self,
        plan: Plan,
        stratum: Stratum,
        claim: PlannedClaim,
        seed: int,
        on_run: Callable[[int], None] = lambda done: None,
        watch: AvoiderWatch | None = None,
    ) -> None:
        self._plan, self._claim, self._seed, self._on_run = plan, claim, seed, on_run
        self._watch = watch or AvoiderWatch()
        self._space: ScenarioSpace = stratum.space
        self._admitter, self._made = Admitter(), 0

    def admitted(self, draws: int) -> int:
        """Return how many of ``draws`` independent draws admission accepts."""
        points = np.random.Generator(np.random.PCG64(self._seed)).random((draws, self._space.dimension))
        return sum(self._admit(point) is not None for point in points)

    def __call__(self, points: Floats) -> Floats:
        """Return the margins (n,) at ``points`` (n, d), in the form that ``weigh`` and ``split`` need."""
        return np.concatenate(
            [self._margins(points[first : first + _BATCH]) for first in range(0, len(points), _BATCH)]
        )

    def _margins(self, points: Floats) -> Floats:
        tried = [self._admit(point) for point in points]
        runs = run_all([draw for draw in tried if draw is not None], self._plan.world)
        margins = np.array([_REFUSED if draw is None else self._margin(next(runs)) for draw in tried])
        self._on_run(self._made)
        return margins

    def _admit(self, point: Floats) -> Admitted | None:
        self._made += 1
        own = leaf(self._seed, Branch.CAMPAIGN, self._made)
        try:
            scenario = self._space.at(point, seed=own, name=f"{self._space.name}#{self._made}")
            scenario = self._plan.with_avoider(replace(scenario, claims=(self._claim.claim,)))
            return self._admitter.admit(scenario)
        except InputError:
            return None

    def _margin(self, run: Trace | Exception) -> float:
        if isinstance(run, Exception):
            raise refusal("runs", "runs that reach their end", described(run))
        if broken := why_broken(run):
            raise refusal("runs", "whole runs", broken)
        self._watch.add(run)
        evaluation = property_of(self._claim.claim, run.scenario).evaluate(run)
        outcome, margin = judgement_of(evaluation, run, "").outcome, evaluation.margin
        if outcome is EpisodeOutcome.VIOLATED:
            return -_BARELY if margin is None else min(float(margin), -_BARELY)
        if outcome is EpisodeOutcome.HOLDS and margin is not None:
            return max(float(margin), 0.0)
        if outcome is not EpisodeOutcome.UNTESTED:
            raise refusal("runs", "a verdict on every run that tests the claim", evaluation.reason)
        # Among untested runs, a nearer hand counts as nearer to a violation, which gives a search a
        # direction.
        return _UNTESTED + min(least_hand_distance_m(run), _UNTESTED)
