"""Define the command ``safety-harness hands``, which makes a scenario space from recorded hands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.cli.options import Seed, command

_HELP = "Make a scenario space from recorded hands."
commands = Typer(name="hands", no_args_is_help=True, help=_HELP, short_help=_HELP)


@commands.callback()
def _group() -> None:
    """Keep ``fit`` a subcommand of ``hands``, although the group has no other command."""


@command(commands, "fit", then="safety-harness fuzz {out}")
def fit(
    logs: Annotated[
        list[Path], Argument(help="The descriptions of logs that contain hands.", metavar="LOG.yaml...")
    ],
    out: Annotated[Path, Option(help="The file for the scenario space.", metavar="FILE")] = Path(
        "hands.yaml"
    ),
    seed: Seed = 0,
) -> int:
    """Fit a scenario space to recorded approaches of hands.

    The command fits the speed, the acceleration, the direction, the dwell time,
    the pauses and the number of approaches per hour. It writes a scenario space
    for the commands fuzz and sample. If no distribution fits a quantity, the
    space draws the recorded values instead.

    Exit code 0: the space is written.
    Exit code 2: a log cannot be used, or there are too few approaches.
    """
    from safety_harness.base.whole_file import write_text
    from safety_harness.extensions.field.hands import direction_line, fit_hands, quantity_lines, space_text
    from safety_harness.extensions.field.logs.read import read_log
    from safety_harness.space.read import parse_space

    fitted = fit_hands([read_log(file) for file in logs], seed=seed)
    text = space_text(fitted)
    parse_space(text, out)
    write_text(out, text)
    low, high = fitted.per_hour_interval
    result(f"{fitted.approaches} approaches, {fitted.per_hour:.0f} an hour ({low:.0f} to {high:.0f})")
    for quantity in fitted.quantities:
        result(*quantity_lines(quantity))
    result(direction_line(fitted.direction))
    say(*fitted.notes, f"space: {out}")
    document(fit=fitted, space=str(out))
    return AS_EXPECTED
