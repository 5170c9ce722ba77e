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
        Path,
        Argument(
            help="A folder that contains the report.json files of many runs, at any depth.", metavar="FOLDER"
        ),
    ],
    out: Annotated[Path, Option(help="The HTML page to write.")] = Path("reports/history.html"),
) -> int:
    """Compare the verdicts, margins and overruling of many revisions.

    The command reads the report.json files of many runs, such as the artefacts
    of a CI, in the order of their dates.

    Exit code 0: no verdict became unexpected, and no avoider is overruled more
    and more often.
    Exit code 1: a verdict became unexpected, or the gate overrules an avoider
    more and more often.
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
