"""``safety-harness log``: what has to be known of a log before it can be judged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.cli.options import command

_ABOUT = "Estimate by how much one clock of a log is ahead of the other."
commands = Typer(no_args_is_help=True, help=_ABOUT, short_help=_ABOUT)


@commands.callback()
def _group() -> None:
    """Keeps ``align`` a command of a group, as long as it is the only one."""


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
    from safety_harness.exceptions import LogError
    from safety_harness.logs.align import align as estimate
    from safety_harness.logs.align import words
    from safety_harness.logs.read import read_log

    found = read_log(log, align=True)
    names = [one.name for one in found.hands]
    chosen = [one for one in found.hands if body in (None, one.name)]
    if len(chosen) != 1:
        raise LogError.of_option("--body", f"one of the log's hands: {', '.join(names) or 'none'}", str(body))
    offset = estimate(found, chosen[0])
    result(words(offset))
    parts = ", ".join(f"{one * 1e3:.1f}" for one in offset.parts_s)
    say(
        f"by parts of the recording: {parts} ms; the arm's motion explains {offset.explained:.1%} of the "
        f"body's, and leaves {offset.off_m * 1e3:.1f} mm"
    )
    document(offset=offset, clock=words(offset))
    return AS_EXPECTED
