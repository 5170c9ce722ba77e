"""Score avoiders, compare them with yardsticks, and search for the questions with their worst answers."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from safety_harness.admission.avoiders import avoider_sha256, scenario_of_avoider
from safety_harness.base.exceptions import NoAnswerError, Place, ScenarioError, near_miss
from safety_harness.base.settings import DEFAULTS
from safety_harness.base.whole_file import write_text
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.measures import WRONG_M
from safety_harness.extensions.lab.scoring.against import findings_against
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
MOST_SHOWN, MOST_TRIED = 10, 30  # the most worst questions that become files, and the most that are tried
AVOIDER = Place(field="AVOIDER")


@dataclass(eq=False)
class ScoringSession:
    """A scoring session: the user's choices, and the method ``run``, which scores the avoiders.

    ``references`` lists references to the avoiders.  ``questions`` is the number of questions in the first
    region, or None if each avoider's speed determines it.  ``budget`` is the number of questions in the
    search for each avoider.  The session writes scenario files of the worst questions to the folder ``out``,
    or no files if ``out`` is None.  ``regions`` lists names of regions, and ``spaces`` lists files of
    scenario spaces.  If both lists are empty, the session uses all named regions.  ``against`` is the
    reference to a reference avoider.  The session calls ``on_step`` with a text about the next step and the
    finished fraction of the steps.  ``replaces`` lists files of an earlier session.  The session removes
    these files before the first question, so that they cannot be mistaken for its own results.
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
    replaces: Sequence[Path] = ()
    scored: Scored = field(init=False)
    _steps: int = field(default=0, init=False)
    _steps_done: int = field(default=0, init=False)
    _cards: dict[tuple[object, ...], tuple[Scorecard, ...]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.scored = Scored(self.seed, self.budget, against=self.against or "")
        self._space_regions = [space_region(read_space(path), self.seed) for path in self.spaces]

    def run(self) -> Scored:
        """Score all avoiders.

        If Ctrl-C ends the session, the result contains all finished avoiders and regions.
        """
        subjects = [
            (Subject.from_reference(entry, AVOIDER), self._regions(entry)) for entry in self.references
        ]  # a wrong name is found before the first question
        rival = (
            None if self.against is None else Subject.from_reference(self.against, Place(field="--against"))
        )
        for file in self.replaces:
            with suppress(OSError):  # a folder that is not writable is refused later, with the page
                file.unlink()
        for _, regions in subjects:
            searched = sum(region.asked_in_runs for region in regions) if self.budget else 0
            of_score = 2 + len(regions)
            self._steps += len(YARDSTICKS) + of_score + searched
            self._steps += 0 if rival is None else 1 + of_score
        try:
            for subject, regions in subjects:
                both = [subject] if rival is None else [subject, rival]
                if missing := "".join(why_not_shown(entry, regions) for entry in both):
                    self.scored.failed.append(f"{subject.reference}: not applicable: {missing}")
                    continue
                subject, *rest = (shown(entry, regions[0]) for entry in both)
                try:
                    self._take(subject, regions, *rest)
                except NoAnswerError as error:
                    self.scored.failed.append(f"{subject.reference}: {error}")
        except KeyboardInterrupt:
            self.scored.interrupted = True
        return self.scored

    def _step(self, text: str) -> None:
        """Call ``on_step`` with a text about the next step and the progress."""
        self.on_step(text, min(self._steps_done / self._steps, 0.99))
        self._steps_done += 1

    def _seen(self, reference: str) -> SeenRegions:
        """Return the regions of an avoider's training data."""
        return seen_by(reference, folder=None, settings=DEFAULTS)

    def _regions(self, reference: str) -> list[QuestionRegion]:
        """Return the regions in which to score an avoider, and raise ScenarioError if a name is unknown."""
        named = named_regions(self._seen(reference), DEFAULTS)
        names = [region.name for region in named]
        for name in self.regions:
            if name not in names:
                raise ScenarioError.of_option(
                    "--region", f"one of {', '.join(names)}", repr(name), near_miss(name, names)
                )
        wanted = self.regions or (() if self.spaces else names)
        return [region for region in named if region.name in wanted] + self._space_regions

    def _take(self, subject: Subject, regions: list[QuestionRegion], rival: Subject | None = None) -> None:
        """Score one avoider, and search for its worst questions.

        If there is a ``rival``, the method scores it too and compares both.
        """
        reference, counts = subject.reference, self._counts(subject, regions)
        seen = self._seen(reference).source

        def say(step: str) -> None:
            self._step(f"{reference}: {step}")

        cards = self._yardsticks(regions, counts)
        beside: Scorecard | None = None
        if rival is not None:
            say(f"beside {rival.reference}")
            beside = score(rival, regions, seed=self.seed, counts=counts, on_step=say)
        sha256 = avoider_sha256(scenario_of_avoider(reference))
        settings = tuple(region.settings for region in regions)
        known = cards if beside is None else (beside, *cards)

        def result_of(card: Scorecard) -> ScoredAvoider:
            result = findings(card, cards)
            if beside is not None:
                result = findings_against(card, result, beside, findings(beside, cards), settings)
                result = tuple(sorted(result, key=lambda finding: finding.kind not in UNSAFE))
                return ScoredAvoider(reference, sha256, settings, card, known, result)
            kinds = UNSAFE_OF_NETWORK if _is_trained_here(subject.avoider) else UNSAFE
            unsafe = tuple(finding for finding in result if finding.kind in kinds)
            unlike = tuple(finding for finding in result if finding.kind not in kinds)
            return ScoredAvoider(reference, sha256, settings, card, known, unsafe, unlike)

        partly: list[Scorecard] = []
        try:
            card = score(
                subject,
                regions,
                seed=self.seed,
                counts=counts,
                seen=seen,
                on_step=say,
                on_region=partly.append,
            )
        except KeyboardInterrupt:
            self.scored.avoiders += [result_of(card) for card in partly[-1:]]
            raise
        if rival is not None and beside is not None:
            self.scored.remarks += _refuse_itself(reference, card, rival.reference, beside)
        self.scored.avoiders.append(result_of(card))
        self._search(self.scored.avoiders[-1], subject, regions, say)

    def _counts(self, subject: Subject, regions: list[QuestionRegion]) -> Counts:
        """Return the numbers of questions to ask an avoider."""
        if self.questions is not None:
            return Counts.from_total(self.questions)
        return paced(subject, regions[0], self.seed)

    def _yardsticks(self, regions: list[QuestionRegion], counts: Counts) -> tuple[Scorecard, ...]:
        """Return the cards of the yardsticks, which are the same for all avoiders with the same questions."""
        key = (counts, *(region.about for region in regions))
        if key not in self._cards:
            self._cards[key] = yardsticks(regions, seed=self.seed, counts=counts, on_step=self._step)
        return self._cards[key]

    def _search(
        self,
        scored: ScoredAvoider,
        subject: Subject,
        regions: list[QuestionRegion],
        say: Callable[[str], None],
    ) -> None:
        """Search for the worst questions, and write their scenario files.

        The method searches the regions whose questions can occur in a run, and divides the budget equally
        among them.
        """
        posed = [(number, region) for number, region in enumerate(regions) if region.asked_in_runs]
        for number, region in posed:
            if self.budget:
                say(f"searching {region.name} for its worst questions")
                budget = max(self.budget // len(posed), 1)
                ledger = search_region(subject.avoider, region, budget=budget, seed=self.seed, number=number)
                scored.searches.append(ledger)
                if ledger.interrupted:
                    raise KeyboardInterrupt
        self._write_worst(scored, subject, regions, say)

    def _write_worst(
        self,
        scored: ScoredAvoider,
        subject: Subject,
        regions: list[QuestionRegion],
        say: Callable[[str], None],
    ) -> None:
        """Write scenario files of the worst questions.

        If no run can begin with a question, list the reason instead.
        """
        slug = _slug(scored.reference) + (f"-{len(self.scored.avoiders)}" if len(self.references) > 1 else "")
        by_name = {region.name: region for region in regions}
        for objective, tried in worst_questions(scored.searches, MOST_TRIED):
            number = len(scored.worst) + 1
            say(f"trying worst question {number}")
            file = question_file(
                (self.out or Path()) / f"{slug}-worst-{number}.yaml",
                scored.reference,
                subject.avoider.avoider if isinstance(subject.avoider, ShownAvoider) else subject.avoider,
                tried.hand_in_base_m,
                tried.tcp_in_base_m,
                tried.scenario_seed,
                title=f"worst question {number}: {objective.value}",
                description=_description(tried, self.seed),
                claims=CLAIMS,
                settings=by_name[tried.region].settings,
                robot=by_name[tried.region].robot,
            )
            if file.path is None:
                scored.left_out.append(file.remark)
                continue
            if self.out is not None:
                write_text(file.path, file.text)
            scored.worst.append(ShownQuestion(objective, tried, file))
            if len(scored.worst) == MOST_SHOWN:
                return


def _is_trained_here(avoider: Avoider) -> bool:
    """Return True if this package trained the avoider, even if it was then exported to an ONNX file."""
    return isinstance(avoider, LearnedAvoider) or getattr(avoider, "exported", False)


def _description(tried: Tried, seed: int) -> str:
    """Return the description of a worst question in its scenario file."""
    return (
        f"A search of {tried.region} (seed {seed}) found this worst question; a search estimates no rate. "
        f"It is the first question of this run. The proposal leads {1e3 * tried.gained_m:.1f} mm away from "
        f"the hand (the closed-form optimum: {1e3 * tried.optimum_gained_m:.1f} mm). It is "
        f"{1e3 * tried.off_m:.1f} mm from the optimum, and its largest spread is "
        f"{1e3 * tried.largest_spread_m:.1f} mm."
    )


def _refuse_itself(reference: str, card: Scorecard, against: str, beside: Scorecard) -> list[str]:
    """Raise ScenarioError if ``reference`` and ``against`` are the same avoider.

    The avoiders are the same if they have the same name, the same hash and the same answers.

    The same name and hash are not sufficient, because the same Python file in another folder may load other
    weights.  If only the answers are the same, the function returns a warning.
    """
    hashes = {name: avoider_sha256(scenario_of_avoider(name)) for name in (reference, against)}
    keys = {(sha256, file_and_name(name)[1] if sha256 else name) for name, sha256 in hashes.items()}
    pairs = zip(card.regions, beside.regions, strict=True)
    comparisons = (
        compared(WayOfAsking.AGAIN, first.questions, first.answers, second.answers) for first, second in pairs
    )
    if any(again.differ for again in comparisons):
        return []
    if len(keys) == 1:
        got = f"{against}, which is {reference} by its hash; a comparison with itself has no findings"
        raise ScenarioError.of_option("--against", "another avoider than is scored", got)
    return [f"warning: {reference} and {against} gave the same answer to every question: is it a copy?"]


def _slug(reference: str) -> str:
    """Convert a reference to a text that can be part of a file's name."""
    file, name = file_and_name(reference)
    text = f"{os.path.basename(file)} {name}" if file else reference
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
