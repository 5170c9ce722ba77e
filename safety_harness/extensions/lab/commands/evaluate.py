"""``safety-harness evaluate``: score any avoider directly, before the gate and without a simulation."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import OutputError
from safety_harness.cli.console import (
    BAD_INPUT,
    document,
    explain,
    result,
    say,
)
from safety_harness.cli.options import Seed, command

if TYPE_CHECKING:
    from safety_harness.extensions.lab.scoring.results import ScoredAvoider
    from safety_harness.extensions.lab.scoring.scorecard import ScoreFinding

commands = Typer()


@command(commands, interrupted="interrupted: nothing was scored")
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
        Option(help="A reference: a finding is what it does not do, or not as often.", metavar="AVOIDER"),
    ] = None,
    questions: Annotated[
        int | None,
        Option(help="In the first region; without it as many as the avoider's pace allows.", min=20),
    ] = None,
    search: Annotated[
        int,
        Option(help="Questions to search with for the worst ones; 0: no search.", min=0, metavar="BUDGET"),
    ] = 4_000,
    seed: Seed = 0,
    out: Annotated[Path, Option(help="Folder for the page, the figures and the worst questions.")] = Path(
        "reports/evaluate"
    ),
) -> int:
    """Score avoiders directly: what are their proposals worth, before any gate, without a simulation?

    Hands and TCPs are drawn in named regions, or as the draws of a space lead to, and put to the avoider and
    to yardsticks; a search of its own looks for the worst questions, written as scenario files that run
    takes.  A Python file is executed.
    A finding is an answer that is wrong whatever the avoider is meant to answer (towards the hand, out of
    reach, none, late, ...).  How it is unlike the yardsticks is reported beside it, and decides with
    --against alone.
    Exit code 0: no finding; 1: findings, or no region with a proposal was asked about; 2: bad input, or an
    avoider that does not answer; 130: interrupted.
    """
    from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.lab.evaluate_job import evaluate as evaluate_avoiders

    found = evaluate_avoiders(
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
    interrupted = found.scored.interrupted
    if not found.avoiders:
        say(f"{'interrupted: ' if interrupted else ''}nothing was scored")
        return found.exit_code
    for one in found.avoiders:
        result(*_lines(one, found.scored.against))
    result(BASIS_OF_ANSWERS)
    document(**json.loads(found.data()))
    try:
        found.write(out, TERMINAL)
    except OutputError as error:
        explain(error)
        return BAD_INPUT
    if interrupted:
        say("interrupted: what was finished is kept")
    return found.exit_code


def _lines(one: ScoredAvoider, against: str) -> Iterator[str]:
    """What the terminal shows of one avoider, scored beside a reference or not."""
    from safety_harness.extensions.lab.commands.evaluation_tables import titled
    from safety_harness.extensions.lab.pages.score_tables import (
        COLUMNS,
        figures,
        repeat_words,
        rows_of,
        times_words,
        towards_words,
    )

    cards = (one.card, *one.yardsticks)
    yield from titled(
        f"{one.reference}: {one.card.name}; below it the yardsticks, which are no duty",
        ("region", "avoider", *COLUMNS),
        [(row.region, row.avoider, *row.cells) for row in rows_of(cards, figures)],
    )
    yield ""
    alike = all(repeat.differ == 0 for repeat in one.card.repeats)
    ways = f"the same bits in all {len(one.card.repeats)} ways of asking"
    told: Sequence[str] = [f"{one.way.value}: {repeat_words(one)}" for one in one.card.repeats if one.differ]
    yield "asked again: " + (ways if alike else "; ".join(told))
    yield f"time: {times_words(one.card)}"
    for search in one.searches:
        yield f"searched {search.region}: {search.asked:,} questions in a ledger of their own"
    yield towards_words(one.card)
    beside = f" that {against} has not" if against else ""
    yield f"{len(one.findings)} findings on {one.reference}{beside}" + (":" if one.findings else "")
    yield from map(_finding, one.findings)
    if one.unlike:
        yield f"unlike the reference in {len(one.unlike)} ways, which decide nothing without --against:"
        yield from map(_finding, one.unlike)


def _finding(one: ScoreFinding) -> str:
    return f"  {one.kind.value}{f' ({one.region})' if one.region else ''}: {one.words}"
