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
            help="The parts to measure: all, table1 ... table5, figure5 ... figure8, timing, outlook, "
            "safety, or sensitivity. The part all does not include sensitivity.",
            metavar="WHAT...",
        ),
    ],
    scale: Annotated[
        str,
        typer.Option(
            help="The size of the training and the tests: quick takes minutes and is only a first look, "
            "default takes about an hour, and paper takes weeks."
        ),
    ] = "default",
    out: Annotated[
        Path, typer.Option(help="Folder for reproduction.html, reproduction.json and work/.")
    ] = Path("reports/reproduction"),
    seed: Seed = 0,
    jobs: Annotated[int, typer.Option(help="Number of processes, each on one core.")] = 2,
) -> int:
    """Measure the paper's tables and figures again, and judge whether its numbers are reproduced.

    The parts are table1 (the number of passes through the network), table2 (the layers with dropout), table3
    (the unseen space), table4 (positions out of reach), table5 (convergence), figure5 (candidates), figure6
    (intervals), figure7 (a whole trial), figure8 (two poses), timing (the network against images), outlook
    (the paper's own proposals), safety (the arm's distance from hands) and sensitivity (the open choices).

    The command trains and evaluates several networks of each kind, and runs them in PyBullet. It prints a
    line for each verdict: reproduced, direction only, or not reproduced, with the reason. The page shows all
    numbers. After Ctrl-C, every finished step stays saved, and the same command continues. The command needs
    PyTorch, which comes with this package.

    For a first look, which takes minutes, use: reproduce all --scale quick. For two tables, use: reproduce
    table4 table5 --jobs 4.

    Exit code 0: every step is finished.
    Exit code 1: a step failed; the page states which step.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    from safety_harness_paper.reproduce import reproduce as reproduce_parts

    return reproduce_parts(what, scale=scale, out=out, seed=seed, jobs=jobs)
