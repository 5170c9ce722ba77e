"""Score an avoider: its answers in each region, their jumps, their repeatability, and the answer times.

Three yardsticks answer the same questions: the closed-form optimum, the paper's target (``nearest
candidate``) and ``mc-dropout``.  The seed and ``Counts`` determine every result except the times.  A slow
avoider receives fewer questions, whose numbers ``Counts.at_pace`` reduces in a few coarse steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import answers_at_first, first_question
from safety_harness.admission.avoiders import NEAREST, resolve_avoider, scenario_of_avoider
from safety_harness.base.exceptions import NoAnswerError
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector, Vectors, decision_time_of
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.extensions.lab.scoring.asking import asked_alone, asked_together
from safety_harness.extensions.lab.scoring.figures import region_score
from safety_harness.extensions.lab.scoring.jumps import jumps_of
from safety_harness.extensions.lab.scoring.questions import Questions
from safety_harness.extensions.lab.scoring.regions import QuestionRegion
from safety_harness.extensions.lab.scoring.repeats import Subject, compared, repeats
from safety_harness.extensions.lab.scoring.scorecard import (
    AnswerTimes,
    AskedAgain,
    Jumps,
    Moved,
    RegionScore,
    Scorecard,
    WayOfAsking,
)

OPTIMUM, TRAINED = "closed-form optimum", "mc-dropout"
YARDSTICKS = (OPTIMUM, NEAREST, TRAINED)
FEWER = 3_000  # questions to ``NEAREST``: it is slow, and without training its figures are alike anywhere
LATER_S = 2.0  # the least time between the first answers and their repetition
QUICK_S = 0.00015  # the time per question at which some 200,000 questions take half a minute
PROBE = 64  # questions that measure an avoider's pace
_QUESTIONS, _SEGMENTS, _PACE = 0, 1, 2  # last keys of random streams, after the branch and a region's number


@dataclass(frozen=True)
class Counts:
    """The numbers of questions for one avoider.

    The first region has ``first`` questions. Each further region has ``far`` questions if it is far, and
    otherwise ``other`` questions.

    A region is far if its questions cannot occur in a run.  In each region that is not far, there are
    ``segments`` segments on which the hand moves, and as many on which the TCP moves.  The avoider receives
    ``alone`` questions one at a time, and it receives ``sample`` questions repeatedly.
    """

    first: int = 30_000
    other: int = 10_000
    far: int = 2_000
    segments: int = 1_500
    alone: int = 1_000
    sample: int = 1_000

    @classmethod
    def from_total(cls, questions: int) -> Counts:
        """Return counts with ``questions`` in the first region, and all other counts scaled accordingly."""
        return cls()._times(questions / cls.first)

    def _times(self, share: float) -> Counts:
        """Multiply all counts by ``share``; a count does not fall below 20."""
        return Counts(*(max(round(count * share), 20) for count in vars(self).values()))

    def at_pace(self, each_s: float, alone_s: float) -> Counts:
        """Return the counts for an avoider's speed, halved up to eight times if the avoider is slow.

        Args:
            each_s: The time per question if the avoider receives many questions together.
            alone_s: The time per question if the avoider receives one question at a time.  A long time
                reduces ``alone`` further.

        """
        share = 2.0 ** -np.clip(np.ceil(np.log2(max(each_s, 1e-9) / QUICK_S)), 0, 8)
        slow = 10 if alone_s > 0.04 else 3 if alone_s > 0.008 else 1
        return replace(self._times(float(share)), alone=max(self.alone // slow, 20))


@dataclass(frozen=True)
class ClosedForm:
    """The yardstick that answers with the continuous optimum of eq. 13, computed in closed form."""

    settings: Settings = DEFAULTS
    name: str = OPTIMUM

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return the targets of eq. 13 with the continuous optimum, and zero spreads, shape (n, 3) each.

        The method ignores ``seeds``.
        """
        positions = optimum_in_base_m(self.settings, hands_in_base_m, tcps_in_base_m)
        return positions, np.zeros_like(positions)

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the answer for a hand and a TCP.

        ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` have the shape (3,).  The method ignores
        ``seed``.
        """
        hands, tcps = np.asarray(hand_position_in_base_m)[None], np.asarray(tcp_position_in_base_m)[None]
        return Proposal(optimum_in_base_m(self.settings, hands, tcps)[0])


OnStep = Callable[[str], object]


def _ignore(value: object) -> None:
    """Ignore ``value``."""
    return None


def score(
    subject: Subject,
    regions: Sequence[QuestionRegion],
    *,
    seed: int,
    counts: Counts | None = None,
    seen: str = "",
    on_step: OnStep = _ignore,
    on_region: Callable[[Scorecard], object] = _ignore,
) -> Scorecard:
    """Score an avoider, and return its card with scores in every region, repeatability and answer times.

    Args:
        subject: The avoider.
        regions: The regions.
        seed: The root of all random numbers.
        counts: The numbers of questions.  None means that the avoider's speed determines them.
        seen: The name of the source that defines the seen space of the regions.
        on_step: A function that receives the name of each step.
        on_region: A function that receives the unfinished card after each region, so that an interruption
            loses at most one region.

    Raises:
        IndexError: ``regions`` is empty.
        NoAnswerError: The avoider does not answer, or does not return from a call.

    """
    avoider, settings = subject.avoider, regions[0].settings
    on_step("first answers")
    if not answers_at_first(avoider, *first_question(settings)):
        raise NoAnswerError(avoider.name, np.inf)
    counts = counts or paced(subject, regions[0], seed)
    drawn = drawn_questions(regions, seed, counts)
    sample = _sample(regions, drawn, counts.sample)
    begun_s = time.monotonic()
    first = asked_together(avoider, sample)
    few = sample[: counts.alone]
    alone, times_s = asked_alone(avoider, few)
    again: list[AskedAgain] = [compared(WayOfAsking.ALONE, few, first[: len(few)], alone)]
    on_step("the same questions again")
    if len(sample):
        again += repeats(subject, sample, first, counts.alone)
    card = Scorecard(
        avoider=subject.reference,
        name=avoider.name,
        seed=seed,
        seen=seen,
        regions=(),
        jumps=(),
        repeats=tuple(again),
        times=_times(avoider, times_s, settings) if times_s else None,
    )
    for region, jumps in _by_region(avoider, regions, drawn, seed, counts, on_step):
        card = replace(card, regions=(*card.regions, region), jumps=(*card.jumps, *jumps))
        on_region(card)
    time.sleep(max(LATER_S - (time.monotonic() - begun_s), 0.0))
    later = compared(WayOfAsking.LATER, sample, first, asked_together(avoider, sample))
    return replace(card, repeats=(*card.repeats, later))


def yardsticks(
    regions: Sequence[QuestionRegion], *, seed: int, counts: Counts, on_step: OnStep = _ignore
) -> tuple[Scorecard, ...]:
    """Return a card for each of the ``YARDSTICKS``, for the same questions as in ``score``.

    Args:
        regions: The regions.
        seed: The root of all random numbers.
        counts: The numbers of questions.
        on_step: A function that receives the name of each yardstick.

    """
    drawn = drawn_questions(regions, seed, counts)
    cards = []
    for name in YARDSTICKS:
        on_step(name)
        settings = regions[0].settings
        scenario = replace(scenario_of_avoider(name), settings=settings)
        avoider = ClosedForm(settings) if name == OPTIMUM else resolve_avoider(scenario)
        if name == NEAREST:
            scores = tuple(
                _scored(avoider, region, questions[:FEWER])
                for region, questions in zip(regions, drawn, strict=True)
            )
            jumps: tuple[Jumps, ...] = ()
        else:
            both = list(_by_region(avoider, regions, drawn, seed, counts, _ignore))
            scores, jumps = tuple(item for item, _ in both), tuple(item for _, own in both for item in own)
        cards.append(Scorecard(name, avoider.name, seed, "", scores, jumps))
    return tuple(cards)


def drawn_questions(regions: Sequence[QuestionRegion], seed: int, counts: Counts) -> list[Questions]:
    """Draw the questions of each region.

    They depend only on the region, its number, ``seed`` and ``counts``.

    Args:
        regions: The regions.
        seed: The root of all random numbers.
        counts: The numbers of questions.

    """
    return [
        region.draw(
            generator(seed, Branch.SCORING, number, _QUESTIONS),
            (counts.first if number == 0 else counts.other) if region.asked_in_runs else counts.far,
        )
        for number, region in enumerate(regions)
    ]


def paced(subject: Subject, region: QuestionRegion, seed: int) -> Counts:
    """Return the numbers of questions that are suitable for the avoider's speed.

    A second instance of the avoider answers trial questions, because the first instance must not receive any
    question before it is scored.  The function repeats the trial and uses the shortest time.  For an avoider
    in this process, it measures the processor's time, so that other work on the machine hardly changes the
    counts.

    Args:
        subject: The avoider.
        region: The region of the trial questions.
        seed: The root of the random trial questions.

    """
    few = region.draw(generator(seed, Branch.SCORING, 0, _PACE), PROBE)
    probed = subject.another()
    answers_at_first(probed, *first_question(region.settings))
    took = [_took_s(lambda: asked_together(probed, few)) for _ in range(3)]
    wall_s, processor_s = (min(times) / max(len(few), 1) for times in zip(*took, strict=True))
    each_s = max(processor_s, wall_s / 8.0) if subject.in_process else wall_s / 1.5
    _, alone_s = asked_alone(probed, few[:16])
    return Counts().at_pace(each_s, float(np.mean(alone_s)) if alone_s else 0.0)


def _took_s(do: Callable[[], object]) -> tuple[float, float]:
    """Return the wall-clock time and the processor time of a call of ``do`` [s]."""
    begun_s, processor_s = time.perf_counter(), time.process_time()
    do()
    return time.perf_counter() - begun_s, time.process_time() - processor_s


def _sample(regions: Sequence[QuestionRegion], drawn: Sequence[Questions], count: int) -> Questions:
    """Return ``count`` questions that can occur in runs.

    They are the first questions of each region, with equal numbers for all regions.
    """
    usable = [
        questions for region, questions in zip(regions, drawn, strict=True) if region.asked_in_runs
    ] or list(drawn)
    each = -(-count // max(sum(len(part) > 0 for part in usable), 1))
    return Questions.joined([questions[:each] for questions in usable])[:count]


def _by_region(
    avoider: Avoider,
    regions: Sequence[QuestionRegion],
    drawn: Sequence[Questions],
    seed: int,
    counts: Counts,
    on_step: OnStep,
) -> Iterator[tuple[RegionScore, list[Jumps]]]:
    """Score the avoider in each region, and yield the score and the jumps."""
    for number, (region, questions) in enumerate(zip(regions, drawn, strict=True)):
        on_step(region.name)
        scored = _scored(avoider, region, questions)
        jumps: list[Jumps] = []
        if region.asked_in_runs and len(questions):
            for stream, moved in enumerate(Moved):
                rng = generator(seed, Branch.SCORING, number, _SEGMENTS, stream)
                few = min(counts.segments, len(questions))
                ask = partial(asked_together, avoider)
                jumps.append(jumps_of(ask, region, moved, questions, scored.answers, rng, few))
        yield scored, jumps


def _scored(avoider: Avoider, region: QuestionRegion, questions: Questions) -> RegionScore:
    """Return the score of the avoider's answers to the ``questions`` of one region."""
    return region_score(region, questions, asked_together(avoider, questions), region.settings)


def _times(avoider: Avoider, times_s: Sequence[float], settings: Settings) -> AnswerTimes:
    """Return statistics of the measured answer times ``times_s``."""
    deadline_s, all_s = settings.avoidance.decision_deadline_s, np.array(times_s)
    return AnswerTimes(
        questions=len(all_s),
        median_s=float(np.median(all_s)),
        p99_s=float(np.quantile(all_s, 0.99)),
        most_s=float(all_s.max()),
        late=int(np.count_nonzero(all_s > deadline_s)),
        declared_s=decision_time_of(avoider),
        deadline_s=deadline_s,
    )
