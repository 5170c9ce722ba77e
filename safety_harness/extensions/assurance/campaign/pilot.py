"""Run a pilot, that is, a few runs from which a forecast is made.

The forecast states how many runs will test each claim, how many runs the plan needs, and how long these runs
take. A pilot uses a seed that differs from the seed of the plan's runs. Thus the plan's author sees no run of
the plan before the declaration. The required numbers of runs are computed from the same bounds as the
results; see ``extensions.assurance.statistics.planning``.

The forecast treats a failed run, or a run without a verdict, as a tested run that violates the claim. The
upper bounds do the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median

from safety_harness.base.exceptions import StatisticsError
from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.ready import refuse_unready
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

WANTED = 0.9  # chance of success of a planned number of runs
ALONE = 0.05  # allowed error of each interval of a pilot by itself
FIRST = 30  # runs of a stratum that a forecast of its other runs needs
_PILOT = 2  # in the campaign's branch of the tree of seeds


def aim_of(plan: Plan, target: float) -> Aim:
    """Return the aim that the runs show ``target`` for one claim in one stratum.

    The bound that shows the aim must hold simultaneously with all other bounds of the plan.
    """
    family = ends_of(len(plan.claims), len(plan.strata))
    return Aim(target=target, confidence=plan.confidence, family=family, stop_early=plan.stop_early)


@dataclass(frozen=True, kw_only=True)
class ClaimForecast:
    """A forecast for one claim in one stratum.

    The pilot had ``tried`` runs. Of these runs, ``tested`` runs exercised the claim, and ``bad`` runs may
    violate the claim. ``needed`` is the least number of tested runs that can show the target. ``runs_needed``
    is the least number of runs that is expected to contain ``needed`` tested runs. The two numbers suffice
    with probability ``WANTED`` if the frequencies in the plan equal those of the pilot. Both numbers are None
    if there is no target or if no number suffices. In this case, ``why`` has the reason.
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
        """The least, likely and largest number of planned runs that will test the claim.

        The interval has 95 % confidence for each single claim, and not for all claims simultaneously.
        """
        least = lower_bound(self.tested, self.tried, ALONE / 2)
        most = upper_bound(self.tested, self.tried, ALONE / 2)
        ends = (math.floor(least * self.planned), math.ceil(most * self.planned))
        return ends[0], round(self.tested / self.tried * self.planned), min(ends[1], self.planned)

    @property
    def enough(self) -> bool:
        """Whether the planned runs suffice if the plan's frequencies equal those of the pilot."""
        return self.target is None or (self.runs_needed is not None and self.runs_needed <= self.planned)

    @property
    def line(self) -> str:
        """A line that summarises the forecast."""
        least, likely, most = self.expected
        will = f"{likely} will test it ({least} to {most})"
        if self.target is None:
            return f"{self.stratum}: {self.sentence}: {self.planned} runs: {will}"
        aim = f"{self.planned} runs for {100 * self.target:.3g} %"
        need = f"{self.runs_needed} runs are needed" if self.runs_needed else self.why
        return f"{self.stratum}: {self.sentence}: {aim}: {will}; {need}"


def forecast(plan: Plan, stratum: int, claim: int, *, tried: int, tested: int, bad: int) -> ClaimForecast:
    """Return the forecast for a claim from ``tried`` runs.

    The runs are those of a pilot, or the first runs of the plan.
    """
    planned, declared = plan.claims[claim], plan.strata[stratum]
    unknown = ClaimForecast(
        stratum=declared.name,
        sentence=planned.sentence,
        target=planned.target,
        planned=declared.runs,
        tried=tried,
        tested=tested,
        bad=bad,
        needed=None,
        runs_needed=None,
    )
    if planned.target is None:
        return unknown
    aim = aim_of(plan, planned.target)
    # More runs would show the violation more clearly, and not the claim.
    if bad and lower_bound(bad, tested, ALONE) > planned.target:
        return replace(unknown, why=f"{bad} of {tested} violate it: no number of runs will show it")
    try:
        needed = runs_for_power(aim, probability=bad / tested, wanted=WANTED) if bad else runs_needed(aim)
    except StatisticsError:
        return replace(unknown, why=f"{bad} of {tested} violate it: too near to the target to plan for")
    if not tested:
        most = upper_bound(0, tried, ALONE)
        least = runs_for_tested(needed, share=most, wanted=WANTED)
        why = f"untested in {tried} runs: it needs {least} runs or more, if {100 * most:.3g} % test it"
        return replace(unknown, needed=needed, why=why)
    runs = runs_for_tested(needed, share=tested / tried, wanted=WANTED)
    return replace(unknown, needed=needed, runs_needed=runs)


def too_few(plan: Plan, tally: CampaignTally) -> Iterator[ClaimForecast]:
    """Yield a forecast for each claim for which too few runs are planned.

    A stratum is considered if it is unfinished and has at least ``FIRST`` runs.
    """
    for stratum, part in enumerate(tally.strata):
        for claim, judged in enumerate(part.claims if part.done >= FIRST and not part.complete else ()):
            counts = judged.counts
            tested = part.done - counts[EpisodeOutcome.UNTESTED]
            bad = tested - counts[EpisodeOutcome.HOLDS]
            outlook = forecast(plan, stratum, claim, tried=part.done, tested=tested, bad=bad)
            if not outlook.enough:
                yield outlook


@dataclass(frozen=True, kw_only=True)
class PlanPilot:
    """The results of a pilot.

    ``run_s`` is the median time of a run [s] in each stratum. ``remarks`` lists the reasons why the runs do
    not represent the plan's avoider. Both ``remarks`` and ``slow_answers`` come from ``AvoiderWatch``.
    """

    forecasts: tuple[ClaimForecast, ...]
    run_s: tuple[float, ...]
    failures: tuple[str, ...]
    remarks: tuple[str, ...]
    slow_answers: list[str]

    @property
    def enough(self) -> bool:
        """Whether the planned runs suffice for each claim.

        False if the pilot has a failure or a remark.
        """
        return not (self.failures or self.remarks) and all(claim.enough for claim in self.forecasts)

    def seconds(self, plan: Plan, workers: int) -> float:
        """Return the expected time [s] of the plan's runs on this machine.

        The forecast assumes that no other program uses the machine's cores.
        """
        return sum(s * stratum.runs for s, stratum in zip(self.run_s, plan.strata, strict=True)) / workers


def pilot(plan: Plan, runs: int, on_progress: Callable[[int], None] = lambda done: None) -> PlanPilot:
    """Run ``runs`` episodes of each stratum in this process, and write no file.

    Raise InputError if an avoider cannot be made, or if the plan's text causes an error.
    """
    refuse_unready(plan)
    # A seed of its own: no run of the pilot is a run of the plan.
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
        tested = sum(outcome is not EpisodeOutcome.UNTESTED for outcome in outcomes)
        bad = tested - sum(outcome is EpisodeOutcome.HOLDS for outcome in outcomes)
        yield forecast(plan, stratum, claim, tried=len(rows), tested=tested, bad=bad)
