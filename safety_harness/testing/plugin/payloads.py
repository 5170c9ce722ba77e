"""Define the record of a test that a worker process sends to the session."""

from __future__ import annotations

import pickle
from base64 import b64decode, b64encode
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from safety_harness.claims.properties.against import RunDifference
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.tally import ClaimTally, Judged, basis_of_tallies, tally_claims
from safety_harness.scenario.model import Verdict
from safety_harness.seams.isolation.telling import executed
from safety_harness.testing.session import Judgement, TestRun


@dataclass(frozen=True, kw_only=True, eq=False)
class EndedTest:
    """A finished test with its judgements and its result, as a worker sends it.

    Attributes:
        run: the test's record, without its traces and errors.
        failed: whether pytest reports a failure.
        swallowed: whether the test passed although a claim failed in it.
        simulated: keys of the simulated runs; some test of the session should judge each of them.
        judged: keys of the runs that the test judged.
        traces: trace files for the report, with the evaluation and the expected verdict of each file.
        executed: the avoider files that the process has executed.

    """

    run: TestRun
    failed: bool = False
    swallowed: bool = False
    simulated: tuple[str, ...] = ()
    judged: tuple[str, ...] = ()
    traces: tuple[tuple[Path, Verdict, Evaluation], ...] = ()
    executed: tuple[str, ...] = field(default_factory=lambda: tuple(executed.values()))

    @property
    def text(self) -> str:
        """Return the record as text for ``of_text``, because a test report may contain only plain values."""
        run = replace(self.run, worst={}, traces={}, fallback=None, failure=None, refused={})
        return b64encode(pickle.dumps(replace(self, run=run))).decode()


def of_text(text: str) -> EndedTest:
    """Return the test that a process of this session sent."""
    ended: EndedTest = pickle.loads(b64decode(text))
    return ended


def tallies_of(judged: Iterable[Judgement]) -> tuple[ClaimTally, ...]:
    """Return how often the judged runs tested each claim."""
    return tally_claims(Judged(run=j.run.name, evaluation=j.evaluation, expected=j.expected) for j in judged)


def differences(every: Iterable[EndedTest]) -> list[RunDifference]:
    """Merge the differences from several tests into one record per run.

    A record contains all claims about its run.
    """
    runs: dict[str, RunDifference] = {}
    for ended in every:
        for digest, difference in ended.run.differences.items():
            merged = runs.get(digest, difference)
            claims = {claim.mine.sentence: claim for claim in (*merged.claims, *difference.claims)}
            runs[digest] = replace(merged, claims=tuple(claims.values()))
    return list(runs.values())


def junit_properties(test: TestRun) -> list[tuple[str, object]]:
    """Return (name, value) pairs for JUnit: the worst judgement of each claim.

    The names of the second claim end in 2, the names of the third claim in 3, and so on.
    """
    properties: list[tuple[str, object]] = []
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
        properties += [(name + end, value) for name, value in values.items()]
    properties += [("expected of another than --avoider", claim) for claim in dict.fromkeys(test.of_another)]
    return properties
