"""The traces that a ledger keeps, and what they say besides the plan's claims."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError, described
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.properties.spread_calibration import IntervalRule, SpreadCalibration
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.claims.signals.true_motion import nearest_hand_m
from safety_harness.extensions.assurance.campaign.episodes import random_episodes, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import (
    CalibrationCheck,
    SeparationCase,
    SeparationTerm,
)
from safety_harness.extensions.assurance.certification.system import model_of
from safety_harness.extensions.assurance.certification.tools import CellCount, CoverageOfRuns
from safety_harness.report.evidence import JudgedRun
from safety_harness.search.coverage import AXES, CoverageCell
from safety_harness.search.coverage import Coverage as Cells
from safety_harness.trace.trace import Trace

MOST_SUPPOSED = 100  # draws of a stratum


@dataclass(frozen=True, eq=False)
class Stored:
    """The trace of a declared run that was to be kept whatever came of it."""

    stratum: int
    episode: int
    trace: Trace


def random_traces(plan: Plan, ledger: Ledger) -> tuple[list[Stored], list[str]]:
    """Those of the runs drawn beforehand, and what is wrong with the ones that cannot be read."""
    random = [random_episodes(plan, stratum) for stratum in range(len(plan.strata))]
    found, damaged = [], []
    for stratum, episode, _ in ledger.traces():
        if episode not in random[stratum]:
            continue
        try:
            data = ledger.trace(stratum, episode) or b""
            found.append(Stored(stratum, episode, trace_of(plan, stratum, data)))
        except Exception as error:  # also of a scenario that cannot be read any more
            why = error.got if isinstance(error, InputError) else described(error)
            damaged.append(
                f"{plan.strata[stratum].name}, run {episode}: its stored trace cannot be read: {why}"
            )
    return found, damaged


def came_nearest(plan: Plan, stored: Sequence[Stored], stratum: int, claim: int) -> str:
    """Of the random runs of a stratum that in which a hand came nearest: what it lacked to test a claim."""
    mine = [one for one in stored if one.stratum == stratum]
    if not mine:
        return "no run's trace was kept that says how near they came"
    nearest = min(mine, key=lambda one: (np.nanmin(nearest_hand_m(one.trace), initial=np.inf), one.episode))
    found = property_of(plan.claims[claim].claim, nearest.trace.scenario).evaluate(nearest.trace)
    return f"in run {nearest.episode}, of {len(mine)} kept the one with the nearest hand, {found.reason}"


def untried_in(plan: Plan, stored: Sequence[Stored]) -> list[str]:
    """Of each stratum what no kept run tried, nor would any of some draws beside an arm that stands."""
    lines = []
    for number, stratum in enumerate(plan.strata):
        traces = [one.trace for one in stored if one.stratum == number]
        tried = TriedParts.of(*traces)
        if tried.lines():
            start_m = traces[0].ticks["transform_tcp_to_base"][0, :3, 3]
            supposed = TriedParts()
            for scenario in stratum.space.draws(plan.seed, MOST_SUPPOSED):
                supposed.suppose(scenario, start_m)
            for title, parts in supposed.parts.items():
                tried.join(title, parts, 0)
        lines += [f"{stratum.name}: {line}" for line in tried.lines(stratum.space, of="kept runs")]
    return lines


def judged_run(trace: Trace) -> JudgedRun:
    """Judged again by its scenario's claims."""
    return JudgedRun(trace=trace, evaluations=judge(trace), replay_command="")


def separation_of(plan: Plan, stored: Sequence[Stored]) -> Iterator[SeparationCase]:
    """In each stratum the random run whose pair has least to spare, for a hand that reaches."""
    prop = property_of(
        replace(plan.claims[0].claim, sentence=ProtectiveSeparation().sentence), plan.strata[0].space.simplest
    )
    assert isinstance(prop, ProtectiveSeparation)
    for place, stratum in enumerate(plan.strata):
        worst = [
            (case.margin_m, one.episode, case, one.trace)
            for one in stored
            if one.stratum == place and one.trace.scenario.hands and len(one.trace.ticks)
            if (case := prop.worst(one.trace)) is not None
        ]
        if not worst:
            continue
        _, episode, case, trace = min(worst, key=lambda item: item[:2])
        yield SeparationCase(
            stratum=stratum.name,
            run=f"run {episode}",
            time_s=float(trace.time_s[case.tick]),
            distance_m=case.distance_m,
            required_m=case.required_m,
            hand_speed_mps=case.hand_speed_mps,
            robot_speed_mps=case.robot_speed_mps,
            terms=tuple(
                SeparationTerm(symbol=term.symbol, length_m=term.length_m, meaning=term.assumption)
                for term in case.terms
            ),
        )


def calibration_of(plan: Plan, stored: Sequence[Stored]) -> Iterator[CalibrationCheck]:
    """How often the avoider's intervals held, by stratum."""
    for place, stratum in enumerate(plan.strata):
        model = model_of(plan.with_avoider(stratum.space.simplest))
        prop = SpreadCalibration(intervals=None if model is None else IntervalRule.of(model))
        evaluation = prop.evaluate(one.trace for one in stored if one.stratum == place)
        yield CalibrationCheck(
            stratum=stratum.name,
            sentence=evaluation.sentence,
            decided=evaluation.verdict.value,
            why=evaluation.reason,
            decisions=evaluation.exercised,
        )


_CELLS = (
    "SELECT c.words, count(*), sum(EXISTS (SELECT 1 FROM judgement j WHERE j.stratum = e.stratum AND "
    "j.episode = e.episode AND j.outcome = 1)) "
    "FROM episode e JOIN cell c ON c.id = e.cell GROUP BY c.words ORDER BY c.words"
)


def coverage_of(ledger: Ledger) -> CoverageOfRuns:
    """Of all runs of the plan; a run is in one cell."""
    rows = [(words.split(", "), int(runs), int(bad)) for words, runs, bad in ledger.all(_CELLS)]
    cells = tuple(
        CellCount(*words, runs=runs, violating=bad) for words, runs, bad in rows if len(words) == len(AXES)
    )
    ((every,),) = ledger.all("SELECT count(*) FROM episode")
    runs = sum(cell.runs for cell in cells)
    return CoverageOfRuns(
        runs=runs,
        without_hand=int(every) - runs,
        cells=cells,
        about=f"All declared runs: {runs} of {every} had a hand and fall into {len(cells)} of 1,536 cells, "
        "by the direction of the approach, the hand's speed, the least distance, whether hand and TCP were "
        "where the training data are, and the outcome of the gravest decision. "
        "Many cells cannot be reached by any run.",
    )


def cells_of(coverage: CoverageOfRuns) -> tuple[Cells, dict[CoverageCell, int]]:
    """As the coverage map draws them: all runs, and those that violate a claim."""
    found, violating = Cells(without=coverage.without_hand), {}
    for one in coverage.cells:
        cell = CoverageCell(one.direction, one.speed, one.distance, one.seen, one.outcome)
        found.counts[cell] += one.runs
        if one.violating:
            violating[cell] = one.violating
    return found, violating
