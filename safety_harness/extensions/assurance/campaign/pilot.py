"""A few runs before a plan's own: how many of those will test each claim, how many it takes, how long.

The runs of a pilot have another seed than the plan's, so that nobody has seen a declared run before it is
declared.  Numbers of runs come from the bounds themselves (``extensions.assurance.statistics.planning``).
Runs without a verdict,
or that could not be carried on, count as tested and as violations, as they do in the upper bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median

from safety_harness.admission.admit import refuse_no_answer
from safety_harness.base.exceptions import StatisticsError
from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.plan import Plan, scenarios_by_avoider
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.campaign.summary import CampaignTally
from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
from safety_harness.extensions.assurance.statistics.binomial import ends_of
from safety_harness.extensions.assurance.statistics.planning import (
    Aim,
    runs_for_power,
    runs_for_tested,
    runs_needed,
)
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome

WANTED = 0.9  # chance of success that a number of runs is planned for
ALONE = 0.05  # by which each interval of a pilot may be wrong, alone
FIRST = 30  # runs of a stratum, before anything is said of the rest
_PILOT = 2  # of the branch of the tree of seeds that is a campaign's


def aim_of(plan: Plan, target: float) -> Aim:
    """What showing a target asks of one claim in one stratum, all bounds of the plan together."""
    family = ends_of(len(plan.claims), len(plan.strata))
    return Aim(target=target, confidence=plan.confidence, family=family, stop_early=plan.stop_early)


@dataclass(frozen=True, kw_only=True)
class ClaimForecast:
    """One claim in one stratum: ``tested`` of ``tried`` runs exercised it, ``bad`` of these may violate it.

    ``needed`` is the least number of tested runs that can show the target, ``runs_needed`` that of all runs:
    with the chance ``WANTED``, if the share of tested runs is that of the pilot, and the violations are too.
    None: no target, or no number will do, or none is known.
    """

    stratum: str
    sentence: str
    target: float | None
    planned: int
    tried: int
    tested: int
    bad: int
    needed: int | None
    runs_needed: int | None
    why: str = ""

    @property
    def expected(self) -> tuple[int, int, int]:
        """How many of the planned runs will test it: least, likely, most (95 % alone)."""
        least = lower_bound(self.tested, self.tried, ALONE / 2)
        most = upper_bound(self.tested, self.tried, ALONE / 2)
        ends = (math.floor(least * self.planned), math.ceil(most * self.planned))
        return ends[0], round(self.tested / self.tried * self.planned), min(ends[1], self.planned)

    @property
    def enough(self) -> bool:
        """Are the planned runs, as far as the pilot tells?"""
        return self.target is None or (self.runs_needed is not None and self.runs_needed <= self.planned)

    @property
    def line(self) -> str:
        """For people."""
        least, likely, most = self.expected
        will = f"{likely} will test it ({least} to {most})"
        if self.target is None:
            return f"{self.stratum}: {self.sentence}: {self.planned} runs: {will}"
        aim = f"{self.planned} runs for {100 * self.target:.3g} %"
        need = f"{self.runs_needed} runs are needed" if self.runs_needed else self.why
        return f"{self.stratum}: {self.sentence}: {aim}: {will}; {need}"


def forecast(plan: Plan, stratum: int, claim: int, *, tried: int, tested: int, bad: int) -> ClaimForecast:
    """From the first ``tried`` runs, of a pilot or of the plan's own."""
    planned, one = plan.claims[claim], plan.strata[stratum]
    found = ClaimForecast(
        stratum=one.name,
        sentence=planned.sentence,
        target=planned.target,
        planned=one.runs,
        tried=tried,
        tested=tested,
        bad=bad,
        needed=None,
        runs_needed=None,
    )
    if planned.target is None:
        return found
    aim = aim_of(plan, planned.target)
    if bad and lower_bound(bad, tested, ALONE) > planned.target:
        return replace(found, why=f"{bad} of {tested} violate it: no number of runs will show it")
    try:
        needed = runs_for_power(aim, probability=bad / tested, wanted=WANTED) if bad else runs_needed(aim)
    except StatisticsError:
        return replace(found, why=f"{bad} of {tested} violate it: too near to the target to plan for")
    if not tested:
        most = upper_bound(0, tried, ALONE)
        least = runs_for_tested(needed, share=most, wanted=WANTED)
        why = f"none of {tried} tests it: {least} runs at least, if {100 * most:.3g} % of them do"
        return replace(found, needed=needed, why=why)
    runs = runs_for_tested(needed, share=tested / tried, wanted=WANTED)
    return replace(found, needed=needed, runs_needed=runs)


def too_few(plan: Plan, tally: CampaignTally) -> Iterator[ClaimForecast]:
    """What the planned runs will not show, as far as ``FIRST`` of them or more tell, and some are missing."""
    for stratum, one in enumerate(tally.strata):
        for claim, found in enumerate(one.claims if one.done >= FIRST and not one.complete else ()):
            counts = found.counts
            tested = one.done - counts[EpisodeOutcome.UNTESTED]
            bad = tested - counts[EpisodeOutcome.HOLDS]
            told = forecast(plan, stratum, claim, tried=one.done, tested=tested, bad=bad)
            if not told.enough:
                yield told


@dataclass(frozen=True, kw_only=True)
class PlanPilot:
    """What the runs of a pilot say of a plan; ``run_s`` is how long one took, by stratum.

    ``remarks``: why they are not of the plan's avoider, and ``slow_answers``, as ``AvoiderWatch`` has them.
    """

    forecasts: tuple[ClaimForecast, ...]
    run_s: tuple[float, ...]
    failures: tuple[str, ...]
    remarks: tuple[str, ...]
    slow_answers: list[str]

    @property
    def enough(self) -> bool:
        """Are the planned runs, for every claim, and was every run of the pilot whole and of the avoider?"""
        return not (self.failures or self.remarks) and all(one.enough for one in self.forecasts)

    def seconds(self, plan: Plan, workers: int) -> float:
        """That the plan's runs will take on this machine, as long as nothing else wants its cores."""
        return sum(s * one.runs for s, one in zip(self.run_s, plan.strata, strict=True)) / workers


def pilot(plan: Plan, runs: int, on_progress: Callable[[int], None] = lambda done: None) -> PlanPilot:
    """Run ``runs`` episodes of each stratum in this process; nothing is written.

    InputError for an avoider that cannot be made, or a plan whose text is to blame.
    """
    plan.world.opener()
    for scenario in scenarios_by_avoider(plan):
        refuse_no_answer(scenario)
    seed = leaf(plan.seed, Branch.CAMPAIGN, _PILOT)
    runner = EpisodeRunner(replace(plan, seed=seed, random_traces=0, violations_kept=0))
    forecasts: list[ClaimForecast] = []
    run_s: list[float] = []
    failures: dict[str, None] = {}
    watch = AvoiderWatch()
    for stratum in range(len(plan.strata)):
        rows: list[Row] = []
        for row in runner.run(stratum, range(runs), keep_violations=False):
            rows.append(row)
            watch.add_row(row, partial(runner.scenario, stratum, row.episode, max(row.draws - 1, 0)))
            on_progress(stratum * runs + len(rows))
        run_s.append(median(row.seconds for row in rows))
        failures |= dict.fromkeys(row.failure for row in rows if row.failure)
        forecasts += _forecasts(plan, stratum, rows)
    return PlanPilot(
        forecasts=tuple(forecasts),
        run_s=tuple(run_s),
        failures=tuple(failures),
        remarks=tuple(watch.remarks(plan)),
        slow_answers=watch.time_lines,
    )


def _forecasts(plan: Plan, stratum: int, rows: Sequence[Row]) -> Iterator[ClaimForecast]:
    for claim in range(len(plan.claims)):
        outcomes = [row.judgements[claim].outcome for row in rows]
        tested = sum(one is not EpisodeOutcome.UNTESTED for one in outcomes)
        bad = tested - sum(one is EpisodeOutcome.HOLDS for one in outcomes)
        yield forecast(plan, stratum, claim, tried=len(rows), tested=tested, bad=bad)
