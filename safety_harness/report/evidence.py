"""One judged run: a trace, what every claim came out as, and how to see it again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite
from pathlib import Path
from typing import TypedDict

from safety_harness.admission.repeatability import RepeatabilityResult
from safety_harness.admission.taking import NotTaken
from safety_harness.base.exceptions import InputError
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.answered import DEFAULT_CLAIM, by_default, is_claimed
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.tally import ClaimTally, Judged, basis_of_tallies, made_in, tally_claims
from safety_harness.report.words import unknown_files
from safety_harness.scenario.model import Claim, RecordedHand, Scenario, Verdict
from safety_harness.trace.trace import Trace


class AboutRuns(TypedDict, total=False):
    """What a report says of all its runs together.

    ``coverage`` is how often each claim was put to the test, where that was in more runs than are shown;
    ``skipped`` is what an avoider could not take, ``refused`` what could not be used at all, ``against`` what
    is worse than with a reference, ``repeated`` what a second avoider answered to their questions.
    """

    coverage: Sequence[ClaimTally] | None
    skipped: Sequence[NotTaken]
    refused: Sequence[InputError]
    against: Against | None
    repeated: RepeatabilityResult | None


_NOTHING: AboutRuns = {"coverage": None, "skipped": (), "refused": (), "against": None, "repeated": None}


def with_defaults(about: AboutRuns) -> AboutRuns:
    """Return it with what was left out; TypeError for any other keyword."""
    if others := about.keys() - _NOTHING.keys():
        raise TypeError(f"unknown keywords: {', '.join(sorted(others))}")
    return _NOTHING | about


SEVERITY = (Verdict.VIOLATED, Verdict.INCONCLUSIVE, Verdict.HOLDS)


@dataclass(frozen=True)
class JudgedRun:
    """A trace with one evaluation for each of its scenario's claims, in their order.

    A run in which the avoider did not answer has one claim more than its scenario makes: that it did.
    ``replay_command`` is the command line that repeats this run; ``notes`` are sentences for the
    reader (what was bridged in a recording, say); ``trace_file`` is where the trace is kept.  ``about`` is
    the index of the claim under whose heading it stands, None below one that is no claim's.
    Raises ValueError when the numbers of evaluations and claims differ.
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
        """Each claim with its evaluation; last that the avoider answered, where it did not."""
        yield from zip(self.trace.scenario.claims, self.evaluations, strict=True)
        if self._fallback is not None:
            yield DEFAULT_CLAIM, self._fallback

    @cached_property
    def _fallback(self) -> Evaluation | None:
        """The word on an avoider that did not answer, where the scenario makes no claim of that itself."""
        return None if is_claimed(self.trace.scenario.claims) else by_default(self.trace)

    @property
    def as_expected(self) -> tuple[bool, ...]:
        """For each claim, whether the verdict is the one that its author expects; so are claims of others."""
        return tuple(
            evaluation.verdict is claim.given(evaluation.margin) or not evaluation.applicable
            for claim, evaluation in self.judged_claims()
        )

    @property
    def applicable(self) -> tuple[bool, ...]:
        """For each claim, whether it is one about the system under test."""
        return tuple(evaluation.applicable for _, evaluation in self.judged_claims())

    @property
    def all_as_expected(self) -> bool:
        """Whether every claim came out as expected, and any is of the system; true without claims."""
        return all(self.as_expected) and (any(self.applicable) or not self.applicable)

    def count(self, verdict: Verdict) -> int:
        """How many claims came out as ``verdict``."""
        return sum(e.verdict is verdict and e.applicable for _, e in self.judged_claims())

    def under(self, sentence: str) -> JudgedRun:
        """The same run below a heading with this claim's sentence; below no claim's, if it has none such."""
        sentences = [claim.sentence for claim in self.trace.scenario.claims]
        return replace(self, about=sentences.index(sentence) if sentence in sentences else None)

    def shown_claim(self) -> int | None:
        """Index of the claim whose worst moment every picture and replay shows; None when it names none.

        It is the heading's.  Below no claim's heading it is the one that went worst: violated before
        inconclusive before holds, lengths before other units, then the smallest margin.
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
    """Return the worst of some verdicts; inconclusive for none."""
    return min(verdicts, key=SEVERITY.index, default=Verdict.INCONCLUSIVE)


def notes_of(scenario: Scenario) -> tuple[str, ...]:
    """What a reader has to know of recordings (gaps that were bridged, jumps removed) and of a program."""
    unknown = unknown_files(scenario).removeprefix("; ")
    return (unknown,) * bool(unknown) + tuple(
        f"{hand.name}, {hand.recording}: {note}"
        for hand in scenario.hands
        if isinstance(hand, RecordedHand)
        for note in hand.motion.notes
    )


def tallies(runs: Iterable[JudgedRun]) -> tuple[ClaimTally, ...]:
    """How often each claim was put to the test over all ``runs``."""
    return tally_claims(
        Judged(run=run.trace.scenario.name, evaluation=evaluation, expected=claim.expected)
        for run in runs
        for claim, evaluation in run.judged_claims()
    )


def basis_of(runs: Sequence[JudgedRun], coverage: Sequence[ClaimTally] | None = None) -> str:
    """Say what the verdicts of ``runs`` rest on; ``coverage`` where more runs were judged than are here."""
    return basis_of_tallies((made_in(run.trace) for run in runs), coverage or tallies(runs))


def as_expected(runs: Iterable[JudgedRun]) -> tuple[list[bool], int]:
    """Whether each verdict is the expected one, and how many claims do not concern what was tested."""
    pairs = [same for run in runs for same in zip(run.as_expected, run.applicable, strict=True)]
    own = [expected for expected, applicable in pairs if applicable]
    return own, len(pairs) - len(own)


def answer(runs: Sequence[JudgedRun]) -> str:
    """Return in one line how many verdicts are as expected, and how many of each kind there are."""
    expected, others = as_expected(runs)
    counts = [sum(run.count(kind) for run in runs) for kind in Verdict]
    kinds = ("hold", "violated", "inconclusive", "claims not applicable to the controller")
    words = [f"{count} {kind}" for count, kind in zip((*counts, others), kinds, strict=True) if count]
    return f"{sum(expected)} of {len(expected)} verdicts as expected" + (
        f" ({', '.join(words)})" if words else ""
    )
