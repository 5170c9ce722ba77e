"""``safety-harness log``: what has to be known of a log before it can be judged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.cli.options import command

_ABOUT = "Check what a log leaves open: what nothing in it confirms, and how far its clocks are apart."
commands = Typer(name="log", no_args_is_help=True, help=_ABOUT, short_help=_ABOUT)


@command(commands, "check")
def check(log: Annotated[Path, Argument(help="The description of a log.", metavar="LOG.yaml")]) -> int:
    """List what verdicts on a log assume, what in it confirms each, and which column would.

    Reads all of it, as judge does, and prints the columns, tracks and intervals that are left out. Exit code
    0, whatever is confirmed; 2: the log contradicts itself or its file, or cannot be read.
    """
    from dataclasses import asdict

    from safety_harness.extensions.field.read_log_job import read_log

    found = read_log(log)
    notes, assumed = found.notes, found.assumptions
    for one in assumed:
        result(f"{'confirmed' if one.confirmed_by else 'ASSUMED  '}  {one.what}")
        result(
            f"           by {one.confirmed_by}"
            if one.confirmed_by
            else f"           would confirm it: {one.would}"
        )
    say(*(f"note: {note}" for note in notes))
    document(assumptions=[asdict(one) for one in assumed], notes=notes)
    return AS_EXPECTED


@command(commands, "align")
def align(
    log: Annotated[Path, Argument(help="The description of a log.", metavar="LOG.yaml")],
    body: Annotated[
        str | None, Option(help="Which of its hands moved with the tool; else the only one.", metavar="NAME")
    ] = None,
) -> int:
    """Estimate by how much the hands' clock is ahead, from a body that moved with the tool.

    That is a marker on the flange, or a hand that holds on to the tool, while the arm moves for some seconds.
    Prints the line for LOG.yaml, whose own key "clock" is not read. Exit code 0; 2: it cannot be estimated.
    """
    from safety_harness.base.exceptions import LogError
    from safety_harness.extensions.field.logs.align import align as estimate
    from safety_harness.extensions.field.logs.align import clock_line
    from safety_harness.extensions.field.logs.read import read_log

    found = read_log(log, align=True)
    names = [one.name for one in found.hands]
    chosen = [one for one in found.hands if body in (None, one.name)]
    if len(chosen) != 1:
        raise LogError.of_option("--body", f"one of the log's hands: {', '.join(names) or 'none'}", str(body))
    offset = estimate(found, chosen[0])
    result(clock_line(offset))
    parts = ", ".join(f"{one * 1e3:.1f}" for one in offset.parts_s)
    say(
        f"by parts of the recording: {parts} ms; the arm's motion explains {offset.explained:.1%} of the "
        f"body's, and leaves {offset.off_m * 1e3:.1f} mm"
    )
    document(offset=offset, clock=clock_line(offset))
    return AS_EXPECTED
