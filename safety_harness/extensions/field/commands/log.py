"""Define the commands ``safety-harness log``, which check a log and its clocks before ``judge`` uses them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.cli.options import command

_HELP = "List the assumptions about a log, or estimate the offset between its clocks."
commands = Typer(name="log", no_args_is_help=True, help=_HELP, short_help=_HELP)


@command(commands, "check", then="safety-harness judge {log}")
def check(log: Annotated[Path, Argument(help="The description of a log.", metavar="LOG.yaml")]) -> int:
    """List the assumptions on which verdicts on a log depend.

    For each assumption, the command prints the evidence in the log, or the data
    that would confirm the assumption. It reads the whole log, as the command
    judge does, and prints the columns, tracks and intervals that it leaves out.

    Exit code 0: the list is printed, even if some assumptions are unconfirmed.
    Exit code 2: the log cannot be read, or contradicts itself or its
    description.
    """
    from dataclasses import asdict

    from safety_harness.extensions.field.read_log_job import read_log

    log_result = read_log(log)
    notes, assumed = log_result.notes, log_result.assumptions
    for a in assumed:
        result(f"{'confirmed' if a.confirmed_by else 'ASSUMED  '}  {a.what}")
        result(
            f"           by {a.confirmed_by}" if a.confirmed_by else f"           would confirm it: {a.would}"
        )
    say(*(f"note: {note}" for note in notes))
    document(assumptions=[asdict(a) for a in assumed], notes=notes)
    return AS_EXPECTED


@command(commands, "align", then="safety-harness log check {log}")
def align(
    log: Annotated[Path, Argument(help="The description of a log.", metavar="LOG.yaml")],
    body: Annotated[
        str | None,
        Option(help="The hand that moved with the tool. Default: the only hand in the log.", metavar="NAME"),
    ] = None,
) -> int:
    """Estimate how far the hands' clock is ahead.

    The log must show a body that moves with the tool for some seconds, such as
    a marker on the flange or a hand that grips the tool. The command prints the
    line for LOG.yaml. If LOG.yaml already has the key "clock", the command
    ignores this key.

    Exit code 0: the line is printed.
    Exit code 2: the lead of the clock cannot be estimated.
    """
    from safety_harness.base.exceptions import LogError
    from safety_harness.extensions.field.logs.align import align as estimate
    from safety_harness.extensions.field.logs.align import clock_line
    from safety_harness.extensions.field.logs.read import read_log

    data = read_log(log, align=True)
    names = [item.name for item in data.hands]
    chosen = [item for item in data.hands if body in (None, item.name)]
    if len(chosen) != 1:
        raise LogError.of_option("--body", f"one of the log's hands: {', '.join(names) or 'none'}", str(body))
    offset = estimate(data, chosen[0])
    result(clock_line(offset))
    parts = ", ".join(f"{item * 1e3:.1f}" for item in offset.parts_s)
    say(
        f"by parts of the recording: {parts} ms; the arm's motion explains {offset.explained:.1%} of the "
        f"body's, and leaves {offset.off_m * 1e3:.1f} mm"
    )
    document(offset=offset, clock=clock_line(offset))
    return AS_EXPECTED
