"""A session of scoring: avoiders one after another, with yardsticks, a search and its worst questions."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from safety_harness.admission.avoiders import avoider_sha256, scenario_of_avoider
from safety_harness.base.exceptions import NoAnswerError, Place, ScenarioError, near_miss
from safety_harness.base.settings import DEFAULTS
from safety_harness.base.whole_file import write_text
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.extensions.lab.scoring.against import findings_against
from safety_harness.extensions.lab.scoring.figures import WRONG_M
from safety_harness.extensions.lab.scoring.findings import findings
from safety_harness.extensions.lab.scoring.question_file import question_file
from safety_harness.extensions.lab.scoring.regions import QuestionRegion, named_regions
from safety_harness.extensions.lab.scoring.repeats import Subject, compared
from safety_harness.extensions.lab.scoring.results import Scored, ScoredAvoider, ShownQuestion
from safety_harness.extensions.lab.scoring.score import YARDSTICKS, Counts, paced, score, yardsticks
from safety_harness.extensions.lab.scoring.scorecard import UNSAFE, UNSAFE_OF_NETWORK, Scorecard, WayOfAsking
from safety_harness.extensions.lab.scoring.shown import ShownAvoider, shown, why_not_shown
from safety_harness.extensions.lab.scoring.space_region import space_region
from safety_harness.extensions.lab.scoring.worst import TOLERANCE_M, Tried, search_region, worst_questions
from safety_harness.scenario.references import file_and_name
from safety_harness.space.read import read_space
from safety_harness.space.regions import SeenRegions, seen_by

CLAIMS = (
    f"proposals lead away to within {1e3 * TOLERANCE_M:g} mm",
    f"proposals never sure and more than {1e3 * WRONG_M:g} mm from the optimum",
)
MOST_SHOWN, MOST_TRIED = 10, 30  # of the worst questions, as files
AVOIDER = Place(field="AVOIDER")


@dataclass(eq=False)
class ScoringSession:
    """What is asked for; ``questions`` None: as many as the avoider's pace allows.

    ``out`` keeps the worst questions as files; None keeps none.

    ``regions`` by name and ``spaces`` by file; neither: all regions that have a name.  ``on_step`` is told
    what comes, and what share of the steps is done.
    """

    references: Sequence[str]
    out: Path | None
    seed: int = 0
    questions: int | None = None
    budget: int = 0
    regions: Sequence[str] = ()
    spaces: Sequence[Path] = ()
    against: str | None = None
    on_step: Callable[[str, float], object] = print
    scored: Scored = field(init=False)
    _steps: int = field(default=0, init=False)
    _steps_done: int = field(default=0, init=False)
    _cards: dict[tuple[object, ...], tuple[Scorecard, ...]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.scored = Scored(self.seed, self.budget, against=self.against or "")
        self._space_regions = [space_region(read_space(path), self.seed) for path in self.spaces]

    def run(self) -> Scored:
        """Score them all; Ctrl-C ends it and keeps the avoiders that were finished."""
        subjects = [
            (Subject.of(one, AVOIDER), self._regions(one)) for one in self.references
        ]  # every mistake before anything is asked
        other = None if self.against is None else Subject.of(self.against, Place(field="--against"))
        for _, regions in subjects:
            searched = sum(region.asked_in_runs for region in regions) if self.budget else 0
            of_score = 2 + len(regions)
            self._steps += len(YARDSTICKS) + of_score + searched
            self._steps += 0 if other is None else 1 + of_score
        try:
            for subject, regions in subjects:
                both = [subject] if other is None else [subject, other]
                if missing := "".join(why_not_shown(one, regions) for one in both):
                    self.scored.failed.append(f"{subject.reference}: not applicable: {missing}")
                    continue
                subject, *others = (shown(one, regions[0]) for one in both)
                try:
                    self._take(subject, regions, *others)
                except NoAnswerError as error:
                    self.scored.failed.append(f"{subject.reference}: {error}")
        except KeyboardInterrupt:
            self.scored.interrupted = True
        return self.scored

    def _step(self, words: str) -> None:
        """The next begins; yardsticks that are known already take no steps."""
        self.on_step(words, min(self._steps_done / self._steps, 0.99))
        self._steps_done += 1

    def _seen(self, reference: str) -> SeenRegions:
        return seen_by(reference, folder=None, settings=DEFAULTS)

    def _regions(self, reference: str) -> list[QuestionRegion]:
        named = named_regions(self._seen(reference), DEFAULTS)
        names = [one.name for one in named]
        for name in self.regions:
            if name not in names:
                raise ScenarioError.of_option(
                    "--region", f"one of {', '.join(names)}", repr(name), near_miss(name, names)
                )
        wanted = self.regions or (() if self.spaces else names)
        return [one for one in named if one.name in wanted] + self._space_regions

    def _take(self, subject: Subject, regions: list[QuestionRegion], other: Subject | None = None) -> None:
        reference, counts = subject.reference, self._counts(subject, regions)
        seen = self._seen(reference).source

        def told(what: str) -> None:
            self._step(f"{reference}: {what}")

        cards = self._yardsticks(regions, counts)
        beside: Scorecard | None = None
        if other is not None:
            told(f"beside {other.reference}")
            beside = score(other, regions, seed=self.seed, counts=counts, on_step=told)
        sha256 = avoider_sha256(scenario_of_avoider(reference))
        settings = tuple(region.settings for region in regions)
        known = cards if beside is None else (beside, *cards)

        def of(card: Scorecard) -> ScoredAvoider:
            found = findings(card, cards)
            if beside is not None:
                found = findings_against(card, found, beside, findings(beside, cards), settings)
                return ScoredAvoider(reference, sha256, settings, card, known, found)
            kinds = UNSAFE_OF_NETWORK if _is_trained_here(subject.avoider) else UNSAFE
            unsafe = tuple(one for one in found if one.kind in kinds)
            unlike = tuple(one for one in found if one.kind not in kinds)
            return ScoredAvoider(reference, sha256, settings, card, known, unsafe, unlike)

        partly: list[Scorecard] = []
        try:
            card = score(
                subject,
                regions,
                seed=self.seed,
                counts=counts,
                seen=seen,
                on_step=told,
                on_region=partly.append,
            )
        except KeyboardInterrupt:
            self.scored.avoiders += [of(card) for card in partly[-1:]]
            raise
        if other is not None and beside is not None:
            _refuse_itself(reference, card, other.reference, beside)
        self.scored.avoiders.append(of(card))
        self._search(self.scored.avoiders[-1], subject, regions, told)

    def _counts(self, subject: Subject, regions: list[QuestionRegion]) -> Counts:
        if self.questions is not None:
            return Counts.of(self.questions)
        return paced(subject, regions[0], self.seed)

    def _yardsticks(self, regions: list[QuestionRegion], counts: Counts) -> tuple[Scorecard, ...]:
        """Once for avoiders that are asked the same."""
        key = (counts, *(region.about for region in regions))
        if key not in self._cards:
            self._cards[key] = yardsticks(regions, seed=self.seed, counts=counts, on_step=self._step)
        return self._cards[key]

    def _search(
        self,
        one: ScoredAvoider,
        subject: Subject,
        regions: list[QuestionRegion],
        told: Callable[[str], None],
    ) -> None:
        """Shared evenly among the regions that runs ask about."""
        asked = [(number, region) for number, region in enumerate(regions) if region.asked_in_runs]
        for number, region in asked:
            if self.budget:
                told(f"searching {region.name} for its worst questions")
                budget = max(self.budget // len(asked), 1)
                ledger = search_region(subject.avoider, region, budget=budget, seed=self.seed, number=number)
                one.searches.append(ledger)
                if ledger.interrupted:
                    raise KeyboardInterrupt
        self._write_worst(one, subject, regions, told)

    def _write_worst(
        self,
        one: ScoredAvoider,
        subject: Subject,
        regions: list[QuestionRegion],
        told: Callable[[str], None],
    ) -> None:
        """The worst questions with which a run can begin, as files; the others are counted."""
        slug = _slug(one.reference) + (f"-{len(self.scored.avoiders)}" if len(self.references) > 1 else "")
        by_name = {region.name: region for region in regions}
        for objective, tried in worst_questions(one.searches, MOST_TRIED):
            number = len(one.worst) + 1
            told(f"trying worst question {number}")
            file = question_file(
                (self.out or Path()) / f"{slug}-worst-{number}.yaml",
                one.reference,
                subject.avoider.avoider if isinstance(subject.avoider, ShownAvoider) else subject.avoider,
                tried.hand_in_base_m,
                tried.tcp_in_base_m,
                tried.scenario_seed,
                title=f"worst question {number}: {objective.value}",
                about=_about(tried, self.seed),
                claims=CLAIMS,
                settings=by_name[tried.region].settings,
                robot=by_name[tried.region].robot,
            )
            if file.path is None:
                one.left_out.append(file.remark)
                continue
            if self.out is not None:
                write_text(file.path, file.text)
            one.worst.append(ShownQuestion(objective, tried, file))
            if len(one.worst) == MOST_SHOWN:
                return


def _is_trained_here(avoider: Avoider) -> bool:
    """Return whether the avoider is a network of this package's training, exported or not."""
    return isinstance(avoider, LearnedAvoider) or getattr(avoider, "exported", False)


def _about(tried: Tried, seed: int) -> str:
    return (
        f"Found by a search of {tried.region} (seed {seed}), which estimates nothing. It is the first "
        f"question of this run: the proposal leads {1e3 * tried.gained_m:.1f} mm away from the hand "
        f"(the closed-form optimum: {1e3 * tried.optimum_gained_m:.1f} mm) and is {1e3 * tried.off_m:.1f} mm "
        f"from the optimum, with a largest spread of {1e3 * tried.largest_spread_m:.1f} mm."
    )


def _refuse_itself(reference: str, card: Scorecard, against: str, beside: Scorecard) -> None:
    """ScenarioError if two references are one by name and hash, and answered alike.

    The same Python file in another folder may load other weights.
    """
    hashes = {one: avoider_sha256(scenario_of_avoider(one)) for one in (reference, against)}
    keys = {(sha256, file_and_name(one)[1] if sha256 else one) for one, sha256 in hashes.items()}
    pairs = zip(card.regions, beside.regions, strict=True)
    asked = (compared(WayOfAsking.AGAIN, one.questions, one.answers, other.answers) for one, other in pairs)
    if len(keys) == 1 and not any(again.differ for again in asked):
        got = f"{against}, which is {reference} by its hash: a comparison with itself finds nothing"
        raise ScenarioError.of_option("--against", "another avoider than is scored", got)


def _slug(reference: str) -> str:
    """A reference as part of a file's name."""
    file, name = file_and_name(reference)
    words = f"{os.path.basename(file)} {name}" if file else reference
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")
