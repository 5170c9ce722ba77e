"""What was judged in a test, as plain data: a report of xdist can carry nothing else."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

from safety_harness.avoidance.isolation.host import executed
from safety_harness.properties.base import Evaluation, Unit
from safety_harness.scenario.model import Verdict
from safety_harness.testing.session import Judgement, Run, TestRun

Payload = dict[str, Any]


def payload(test: TestRun) -> Payload:
    """Everything that the end of the session needs of ``test``."""
    return {
        "test": test.id,
        "judged": [[*astuple(j.run), j.expected.value, packed(j.evaluation)] for j in test.judgements],
        "kept": None if test.kept is None else str(test.kept),
        "replayed": [str(file) for file in test.replayed],
        "draws": test.draws,
        "computing": [list(astuple(one)) for one in test.computing_times],
        "traces": [],
        "executed": list(executed.values()),
        "failed": False,
    }


def judgements(sent: Payload) -> list[Judgement]:
    """The judgements of a payload."""
    return [
        Judgement(Run(*run), unpacked(evaluation), Verdict(expected))
        for *run, expected, evaluation in sent["judged"]
    ]


def packed(evaluation: Evaluation) -> list[Any]:
    """An evaluation as a list of plain values, in the order of its fields."""
    e = evaluation
    margin = None if e.margin is None else float(e.margin)
    worst_time_s = None if e.worst_time_s is None else float(e.worst_time_s)
    plain = [e.sentence, e.verdict.value, e.unit.name, margin, worst_time_s, e.reason, int(e.exercised)]
    return [*plain, list(map(packed, e.parts))]


def unpacked(values: list[Any]) -> Evaluation:
    """The evaluation of such a list."""
    sentence, verdict, unit, margin, worst_time_s, reason, exercised, parts = values
    return Evaluation(
        sentence=sentence,
        verdict=Verdict(verdict),
        unit=Unit[unit],
        margin=margin,
        worst_time_s=worst_time_s,
        reason=reason,
        exercised=exercised,
        parts=tuple(map(unpacked, parts)),
    )


def junit_properties(test: TestRun) -> list[tuple[str, object]]:
    """For each claim its worst judgement; those of a second claim have names that end in 2, and so on."""
    found: list[tuple[str, object]] = []
    by_sentence: dict[str, list[Judgement]] = {}
    for judgement in test.judgements:
        by_sentence.setdefault(judgement.evaluation.sentence, []).append(judgement)
    for number, (sentence, several) in enumerate(by_sentence.items(), start=1):
        worst = test.worst[sentence]
        evaluation, end = worst.evaluation, "" if number == 1 else f" {number}"
        margin, when = evaluation.margin, evaluation.worst_time_s
        values = {
            "claim": sentence,
            "verdict": evaluation.verdict.value,
            "margin": "" if margin is None else f"{margin * evaluation.unit.per_si:.6g}",
            "unit": evaluation.unit.symbol,
            "worst time": "" if when is None else f"{when:.6g} s",
            "exercised": sum(j.evaluation.exercised for j in several),
            "runs": len(several),
            "scenario": worst.run.name,
            "avoider": worst.run.avoider,
            "seed": worst.run.seed,
        }
        found += [(name + end, value) for name, value in values.items()]
    return found
