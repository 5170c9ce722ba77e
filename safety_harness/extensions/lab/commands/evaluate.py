"""``safety-harness evaluate``: score any avoider directly, before the gate and without a simulation."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import OutputError
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    document,
    explain,
    result,
    say,
)
from safety_harness.cli.options import Seed, command

if TYPE_CHECKING:
    from safety_harness.extensions.lab.scoring.results import Scored, ScoredAvoider
    from safety_harness.extensions.lab.scoring.scorecard import ScoreFinding

PAGE, DATA = "evaluation.html", "evaluation.json"
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
    from safety_harness.admission.avoiders import told_avoider
    from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.lab.pages.score_tables import most_towards
    from safety_harness.extensions.lab.scoring.session import ScoringSession
    from safety_harness.scenario.files import told

    with TERMINAL.steps() as on_step:
        session = ScoringSession(
            avoiders,
            out,
            seed=seed,
            questions=questions,
            budget=search,
            regions=regions or (),
            spaces=spaces or (),
            against=against,
            on_step=on_step,
        )
        scored = session.run()
    say(*(f"error: {one}" for one in scored.failed))
    if not scored.avoiders:
        say(f"{'interrupted: ' if scored.interrupted else ''}nothing was scored")
        return INTERRUPTED if scored.interrupted else BAD_INPUT
    for one in scored.avoiders:
        result(*_lines(one, scored.against))
    result(BASIS_OF_ANSWERS)
    words = ["safety-harness", "evaluate", *map(told_avoider, avoiders)]
    words += ["--search", str(search), "--seed", str(seed)]
    words += [] if questions is None else ["--questions", str(questions)]
    words += [word for name in regions or () for word in ("--region", name)]
    words += [word for path in spaces or () for word in ("--space", str(told(path)))]
    words += [] if against is None else ["--against", told_avoider(against)]
    try:
        _write(scored, out, shlex.join([*words, "--out", str(told(out))]))
    except OutputError as error:
        explain(error)
        return BAD_INPUT
    if scored.interrupted:
        say("interrupted: what was finished is kept")
        return INTERRUPTED
    if scored.failed:
        return BAD_INPUT
    nothing = any(math.isnan(most_towards(one.card)[0]) for one in scored.avoiders)
    return DIFFERS if scored.findings or nothing else AS_EXPECTED


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


def _write(scored: Scored, out: Path, again: str) -> None:
    from safety_harness.base.whole_file import write_text
    from safety_harness.extensions.lab.pages.score_document import document as scores
    from safety_harness.extensions.lab.pages.score_page import ScoreEvidence, render

    text = scores(scored)
    document(**json.loads(text))
    write_text(out / DATA, text)
    evidence = ScoreEvidence(scored=scored, command=again, generated_at=datetime.now(UTC))
    write_text(out / PAGE, render(evidence))
    files = [shown.file.path for one in scored.avoiders for shown in one.worst if shown.file.path]
    if files:
        say(f"worst questions as scenarios: {files[0]} and {len(files) - 1} more")
    say(f"page: {out / PAGE} (for programs: {DATA})")
