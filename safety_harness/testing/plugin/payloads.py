"""What the end of a session needs of a test, as plain values that a worker can send."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, replace
from typing import Any

from safety_harness.claims.properties.against import ClaimDifference, RunDifference
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.tally import ClaimTally, Judged, basis_of_tallies, tally_claims
from safety_harness.scenario.model import Verdict
from safety_harness.seams.isolation.telling import executed
from safety_harness.testing.session import Judgement, Run, TestRun
from safety_harness.trace.overruling import Overruling

Payload = dict[str, Any]


def payload(test: TestRun) -> Payload:
    """Everything that the end of the session needs of ``test``."""
    return {
        "test": test.id,
        "judged": [[*astuple(j.run), j.expected.value, packed(j.evaluation)] for j in test.judgements],
        "kept": None if test.kept is None else str(test.kept),
        "replayed": [str(file) for file in test.replayed],
        "as_kept": test.as_kept,
        "draws": test.draws,
        "computing": [list(astuple(one)) for one in test.computing_times],
        "overruled": {run: list(one.counts) for run, one in test.overruled.items()},
        "tried": {run: one.parts for run, one in test.tried.items()},
        "against": [
            [
                digest,
                run.run,
                *([one.proposals, one.replaced, one.stopped] for one in (run.mine, run.reference)),
                [[packed(one.mine), packed(one.reference)] for one in run.claims],
            ]
            for digest, run in test.differences.items()
        ],
        "not_taken": test.not_taken,
        "of_another": [*dict.fromkeys(test.of_another)],
        "simulated": [],
        "judged_runs": [],
        "swallowed": False,
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


def tallies_of(judged: Iterable[Judgement]) -> tuple[ClaimTally, ...]:
    """How often each claim was put to the test."""
    return tally_claims(Judged(run=j.run.name, evaluation=j.evaluation, expected=j.expected) for j in judged)


def differences(every: Iterable[Payload]) -> list[RunDifference]:
    """Of several payloads, each run once with all the claims that tests made of it."""
    runs: dict[str, RunDifference] = {}
    for sent in every:
        for digest, name, mine, reference, pairs in sent["against"]:
            found = [ClaimDifference(mine=unpacked(a), reference=unpacked(b)) for a, b in pairs]
            new = RunDifference(run=name, claims=(), mine=Overruling(*mine), reference=Overruling(*reference))
            run = runs.setdefault(digest, new)
            claims = {one.mine.sentence: one for one in (*run.claims, *found)}
            runs[digest] = replace(run, claims=tuple(claims.values()))
    return list(runs.values())


def packed(evaluation: Evaluation) -> dict[str, Any]:
    """An evaluation as plain values."""
    e = evaluation
    return vars(e) | {
        "verdict": e.verdict.value,
        "unit": e.unit.name,
        "margin": None if e.margin is None else float(e.margin),
        "worst_time_s": None if e.worst_time_s is None else float(e.worst_time_s),
        "exercised": int(e.exercised),
        "parts": list(map(packed, e.parts)),
    }


def unpacked(values: dict[str, Any]) -> Evaluation:
    """The evaluation of such values."""
    parts = tuple(map(unpacked, values["parts"]))
    typed = {"verdict": Verdict(values["verdict"]), "unit": Unit[values["unit"]], "parts": parts}
    return Evaluation(**values | typed | {"unmeasured": tuple(values["unmeasured"])})


def junit_properties(test: TestRun) -> list[tuple[str, object]]:
    """For each claim its worst judgement; those of a second claim have names that end in 2, and so on."""
    found: list[tuple[str, object]] = []
    by_sentence: dict[str, list[Judgement]] = {}
    for judgement in test.judgements:
        by_sentence.setdefault(judgement.evaluation.sentence, []).append(judgement)
    for number, (sentence, several) in enumerate(by_sentence.items(), start=1):
        worst = test.worst[sentence]
        evaluation, end = worst.evaluation, "" if number == 1 else f" {number}"
        kind, _, name = worst.run.tested.partition(" ")
        margin, when = evaluation.margin, evaluation.worst_time_s
        values = {
            "claim": sentence,
            "verdict": evaluation.verdict.value,
            "margin": "" if margin is None else f"{margin * evaluation.unit.per_si:.6g}",
            "unit": evaluation.unit.symbol,
            "worst time": "" if when is None else f"{when:.6g} s",
            "exercised": sum(j.evaluation.exercised for j in several),
            "runs": len(several),
            "basis": basis_of_tallies((j.run.world for j in several), tallies_of(several)),
            "scenario": worst.run.name,
            kind: name,
            "seed": worst.run.seed,
        }
        if worst.run.beside != worst.run.tested:
            values["tested"] = worst.run.beside
        if evaluation.unmeasured:
            values["not measured"] = ", ".join(evaluation.unmeasured)
        found += [(name + end, value) for name, value in values.items()]
    found += [("expected of another than --avoider", one) for one in dict.fromkeys(test.of_another)]
    return found
