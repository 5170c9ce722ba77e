"""Define ``safety-harness attribute``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Typer

from safety_harness.cli.options import (
    AttributionOut,
    Confirm,
    OfAvoider,
    OfController,
    OfFilter,
    OfPredictor,
    OfReplays,
    command,
)

commands = Typer()


@command(commands, interrupted="interrupted before anything was attributed")
def attribute(
    runs: Annotated[
        list[Path],
        Argument(
            help="Scenario files (for example, the files that fuzz writes), traces, or folders with such "
            "files.",
            metavar="RUN...",
        ),
    ],
    avoider: OfAvoider = None,
    controller: OfController = None,
    safety_filter: OfFilter = None,
    predictor: OfPredictor = None,
    out: AttributionOut = None,
    confirm: Confirm = False,
    world: OfReplays = None,
) -> int:
    """Find the part of the system that caused each violation.

    The command repeats the run with one ingredient of the system changed, and then with two. The ingredients
    are the avoider, its deadline, perception, drives and brakes, the servoing camera, prediction, the gate,
    the fallback, the critical distance, and the speed of the hand, which the command halves. If no arm could
    have avoided a violation, the command reports the violation as unavoidable. For a controller other than
    the visual servo, the command leaves out the ingredients that this controller does not have.

    From a trace, the command attributes all violations. From a scenario file, it attributes all violations of
    the unchanged replay. The replays run in the kinematic world, or in the world of --world. If the run of a
    trace used a program, you must pass the program again.

    Exit code 0: for each violation, the command found a cause, or the answer "unavoidable" or "helped by
    nothing tried".
    Exit code 1: the unchanged replay fails, or does not show a violation.
    Exit code 2: bad input; the command repeated no run.
    Exit code 130: interrupted.
    """
    from safety_harness.admission.avoiders import one_of
    from safety_harness.extensions.attribution.commands.attribute_lines import attribute_runs

    beside = {"safety_filter": safety_filter, "predictor": predictor}
    return attribute_runs(runs, one_of(avoider, controller), out, confirm, world, **beside)
