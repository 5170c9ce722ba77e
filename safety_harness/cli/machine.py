"""Commands about this machine: compile ahead, and check the installation."""

from __future__ import annotations

from typing import Annotated

from typer import Option, Typer

from safety_harness.cli.options import command

commands = Typer()


@command(commands, interrupted="interrupted: what was compiled is kept; warm goes on from there")
def warm(
    forget: Annotated[
        bool, Option("--forget", help="Remove what no process has used for 30 days, and compile nothing.")
    ] = False,
) -> int:
    """Compile the control stack ahead, once for this machine and version: one to three minutes.

    Short runs are simulated in each world whose engine is installed, and judged by every claim of the
    catalogue.  Their results are thrown away; the machine code is kept for every later process.
    It lies in the folder that SAFETY_HARNESS_CACHE names, else in the user's cache.
    Exit code 0: the machine code is there; 1: it cannot be kept; 130: interrupted, what was compiled is kept.
    """
    from safety_harness.cli.warm import forget_old, warm_up

    return forget_old() if forget else warm_up()


@command(commands, interrupted="interrupted: the rest was not looked at")
def doctor() -> int:
    """Check machine, Python, caches and packages, and judge one short run whose verdict is known.

    A line for each: ok, missing (a part that not everybody needs, and what for) or problem.
    Exit code 0: nothing is wrong; 1: something that every run needs is; 130: interrupted.
    """
    from safety_harness.cli.doctor import examine

    return examine()
