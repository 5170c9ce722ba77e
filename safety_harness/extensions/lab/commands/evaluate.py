"""Define ``safety-harness evaluate``, which scores an avoider's answers without a gate or a simulation."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import OutputError
from safety_harness.cli.console import (
    BAD_INPUT,
    document,
    explain,
    next_step,
    result,
    say,
)
from safety_harness.cli.options import Seed, command

if TYPE_CHECKING:
    from safety_harness.extensions.lab.scoring.results import ScoredAvoider
    from safety_harness.extensions.lab.scoring.scorecard import ScoreFinding

commands = Typer()


@command(commands, interrupted="interrupted before any score")
def evaluate(
    avoiders: Annotated[
        list[str],
        Argument(
            help="One or more avoiders: the name of a shipped avoider, FILE.py:NAME, FILE.safetensors or "
            "FILE.onnx.",
            metavar="AVOIDER...",
        ),
    ],
    regions: Annotated[
        list[str] | None,
        Option(
            "--region",
            help="Draw questions only from this named region. May be repeated. Without --region and "
            "--space, all named regions are used.",
            metavar="NAME",
        ),
    ] = None,
    spaces: Annotated[
        list[Path] | None,
        Option(
            "--space",
            help="Draw questions with the hands and TCPs that occur in this scenario space. May be repeated.",
            metavar="FILE",
        ),
    ] = None,
    against: Annotated[
        str | None,
        Option(
            help="A reference avoider. Findings are then only the faults that the reference does not have,"
            " or has less often.",
            metavar="AVOIDER",
        ),
    ] = None,
    questions: Annotated[
        int | None,
        Option(
            help="Number of questions in the first region. Default: the number depends on the speed of the"
            " avoider.",
            min=20,
        ),
    ] = None,
    search: Annotated[
        int,
        Option(
            help="Number of questions in the search for the worst answers. 0 means no search.",
            min=0,
            metavar="BUDGET",
        ),
    ] = 4_000,
    seed: Seed = 0,
    out: Annotated[
        Path,
        Option(help="Folder for the page, the results as JSON, and the questions with the worst answers."),
    ] = Path("reports/evaluate"),
) -> int:
    """Score the answers of avoiders directly, without a gate.

    A question to an avoider consists of the positions of a hand and of the TCP.
    The command draws questions from named regions, from scenario spaces, or
    from both. It passes the questions to the avoider and to reference avoiders
    (yardsticks), without a simulation. A search finds the questions with the
    worst answers, and the command writes these questions as scenario files for
    the command run. If an avoider is a Python file, the command executes this
    file.

    A finding is a defect that is unacceptable in every use of the avoider. For
    example, an answer leads towards the hand, is out of reach, comes late or is
    missing. The command lists differences from the yardsticks separately.
    Without --against, these differences have no effect on the exit code.

    Exit code 0: there is no finding.
    Exit code 1: there are findings, or an avoider made no proposal in any
    region.
    Exit code 2: bad input, or an avoider that does not answer.
    Exit code 130: interrupted.
    """
    from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.lab.evaluate_job import evaluate as evaluate_avoiders

    scores = evaluate_avoiders(
        avoiders,
        regions=regions or (),
        spaces=spaces or (),
        against=against,
        questions=questions,
        search=search,
        seed=seed,
        out=out,
        output=TERMINAL,
    )
    interrupted = scores.scored.interrupted
    if not scores.avoiders:
        say("no avoider has a score" + "; interrupted: the same command repeats all" * interrupted)
        return scores.exit_code
    for avoider in scores.avoiders:
        result(*_lines(avoider, scores.scored.against))
    result(BASIS_OF_ANSWERS)
    document(**json.loads(scores.data()))
    try:
        scores.write(out, TERMINAL)
    except OutputError as error:
        explain(error)
        return BAD_INPUT
    if interrupted:
        say("interrupted: the finished scores are saved; the same command repeats all")
    else:
        command_line = ["safety-harness", "fuzz", "shipped:reaching-hands", "--avoider", avoiders[0]]
        next_step(shlex.join(command_line), "runs that violate a claim")
    return scores.exit_code


def _lines(scored: ScoredAvoider, against: str) -> Iterator[str]:
    """Yield the lines about one avoider for the terminal.

    ``against`` is the name of the reference avoider, or empty if there is no reference avoider.
    """
    from safety_harness.extensions.lab.commands.evaluation_tables import titled
    from safety_harness.extensions.lab.pages.score_tables import (
        COLUMNS,
        figures,
        repeat_words,
        rows_of,
        times_words,
        towards_words,
    )

    cards = (scored.card, *scored.yardsticks)
    yield from titled(
        f"{scored.reference}: {scored.card.name}; below it the yardsticks, for comparison",
        ("region", "avoider", *COLUMNS),
        [(row.region, row.avoider, *row.cells) for row in rows_of(cards, figures)],
    )
    yield ""
    alike = all(repeat.differ == 0 for repeat in scored.card.repeats)
    same = f"the same bits in all {len(scored.card.repeats)} ways of asking"
    diff: Sequence[str] = [
        f"{repeat.way.value}: {repeat_words(repeat)}" for repeat in scored.card.repeats if repeat.differ
    ]
    yield "asked again: " + (same if alike else "; ".join(diff))
    yield f"time: {times_words(scored.card)}"
    for search in scored.searches:
        yield f"searched {search.region}: {search.asked:,} questions in a ledger of their own"
    yield towards_words(scored.card)
    beside = f" that {against} has not" if against else ""
    yield f"{len(scored.findings)} findings on {scored.reference}{beside}" + (":" if scored.findings else "")
    yield from map(_finding, scored.findings)
    if scored.unlike:
        yield f"unlike the reference in {len(scored.unlike)} ways (findings only with --against):"
        yield from map(_finding, scored.unlike)


def _finding(finding: ScoreFinding) -> str:
    """Return the line of text that describes a finding."""
    return f"  {finding.kind.value}{f' ({finding.region})' if finding.region else ''}: {finding.words}"
