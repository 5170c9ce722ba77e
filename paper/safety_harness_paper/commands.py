"""What this package adds to the command line of ``safety-harness``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from safety_harness.cli.options import Seed, command

commands = typer.Typer()


@command(commands)
def reproduce(
    what: Annotated[
        list[str],
        typer.Argument(
            help="all, table1 ... table5, figure5 ... figure8, timing, outlook, safety; or sensitivity, "
            "which is not part of all.",
            metavar="WHAT...",
        ),
    ],
    scale: Annotated[
        str, typer.Option(help="quick: minutes, to see it run; default: an hour or so; paper: weeks.")
    ] = "default",
    out: Annotated[
        Path, typer.Option(help="Folder for reproduction.html, reproduction.json and work/.")
    ] = Path("reports/reproduction"),
    seed: Seed = 0,
    jobs: Annotated[int, typer.Option(help="Processes at once, each on one core.")] = 2,
) -> int:
    """Measure the paper's tables and figures again: its numbers beside ours, and a verdict on each.

    table1: passes of the network; 2: places of dropout; 3: unseen space; 4: out of reach; 5: convergence.
    figure5: candidates; 6: intervals; 7: a whole trial; 8: two poses. timing: network against images.
    outlook: the paper's own, tried. safety: does the arm keep clear? sensitivity: what is left open.

    Several networks of each kind are trained, evaluated and tried in PyBullet. A line a verdict goes to
    standard output: reproduced, direction only, or not reproduced, and why; the page has all numbers.
    Ctrl-C keeps every finished step; the same command goes on from there.
    Needs PyTorch, which comes with this package.

    Examples: "reproduce all --scale quick" to see it run; "reproduce table4 table5 --jobs 4".
    Exit code 0; 1: a step failed, the page says which; 2: bad input; 130: interrupted.
    """
    from safety_harness_paper.reproduce import reproduce as reproduce_parts

    return reproduce_parts(what, scale=scale, out=out, seed=seed, jobs=jobs)
