"""``safety-harness evaluate``: score any avoider directly, before the gate and without a simulation."""

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
            help="Any avoiders: shipped ones by name, FILE.py:NAME, FILE.safetensors or FILE.onnx.",
            metavar="AVOIDER...",
        ),
    ],
    regions: Annotated[
        list[str] | None, Option("--region", help="Only this named region; may be repeated.", metavar="NAME")
    ] = None,
    spaces: Annotated[
        list[Path] | None,
        Option("--space", help="The hands and TCPs of a space's draws; may be repeated.", metavar="FILE"),
    ] = None,
    against: Annotated[
        str | None,
        Option(help="A reference: findings are faults that it has not, or less often.", metavar="AVOIDER"),
    ] = None,
    questions: Annotated[
        int | None,
        Option(help="Number in the first region; default: as many as the avoider's pace allows.", min=20),
    ] = None,
    search: Annotated[
        int,
        Option(
            help="Number of questions in the search for the worst; 0: no search.", min=0, metavar="BUDGET"
        ),
    ] = 4_000,
    seed: Seed = 0,
    out: Annotated[Path, Option(help="Folder for the page, the figures and the worst questions.")] = Path(
        "reports/evaluate"
    ),
) -> int:
    """Score the answers of avoiders directly, before any gate.

    The command draws hands and TCPs in named regions, or from the draws of a
    space, without a simulation.  It asks the avoider and yardsticks.  A search
    finds the worst questions and writes them as scenario files for run. A Python
    file is executed.

    A finding is an answer that is wrong for any purpose of the avoider: towards
    the hand, out of reach, missing, late, ... Differences from the yardsticks
    appear beside it, and decide only with --against.

    Exit code 0: no finding.
    Exit code 1: findings, or no region got a proposal.
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
        say("no avoider has a score" + "; interrupted: the same command makes all again" * interrupted)
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
        say("interrupted: the finished scores are saved; the same command makes all again")
    else:
        command_line = ["safety-harness", "fuzz", "shipped:reaching-hands", "--avoider", avoiders[0]]
        next_step(shlex.join(command_line), "runs that violate a claim")
    return scores.exit_code


def _lines(scored: ScoredAvoider, against: str) -> Iterator[str]:
    """Yield the terminal's lines about one avoider; ``against`` names the reference or is empty."""
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
    """Return a finding as a line."""
    return f"  {finding.kind.value}{f' ({finding.region})' if finding.region else ''}: {finding.words}"
