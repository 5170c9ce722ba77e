"""Read the traces that a ledger keeps, and derive further parts of the report from them.

These parts do not depend on the plan's claims.
"""

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
from safety_harness.extensions.assurance.certification.guard import ReportGuard
from safety_harness.extensions.assurance.certification.system import model_of
from safety_harness.extensions.assurance.certification.tools import CellCount, CoverageOfRuns
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import count_words
from safety_harness.search.coverage import AXES, CoverageCell
from safety_harness.search.coverage import Coverage as Cells
from safety_harness.trace.limiting import limit_lines
from safety_harness.trace.trace import Trace

MOST_SUPPOSED = 100  # draws of a stratum for parts that no run tried


@dataclass(frozen=True, eq=False)
class Stored:
    """The trace of a declared run that the plan chose to keep before the run's outcome was known."""

    stratum: int
    episode: int
    trace: Trace


def random_traces(plan: Plan, ledger: Ledger) -> tuple[list[Stored], list[str]]:
    """Return the stored traces of the runs that the plan chose beforehand.

    Also return a reason for each trace that cannot be read.

    Args:
        plan: The plan.
        ledger: The open ledger of the plan's runs.

    """
    random = [random_episodes(plan, stratum) for stratum in range(len(plan.strata))]
    stored, damaged = [], []
    for stratum, episode, _ in ledger.traces():
        if episode not in random[stratum]:
            continue
        try:
            data = ledger.trace(stratum, episode) or b""
            stored.append(Stored(stratum, episode, trace_of(plan, stratum, data)))
        except Exception as error:  # such as a scenario that cannot be read any more
            why = error.got if isinstance(error, InputError) else described(error)
            damaged.append(
                f"{plan.strata[stratum].name}, run {episode}: its stored trace cannot be read: {why}"
            )
    return stored, damaged


def came_nearest(plan: Plan, stored: Sequence[Stored], stratum: int, claim: int) -> str:
    """Return the reason why no stored run of a stratum tested a claim.

    The reason is stated for the stored run in which a hand came nearest.

    Args:
        plan: The plan.
        stored: The stored random runs.
        stratum: The number of the stratum.
        claim: The number of the claim.

    """
    mine = [run for run in stored if run.stratum == stratum]
    if not mine:
        return "the ledger keeps no trace that shows how near the hands came"
    nearest = min(mine, key=lambda run: (np.nanmin(nearest_hand_m(run.trace), initial=np.inf), run.episode))
    evaluation = property_of(plan.claims[claim].claim, nearest.trace.scenario).evaluate(nearest.trace)
    return (
        f"in run {nearest.episode}, which of {len(mine)} kept runs has the nearest hand, {evaluation.reason}"
    )


def untried_in(plan: Plan, stored: Sequence[Stored]) -> list[str]:
    """Return a line for each part of a stratum that no ``stored`` run tried.

    The function also draws ``MOST_SUPPOSED`` scenarios, and assumes that the arm does not move in these
    scenarios. A part that such a scenario would try is treated as tried.
    """
    lines = []
    for number, stratum in enumerate(plan.strata):
        traces = [run.trace for run in stored if run.stratum == number]
        tried = TriedParts.from_traces(*traces)
        if tried.lines():
            start_m = traces[0].ticks["transform_tcp_to_base"][0, :3, 3]
            supposed = TriedParts()
            # Only a few traces are stored: a part may be common in the space, and missing from them by
            # chance.
            for scenario in stratum.space.draws(plan.seed, MOST_SUPPOSED):
                supposed.suppose(scenario, start_m)
            for title, parts in supposed.parts.items():
                tried.join(title, parts, 0)
        lines += [f"{stratum.name}: {line}" for line in tried.lines(stratum.space, subject="kept runs")]
    return lines


def limited_in(plan: Plan, stored: Sequence[Stored]) -> list[str]:
    """Return lines that state, for each stratum, how often limits and safety filters changed a command."""
    lines = []
    for number, stratum in enumerate(plan.strata):
        traces = [run.trace for run in stored if run.stratum == number]
        head = f"{stratum.name}, in {count_words(len(traces), 'stored run', 'stored runs')}"
        lines += [f"{head}: {line}" for line in limit_lines(traces)]
    return lines


def limited_lines(plan: Plan, ledger: Ledger) -> list[str]:
    """Return the result of ``limited_in`` for the stored random runs in ``ledger``.

    If the plan has no user's controller and no safety filter, the result is empty and no trace is read. The
    result is also empty if the computation fails, because the runs remain valid.
    """
    simplest = [plan.with_avoider(stratum.space.simplest) for stratum in plan.strata]
    if not any(scenario.driven or scenario.safety_filter for scenario in simplest):
        return []
    return ReportGuard().run("limits", lambda: limited_in(plan, random_traces(plan, ledger)[0]), [])


def judged_run(trace: Trace) -> JudgedRun:
    """Return ``trace``, judged again by the claims of its scenario."""
    return JudgedRun(trace=trace, evaluations=judge(trace), replay_command="")


def separation_of(plan: Plan, stored: Sequence[Stored]) -> Iterator[SeparationCase]:
    """Yield the worst case of protective separation in each stratum of ``plan``.

    The case comes from the ``stored`` run with the least margin. For every hand, the claim assumes the speed
    of a reaching hand.
    """
    prop = property_of(
        replace(plan.claims[0].claim, sentence=ProtectiveSeparation().sentence), plan.strata[0].space.simplest
    )
    assert isinstance(prop, ProtectiveSeparation)
    for place, stratum in enumerate(plan.strata):
        worst = [
            (case.margin_m, run.episode, case, run.trace)
            for run in stored
            if run.stratum == place and run.trace.scenario.hands and len(run.trace.ticks)
            if (case := prop.worst(run.trace)) is not None
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
    """Yield, for each stratum of ``plan``, how often the avoider's intervals held in the ``stored`` runs."""
    for place, stratum in enumerate(plan.strata):
        model = model_of(plan.with_avoider(stratum.space.simplest))
        prop = SpreadCalibration(intervals=None if model is None else IntervalRule.from_model(model))
        evaluation = prop.evaluate(run.trace for run in stored if run.stratum == place)
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
    """Return the coverage by all runs in ``ledger``.

    Each run with a hand belongs to one cell of the map.
    """
    rows = [(labels.split(", "), int(runs), int(bad)) for labels, runs, bad in ledger.all(_CELLS)]
    cells = tuple(
        CellCount(*labels, runs=runs, violating=bad) for labels, runs, bad in rows if len(labels) == len(AXES)
    )
    ((every,),) = ledger.all("SELECT count(*) FROM episode")
    runs = sum(cell.runs for cell in cells)
    return CoverageOfRuns(
        runs=runs,
        without_hand=int(every) - runs,
        cells=cells,
        about=f"All declared runs: {runs} of {every} had a hand and fall into {len(cells)} of 1,536 cells. "
        "The axes are direction of the approach, speed of the hand, least distance, outcome of the gravest "
        "decision, and hand and TCP inside or outside of the training data. "
        "Many cells cannot be reached by any run.",
    )


def cells_of(coverage: CoverageOfRuns) -> tuple[Cells, dict[CoverageCell, int]]:
    """Return the number of all runs and the number of violating runs in each cell of the coverage map."""
    cells, violating = Cells(without=coverage.without_hand), {}
    for item in coverage.cells:
        cell = CoverageCell(item.direction, item.speed, item.distance, item.seen, item.outcome)
        cells.counts[cell] += item.runs
        if item.violating:
            violating[cell] = item.violating
    return cells, violating
