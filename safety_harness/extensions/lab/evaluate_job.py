"""Score avoiders without a simulated cell: the function ``safety_harness.evaluate`` and its result."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.admission.avoiders import as_seen_from, told_avoider
from safety_harness.base.output import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import write_text
from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
from safety_harness.extensions.lab.pages.score_document import document
from safety_harness.extensions.lab.pages.score_page import ScoreEvidence, render
from safety_harness.extensions.lab.pages.score_tables import most_towards
from safety_harness.extensions.lab.scoring.results import Scored, ScoredAvoider, ShownQuestion
from safety_harness.extensions.lab.scoring.session import ScoringSession
from safety_harness.scenario.files import display_path
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario

__all__ = ["EvaluationResult", "evaluate"]
PAGE, DATA = "evaluation.html", "evaluation.json"


def evaluate(
    avoiders: str | Path | Iterable[str | Path],
    *,
    regions: Iterable[str] = (),
    spaces: Iterable[str | Path] = (),
    against: str | None = None,
    questions: int | None = None,
    search: int = 4_000,
    seed: int = 0,
    out: str | Path | None = None,
    output: Output = QUIET,
) -> EvaluationResult:
    """Score the answers of avoiders to many questions, without a gate and without a simulation.

    If Ctrl-C interrupts the function, it returns the scores of the avoiders that are finished.

    Args:
        avoiders: One avoider or several.  Each is the name of a shipped avoider, ``FILE.py:NAME`` or a model
            file.
        regions: Names of the regions from which to draw questions.  If both ``regions`` and ``spaces`` are
            empty, the function uses all regions.
        spaces: Scenario spaces.  The function also draws questions that can arise in these spaces.
        against: A reference avoider.  The result omits each finding that the reference avoider has too.  None
            means no reference avoider.
        questions: The number of questions in the first region.  None means that the avoider's speed
            determines the number.
        search: The number of questions in the search for the worst answers. 0 means no search.
        seed: The root of every random number.
        out: The folder to which the search writes scenario files of the worst questions as it finds them.
            None means no files.
        output: The receiver of progress messages.

    Returns:
        The scores of each avoider, and the findings.

    Raises:
        InputError: An avoider, region or space cannot be used.

    """
    given = [avoiders] if isinstance(avoiders, str | Path) else list(avoiders)
    references, areas, files = [str(item) for item in given], list(regions), [Path(item) for item in spaces]
    with output.steps() as on_step:
        scored = ScoringSession(
            references,
            None if out is None else Path(out),
            seed=seed,
            questions=questions,
            budget=search,
            regions=areas,
            spaces=files,
            against=against,
            on_step=on_step,
            replaces=() if out is None else [Path(out) / name for name in (PAGE, DATA)],
        ).run()
    command = ["safety-harness", "evaluate", *map(told_avoider, references)]
    command += ["--search", str(search), "--seed", str(seed)]
    command += [] if questions is None else ["--questions", str(questions)]
    command += [part for name in areas for part in ("--region", name)]
    command += [part for path in files for part in ("--space", str(display_path(path)))]
    command += [] if against is None else ["--against", told_avoider(against)]
    output.say(*(f"error: {item}" for item in scored.failed), *scored.remarks)
    return EvaluationResult(scored, tuple(command), None if out is None else Path(out))


@dataclass(frozen=True, eq=False, repr=False)
class EvaluationResult:
    """The scores of avoiders, and the findings about them.

    Args:
        scored: The score card, the findings and the worst questions of each avoider.
        command: The command line that repeats the scoring, without the option for the folder.
        folder: The folder of the worst questions; None if there is no folder.

    """

    scored: Scored
    command: tuple[str, ...] = ()
    folder: Path | None = None

    @property
    def avoiders(self) -> tuple[ScoredAvoider, ...]:
        """The results of the avoiders that answered; each result has ``findings`` and ``unlike``."""
        return tuple(self.scored.avoiders)

    @property
    def exit_code(self) -> int:
        """The exit code of the command ``evaluate`` for this result."""
        if self.scored.interrupted:
            return INTERRUPTED
        if self.scored.failed or not self.avoiders:
            return BAD_INPUT
        nothing = any(math.isnan(most_towards(avoider.card)[0]) for avoider in self.avoiders)
        return DIFFERS if self.scored.findings or nothing else AS_EXPECTED

    def __repr__(self) -> str:
        of_each = (f"{entry.reference}: {len(entry.findings)} findings" for entry in self.avoiders)
        failed = (f"not scored: {entry}" for entry in self.scored.failed)
        return f"<{'; '.join([*of_each, *failed]) or 'no avoider has a score'}. {BASIS_OF_ANSWERS}>"

    def data(self) -> str:
        """Return the text of evaluation.json."""
        return document(self.scored)

    def write(self, folder: str | Path, output: Output = QUIET) -> EvaluationResult:
        """Write evaluation.html, evaluation.json and the scenario files of the worst questions to a folder.

        If the search has already written the scenario files to this folder, the method leaves them unchanged.

        Args:
            folder: The folder.
            output: The receiver of messages about the written files.

        Returns:
            A copy of the result that refers to the files in the new folder.

        Raises:
            OutputError: The folder cannot be written.

        """
        out = Path(folder)
        scored = self.scored
        if self.folder != out:
            moved = [
                replace(avoider, worst=[_moved(shown, out) for shown in avoider.worst])
                for avoider in scored.avoiders
            ]
            scored = replace(scored, avoiders=moved)
        made = replace(self, scored=scored, folder=out)
        write_text(out / DATA, made.data())
        command = shlex.join([*self.command, "--out", str(display_path(out))])
        evidence = ScoreEvidence(scored=scored, command=command, generated_at=datetime.now(UTC))
        write_text(out / PAGE, render(evidence))
        files = [shown.file.path for avoider in made.avoiders for shown in avoider.worst if shown.file.path]
        if files:
            output.say(f"worst questions as scenarios: {files[0]} and {len(files) - 1} more")
        output.say(f"page: {out / PAGE} (for programs: {DATA})")
        return made


def _moved(shown: ShownQuestion, folder: Path) -> ShownQuestion:
    """Write the scenario file of a worst question to another folder, and return the updated question."""
    old = shown.file.path
    assert old is not None  # the results contain only questions with a file
    path = folder / old.name
    text = write_scenario(as_seen_from(folder, parse_scenario(shown.file.text, old)))
    write_text(path, text)
    return replace(shown, file=replace(shown.file, path=path, text=text))
