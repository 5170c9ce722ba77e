"""``safety-harness history``: many revisions' reports as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, DIFFERS, document, result, say
from safety_harness.cli.options import command

commands = Typer()


@command(commands)
def history(
    folder: Annotated[
        Path, Argument(help="A folder with the report.json of many runs, at any depth.", metavar="FOLDER")
    ],
    out: Annotated[Path, Option(help="The page.")] = Path("reports/history.html"),
) -> int:
    """What turned over the revisions: verdicts, margins, overruling.

    Reads the report.json of many runs, say a CI's artefacts, in the order in which they were made.
    Exit code 0: nothing turned to what is not expected; 1: a verdict did, or overruling grows; 2: bad input.
    """
    import shlex
    from datetime import UTC, datetime

    from safety_harness.base.exceptions import OutputError
    from safety_harness.extensions.assurance.pages.history import read_history, write_page
    from safety_harness.scenario.files import told

    found = read_history(folder)
    words = ["safety-harness", "history", str(told(folder)), "--out", str(told(out))]
    try:
        write_page(out, found, command=shlex.join(words), generated_at=datetime.now(UTC))
    except OSError as error:
        raise OutputError.of(out, error) from error
    say(found.sentence, found.revisions[-1].basis)
    turns = [
        {"claim": one.claimed, "turns": one.turns, "as_expected": not one.unlike} for one in found.courses
    ]
    document(revisions=[one.name for one in found.revisions], courses=turns, growing=found.growing, page=out)
    result(str(out))
    return DIFFERS if found.unlike or found.growing else AS_EXPECTED
