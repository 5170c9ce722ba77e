"""Score avoiders without a cell: ``safety_harness.evaluate``, its result, and the result's page."""

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
from safety_harness.scenario.files import told
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
    """Ask avoiders questions, before any gate and without a simulation, and score their answers.

    Args:
        avoiders: One or many: names of shipped ones, ``FILE.py:NAME``, model files.
        regions: Names of regions to draw questions in; all of them without regions and spaces.
        spaces: Scenario spaces whose draws lead to questions.
        against: A reference: a finding is what it does not do.
        questions: How many in the first region; None: as many as the avoider's pace allows.
        search: Questions to search with for the worst ones; 0: no search.
        seed: Root of every random number.
        out: A folder that keeps the worst questions as soon as they are found.
        output: What hears of the progress.

    Ctrl-C ends it, and the result keeps the avoiders that were finished.

    Raises:
        InputError: An avoider, region or space cannot be used.

    """
    given = [avoiders] if isinstance(avoiders, str | Path) else list(avoiders)
    references, areas, files = [str(one) for one in given], list(regions), [Path(one) for one in spaces]
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
        ).run()
    words = ["safety-harness", "evaluate", *map(told_avoider, references)]
    words += ["--search", str(search), "--seed", str(seed)]
    words += [] if questions is None else ["--questions", str(questions)]
    words += [word for name in areas for word in ("--region", name)]
    words += [word for path in files for word in ("--space", str(told(path)))]
    words += [] if against is None else ["--against", told_avoider(against)]
    output.say(*(f"error: {one}" for one in scored.failed))
    return EvaluationResult(scored, tuple(words), None if out is None else Path(out))


@dataclass(frozen=True, eq=False, repr=False)
class EvaluationResult:
    """The scores of avoiders, and what was found on them.

    Args:
        scored: Each avoider's card, findings, and worst questions.
        command: The command that scores them again, without its folder.
        folder: Where the worst questions are; None: nowhere.

    """

    scored: Scored
    command: tuple[str, ...] = ()
    folder: Path | None = None

    @property
    def avoiders(self) -> tuple[ScoredAvoider, ...]:
        """The avoiders that answered, each with its ``findings`` and ``unlike``."""
        return tuple(self.scored.avoiders)

    @property
    def exit_code(self) -> int:
        """The command's exit code."""
        if self.scored.interrupted:
            return INTERRUPTED
        if self.scored.failed or not self.avoiders:
            return BAD_INPUT
        nothing = any(math.isnan(most_towards(one.card)[0]) for one in self.avoiders)
        return DIFFERS if self.scored.findings or nothing else AS_EXPECTED

    def __repr__(self) -> str:
        of_each = (f"{one.reference}: {len(one.findings)} findings" for one in self.avoiders)
        failed = (f"not scored: {one}" for one in self.scored.failed)
        return f"<{'; '.join([*of_each, *failed]) or 'nothing was scored'}. {BASIS_OF_ANSWERS}>"

    def data(self) -> str:
        """Return the text of evaluation.json."""
        return document(self.scored)

    def write(self, folder: str | Path, output: Output = QUIET) -> EvaluationResult:
        """Write evaluation.html, evaluation.json, and the worst questions that are not there yet as files.

        The result that is returned names the files of the folder.

        Raises:
            OutputError: The folder cannot be written.

        """
        out = Path(folder)
        scored = self.scored
        if self.folder != out:
            moved = [
                replace(one, worst=[_moved(shown, out) for shown in one.worst]) for one in scored.avoiders
            ]
            scored = replace(scored, avoiders=moved)
        made = replace(self, scored=scored, folder=out)
        write_text(out / DATA, made.data())
        command = shlex.join([*self.command, "--out", str(told(out))])
        evidence = ScoreEvidence(scored=scored, command=command, generated_at=datetime.now(UTC))
        write_text(out / PAGE, render(evidence))
        files = [shown.file.path for one in made.avoiders for shown in one.worst if shown.file.path]
        if files:
            output.say(f"worst questions as scenarios: {files[0]} and {len(files) - 1} more")
        output.say(f"page: {out / PAGE} (for programs: {DATA})")
        return made


def _moved(shown: ShownQuestion, folder: Path) -> ShownQuestion:
    """Return a worst question whose file is written to a folder."""
    old = shown.file.path
    assert old is not None  # others are left out
    path = folder / old.name
    text = write_scenario(as_seen_from(folder, parse_scenario(shown.file.text, old)))
    write_text(path, text)
    return replace(shown, file=replace(shown.file, path=path, text=text))
