"""What decisions cost in simulated time, and what they took on the machine of the run, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from safety_harness.properties.answered import NOT_MODELLED
from safety_harness.report.words import milliseconds_words
from safety_harness.settings import DecisionCost, DecisionTimes
from safety_harness.trace.trace import Trace


@dataclass(frozen=True)
class ComputingTime:
    """Of one run in which something was decided; ``cost_s`` is the most that a decision may cost."""

    avoider: str
    words: str
    cost_s: float
    period_s: float
    measured_s: tuple[float, ...]  # by the wall's clock; none of decisions that were made together

    @classmethod
    def of(cls, trace: Trace) -> ComputingTime:
        """From its record."""
        settings, measured_s = trace.scenario.settings, trace.decision_latency_s
        cost = settings.avoidance.decision_time
        drawn_s = cost.quantiles_s if isinstance(cost, DecisionTimes) else trace.decisions["decision_time_s"]
        cost_s = float(np.max(drawn_s, initial=0.0))
        return cls(
            trace.provenance.avoider,
            cost_words(cost, cost_s),
            cost_s,
            settings.clock.control_period_s,
            tuple(measured_s[measured_s > 0.0].tolist()),
        )


def cost_words(cost: DecisionCost | DecisionTimes, declared_s: float) -> str:
    """What a decision costs by the settings, ``declared_s`` if they leave it to the avoider."""
    if cost is DecisionCost.WALL_CLOCK:
        return "what each answer took on the wall's clock: the run repeats from its record only"
    if not isinstance(cost, DecisionTimes):
        if declared_s == 0.0:
            return NOT_MODELLED
        return f"{milliseconds_words(declared_s)} a decision, as the avoider declares"
    least, middle, most = (milliseconds_words(float(np.quantile(cost.quantiles_s, q))) for q in (0, 0.5, 1))
    if cost.measured is not None:
        source = f"{cost.measured.questions:,} answers of {cost.measured.avoider} on {cost.measured.machine}"
        return f"drawn for each decision from {source}: median {middle}, at most {most}"
    if cost.quantiles_s[-1] == 0.0:
        return NOT_MODELLED
    always = len(cost.quantiles_s) == 1
    return f"{most} a decision" if always else f"{least} to {most}, drawn for each decision"


def computing_time_lines(traces: Iterable[Trace]) -> list[str]:
    """A line on each avoider that decided, and one more where it took longer than that."""
    return lines_of(ComputingTime.of(trace) for trace in traces if len(trace.decisions))


def lines_of(runs: Iterable[ComputingTime]) -> list[str]:
    """As ``computing_time_lines``."""
    groups: dict[tuple[str, str], list[ComputingTime]] = {}
    for run in runs:
        groups.setdefault((run.avoider, run.words), []).append(run)
    return [line for group in groups.values() for line in _lines(group)]


def _lines(group: list[ComputingTime]) -> Iterator[str]:
    first = group[0]
    yield f"{first.avoider}: {first.words}"
    measured_s = [time_s for run in group for time_s in run.measured_s]
    cost_s = max(run.cost_s for run in group)
    if not measured_s or max(measured_s) <= (cost_s or first.period_s):
        return
    known = f"that it costs at most, {milliseconds_words(cost_s)}"
    limit = known if cost_s else f"a control period, {milliseconds_words(first.period_s)}"
    p99, slowest = (milliseconds_words(float(np.quantile(measured_s, q))) for q in (0.99, 1.0))
    yield (
        f"{first.avoider}: on this machine an answer took longer than {limit}: p99 {p99}, slowest {slowest} "
        f"of {len(measured_s)}; no verdict depends on it"
    )
