"""Judge over many runs how often the intervals of an avoider's spread contain the target.

A single run does not show calibration, because one interval either contains the target or does not. The runs
must be drawn independently of their outcomes, for example as draws of a space. Runs that a search chose are
not evidence.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.proportions import Proportion
from safety_harness.base.seeds import Branch, seed
from safety_harness.base.settings import Settings, Vector3
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.avoidance.model_file import Model, load_model
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.cell.avoidance.simple import NearestCandidate
from safety_harness.claims.properties.base import Evaluation, Unit, inconclusive
from safety_harness.claims.properties.measured import not_measured
from safety_harness.claims.properties.proposals import PROPOSAL, proposals
from safety_harness.scenario.model import Verdict
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.trace import Trace

READ = (*PROPOSAL, "decision.seed", "decision.proposed_spread_m")
# A choice: for a coverage of 95 %, the confidence interval of 100 decisions is 10 percentage points wide.
LEAST_DECISIONS = 100
AT_LEAST = 0.90  # least coverage of 95 % intervals; some hundred runs can tell this difference


class Target(Enum):
    """The target that the intervals should contain."""

    LABEL = "eq. 13 with candidates drawn afresh"  # the target of most networks' training and calibration
    OPTIMUM = "eq. 13 with the continuous optimum"  # exact: no label is nearer to the desired position


@dataclass(frozen=True, kw_only=True)
class IntervalRule:
    """The interval of a prediction on each axis [m], and its target.

    The interval is the prediction +- ``multiplier`` (spread^2 + residual^2)^(1/2).
    """

    multiplier: float
    residual_std_m: Vector3
    target: Target

    @classmethod
    def from_model(cls, model: Model) -> IntervalRule | None:
        """Return the rule that a model's calibration defines.

        The target of the rule is the target that the model's card states. The result is None if the model has
        no calibration.
        """
        if model.calibration is None:
            return None
        recipe = model.card.get("recipe")
        exact = isinstance(recipe, dict) and recipe.get("target") == "continuous"
        return cls(
            multiplier=model.calibration.interval_multiplier,
            residual_std_m=model.calibration.residual_std_m,
            target=Target.OPTIMUM if exact else Target.LABEL,
        )


@dataclass(frozen=True, kw_only=True)
class SpreadCalibration:
    """The claim that the interval contains the target in at least the fraction ``at_least`` of decisions.

    The interval must contain the target on all axes. The claim uses only the first answered decision of each
    run, because the later decisions of a run are not independent of its first decision. The verdict depends
    on the exact 95 % confidence interval (Clopper and Pearson) of this fraction. It is *holds* if the whole
    confidence interval is at least ``at_least``, and *violated* if the whole confidence interval is below.
    Otherwise the verdict is *inconclusive*; it is also *inconclusive* if there are fewer than 100 decisions.
    The margin is the difference between the nearer end of the confidence interval and ``at_least``.

    By default, ``intervals`` is the rule of the avoider that made the runs. This avoider must then be a
    shipped network.
    """

    at_least: float = AT_LEAST
    intervals: IntervalRule | None = None
    unit: Unit = Unit.FRACTION

    @property
    def sentence(self) -> str:
        """Return the sentence that reports use."""
        return f"95 % intervals hold the target in at least {self.at_least * 100.0:g} % of decisions"

    def evaluate(self, traces: Iterable[Trace]) -> Evaluation:
        """Judge all runs together."""
        every = list(traces)
        avoiders = {trace.scenario.avoider for trace in every}
        if len(avoiders) > 1:
            return inconclusive(self, f"runs of several avoiders: {', '.join(sorted(avoiders))}")
        problem = next((f"{t.scenario.name}: {w}" for t in every if (w := first_inconsistency(t))), None)
        if problem is not None:
            return inconclusive(self, f"a trace contradicts itself: {problem}")
        if lacking := [name for name in READ if any(trace.known.column(name).limited for trace in every)]:
            return not_measured(self, lacking)
        intervals = self.intervals or (_shipped(avoiders.pop()) if avoiders else None)
        if intervals is None:
            return inconclusive(self, "the avoider states no intervals")
        covered = np.array([c for trace in every if (c := first_covered(trace, intervals)) is not None], bool)
        if len(covered) < LEAST_DECISIONS:
            reason = f"{len(covered)} runs with an answered decision; {LEAST_DECISIONS} are needed"
            return inconclusive(self, reason, exercised=len(covered))
        share = Proportion.from_rows(covered)
        text = (
            f"{share.count} of {share.trials} hold {intervals.target.value}: "
            f"{share.share:.1%}, between {share.low:.1%} and {share.high:.1%}"
        )
        evaluation = inconclusive(self, text, exercised=len(covered))
        if share.low >= self.at_least:
            return replace(evaluation, verdict=Verdict.HOLDS, margin=share.low - self.at_least)
        if share.high < self.at_least:
            return replace(evaluation, verdict=Verdict.VIOLATED, margin=share.high - self.at_least)
        return replace(evaluation, reason=f"too few to tell: {text}")


def _shipped(avoider: str) -> IntervalRule | None:
    return IntervalRule.from_model(load_model(shipped_model(avoider))) if avoider in SHIPPED else None


def first_covered(trace: Trace, intervals: IntervalRule) -> bool | None:
    """Return whether the interval of a run's first answered decision contains the target.

    The result is None if the run has no answered decision.
    """
    answered = proposals(trace)
    if not len(answered):
        return None
    decision = answered[0]
    target = target_in_base_m(decision, trace.scenario.settings, intervals.target)
    scale_m = np.sqrt(np.square(decision["proposed_spread_m"]) + np.square(intervals.residual_std_m))
    off_m = np.abs(decision["proposed_position_in_base_m"] - target)
    return bool(np.all(off_m <= intervals.multiplier * scale_m))  # a NaN is not covered


def target_in_base_m(decision: np.void, settings: Settings, target: Target) -> NDArray[np.float64]:
    """Return the target (3,) by eq. 13 for a decision's question.

    If the computation of the target needs candidates, they are drawn with the decision's seed.
    """
    oracle = NearestCandidate.for_cell(settings)
    hand, tcp = decision["hand_position_in_base_m"], decision["tcp_position_in_base_m"]
    if target is Target.LABEL:
        fresh = seed(int(decision["seed"]), Branch.DECISION, 1)
        label = oracle.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=fresh)
        return label.position_in_base_m
    return np.asarray(optimum_in_base_m(settings, hand[None], tcp[None])[0])
