"""Define a judged run, which has a trace, the evaluations of its claims, and the command that repeats it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite
from pathlib import Path
from typing import TypedDict

from safety_harness.admission.repeatability import RepeatabilityResult
from safety_harness.admission.taking import Incompatible
from safety_harness.base.exceptions import InputError
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.answered import DEFAULT_CLAIM, by_default, is_claimed
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.tally import ClaimTally, Judged, basis_of_tallies, made_in, tally_claims
from safety_harness.report.words import unknown_files
from safety_harness.scenario.model import Claim, RecordedHand, Scenario, Verdict
from safety_harness.trace.trace import Trace


class AboutRuns(TypedDict, total=False):
    """The facts of a report that concern all runs of the report, and not a single run.

    ``coverage`` counts how often each claim was exercised. It is present if more runs were judged than the
    report shows. ``skipped`` lists scenarios that an avoider does not support. ``refused`` lists the errors
    of unusable inputs. ``against`` has the differences from a reference, and ``repeated`` has the answers of
    a second avoider.
    """

    coverage: Sequence[ClaimTally] | None
    skipped: Sequence[Incompatible]
    refused: Sequence[InputError]
    against: Against | None
    repeated: RepeatabilityResult | None


_NOTHING: AboutRuns = {"coverage": None, "skipped": (), "refused": (), "against": None, "repeated": None}


def with_defaults(facts: AboutRuns) -> AboutRuns:
    """Return ``facts`` with defaults for missing entries.

    Raise TypeError for any other keyword.
    """
    if unknown := facts.keys() - _NOTHING.keys():
        raise TypeError(f"unknown keywords: {', '.join(sorted(unknown))}")
    return _NOTHING | facts


SEVERITY = (Verdict.VIOLATED, Verdict.INCONCLUSIVE, Verdict.HOLDS)


@dataclass(frozen=True)
class JudgedRun:
    """A trace with one evaluation for each claim of its scenario, in the order of the claims.

    If the avoider did not answer in the run, the run gets the further claim "the avoider answered".
    ``replay_command`` is the command line that repeats this run. ``notes`` are sentences for the reader, for
    example about bridged gaps of a recording. ``trace_file`` holds the trace. If the report shows the run
    under the heading of a claim, ``about`` is the index of this claim. Otherwise, ``about`` is None.

    Raises:
        ValueError: The number of evaluations differs from the number of claims.

    """

    trace: Trace
    evaluations: tuple[Evaluation, ...]
    replay_command: str
    notes: tuple[str, ...] = ()
    trace_file: Path | None = None
    about: int | None = None

    def __post_init__(self) -> None:
        claims = len(self.trace.scenario.claims)
        if len(self.evaluations) != claims:
            name, judged = self.trace.scenario.name, len(self.evaluations)
            raise ValueError(f"scenario {name!r} has {claims} claims, got {judged} evaluations")

    def judged_claims(self) -> Iterator[tuple[Claim, Evaluation]]:
        """Yield each claim with its evaluation.

        If the avoider did not answer, the last claim is "the avoider answered".
        """
        yield from zip(self.trace.scenario.claims, self.evaluations, strict=True)
        if self._fallback is not None:
            yield DEFAULT_CLAIM, self._fallback

    @cached_property
    def _fallback(self) -> Evaluation | None:
        """The evaluation of "the avoider answered" for a run in which the avoider failed to answer.

        The evaluation is None if the avoider answered, or if the scenario already has this claim.
        """
        return None if is_claimed(self.trace.scenario.claims) else by_default(self.trace)

    @property
    def as_expected(self) -> tuple[bool, ...]:
        """For each claim, True if it does not apply or if it has the verdict that its author expects."""
        return tuple(
            evaluation.verdict is claim.given(evaluation.margin) or not evaluation.applicable
            for claim, evaluation in self.judged_claims()
        )

    @property
    def applicable(self) -> tuple[bool, ...]:
        """For each claim, whether the claim applies to the system under test."""
        return tuple(evaluation.applicable for _, evaluation in self.judged_claims())

    @property
    def all_as_expected(self) -> bool:
        """True if each claim has its expected verdict and at least one applies, or if there are no claims."""
        return all(self.as_expected) and (any(self.applicable) or not self.applicable)

    def count(self, verdict: Verdict) -> int:
        """Return the number of applicable claims that have the verdict ``verdict``."""
        return sum(e.verdict is verdict and e.applicable for _, e in self.judged_claims())

    def under_claim(self, sentence: str) -> JudgedRun:
        """Return a copy of this run, which the report shows under the heading of the claim ``sentence``.

        ``about`` becomes None if the scenario has no claim with that sentence.
        """
        sentences = [claim.sentence for claim in self.trace.scenario.claims]
        return replace(self, about=sentences.index(sentence) if sentence in sentences else None)

    under = under_claim  # deprecated: the old name, for one release

    def shown_claim(self) -> int | None:
        """Return the index of the claim whose worst moment the pictures and replays show.

        The result is None if no claim qualifies. A claim qualifies only if it has a worst moment. If
        ``about`` is the index of a claim, only that claim qualifies. Otherwise, the worst of the qualifying
        claims is chosen. A violated claim is worse than an inconclusive claim, which is worse than a claim
        that holds. If verdicts are equal, a margin that is a length comes before margins in other units, and
        then the smallest margin comes first.
        """
        ranked = [
            (
                SEVERITY.index(evaluation.verdict),
                evaluation.unit is not Unit.LENGTH,
                evaluation.margin if evaluation.margin is not None and isfinite(evaluation.margin) else inf,
                index,
            )
            for index, evaluation in enumerate(self.evaluations)
            if self.about in (None, index)
            and evaluation.worst_time_s is not None
            and isfinite(evaluation.worst_time_s)
        ]
        return min(ranked)[-1] if ranked else None


def worst_verdict(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the worst of ``verdicts``, or inconclusive if there are no verdicts."""
    return min(verdicts, key=SEVERITY.index, default=Verdict.INCONCLUSIVE)


def notes_of(scenario: Scenario) -> tuple[str, ...]:
    """Return notes about bridged gaps and removed jumps of recordings, and about a program under test."""
    unknown = unknown_files(scenario).removeprefix("; ")
    return (unknown,) * bool(unknown) + tuple(
        f"{hand.name}, {hand.recording}: {note}"
        for hand in scenario.hands
        if isinstance(hand, RecordedHand)
        for note in hand.motion.notes
    )


def tallies(runs: Iterable[JudgedRun]) -> tuple[ClaimTally, ...]:
    """Count how often each claim was exercised over all ``runs``."""
    return tally_claims(
        Judged(run=run.trace.scenario.name, evaluation=evaluation, expected=claim.expected)
        for run in runs
        for claim, evaluation in run.judged_claims()
    )


def basis_of(runs: Sequence[JudgedRun], coverage: Sequence[ClaimTally] | None = None) -> str:
    """Return a sentence on the runs on which the verdicts are based.

    ``coverage`` may include runs that ``runs`` does not contain.
    """
    return basis_of_tallies((made_in(run.trace) for run in runs), coverage or tallies(runs))


def as_expected(runs: Iterable[JudgedRun]) -> tuple[list[bool], int]:
    """Return whether each applicable verdict is as expected, and the number of claims that do not apply."""
    pairs = [same for run in runs for same in zip(run.as_expected, run.applicable, strict=True)]
    own = [expected for expected, applicable in pairs if applicable]
    return own, len(pairs) - len(own)


def answer(runs: Sequence[JudgedRun]) -> str:
    """Return one line that counts the verdicts.

    The line states how many verdicts are as expected, and the number of verdicts of each kind.
    """
    expected, unexpected = as_expected(runs)
    counts = [sum(run.count(kind) for run in runs) for kind in Verdict]
    kinds = ("hold", "violated", "inconclusive", "claims not applicable to the controller")
    parts = [f"{count} {kind}" for count, kind in zip((*counts, unexpected), kinds, strict=True) if count]
    return f"{sum(expected)} of {len(expected)} verdicts as expected" + (
        f" ({', '.join(parts)})" if parts else ""
    )
