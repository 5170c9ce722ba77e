"""What the end of a session needs of a test, as a worker can send it."""

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
    """A test that has ended, as a worker sends it home: what was judged in it, and what became of it.

    ``run`` comes without its traces and errors.  ``simulated`` are runs of which somebody has to judge a
    claim, ``judged`` those that it judged.  ``swallowed``: it passed although a claim failed in it.
    ``traces`` are files for the report, each with the verdict that is expected of an evaluation.
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
        """What ``of_text`` reads, of letters: reports of tests are plain values, also for other plug-ins."""
        run = replace(self.run, worst={}, traces={}, fallback=None, failure=None, refused={})
        return b64encode(pickle.dumps(replace(self, run=run))).decode()


def of_text(text: str) -> EndedTest:
    """Return the test that a process of this session sent."""
    ended: EndedTest = pickle.loads(b64decode(text))
    return ended


def tallies_of(judged: Iterable[Judgement]) -> tuple[ClaimTally, ...]:
    """How often each claim was put to the test."""
    return tally_claims(Judged(run=j.run.name, evaluation=j.evaluation, expected=j.expected) for j in judged)


def differences(every: Iterable[EndedTest]) -> list[RunDifference]:
    """Of several tests, each run once with all the claims that they made of it."""
    runs: dict[str, RunDifference] = {}
    for ended in every:
        for digest, found in ended.run.differences.items():
            before = runs.get(digest, found)
            claims = {one.mine.sentence: one for one in (*before.claims, *found.claims)}
            runs[digest] = replace(before, claims=tuple(claims.values()))
    return list(runs.values())


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
