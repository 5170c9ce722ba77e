"""The command ``safety-harness history``, which shows the reports of many revisions on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, DIFFERS, document, next_step, result, say
from safety_harness.cli.options import command

commands = Typer()


@command(commands)
def history(
    folder: Annotated[
        Path, Argument(help="A folder with the report.json of many runs, at any depth.", metavar="FOLDER")
    ],
    out: Annotated[Path, Option(help="The page.")] = Path("reports/history.html"),
) -> int:
    """Compare many revisions: verdicts, margins, overruling.

    It reads the report.json of many runs, such as a CI's artefacts, in the
    order of their dates.

    Exit code 0: no verdict turned to an unexpected one, and overruling does not grow.
    Exit code 1: a verdict did, or overruling grows.
    Exit code 2: bad input.
    """
    import shlex
    from datetime import UTC, datetime

    from safety_harness.base.exceptions import OutputError
    from safety_harness.extensions.assurance.pages.history import read_history, write_page
    from safety_harness.report.run_result import TRACES
    from safety_harness.scenario.files import display_path

    read = read_history(folder)
    argv = ["safety-harness", "history", str(display_path(folder)), "--out", str(display_path(out))]
    try:
        write_page(out, read, command=shlex.join(argv), generated_at=datetime.now(UTC))
    except OSError as error:
        raise OutputError.from_os_error(out, error) from error
    say(read.sentence, read.revisions[-1].basis)
    turns = [
        {"claim": item.claimed, "turns": item.turns, "as_expected": not item.unlike} for item in read.courses
    ]
    document(revisions=[item.name for item in read.revisions], courses=turns, growing=read.growing, page=out)
    result(str(out))
    traces = folder / read.revisions[-1].name / TRACES
    if traces.is_dir():
        next_step(shlex.join(["safety-harness", "attribute", str(traces)]), "whose fault it is")
    return DIFFERS if read.unlike or read.growing else AS_EXPECTED
