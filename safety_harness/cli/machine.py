"""Define the commands about this machine: compile in advance, and check the installation."""

from __future__ import annotations

from typing import Annotated

from typer import Option, Typer

from safety_harness.cli.options import command

commands = Typer()
FIRST_RUN = "safety-harness run shipped:first-run"


@command(
    commands,
    interrupted="interrupted: what was compiled is kept; warm goes on from there",
    then=FIRST_RUN,
)
def warm(
    forget: Annotated[
        bool, Option("--forget", help="Remove what no process has used for 30 days, and compile nothing.")
    ] = False,
) -> int:
    """Compile the control stack ahead: one to three minutes.

    You need this once per machine and version. The command simulates short runs in each world with an
    installed engine, and judges them by every claim of the catalogue. It discards their results, and keeps
    the machine code for every later process.
    SAFETY_HARNESS_CACHE names the folder; the default is the user's cache.

    Exit code 0: the machine code is there.
    Exit code 1: it cannot be saved.
    Exit code 130: interrupted, with the code compiled so far.
    """
    from safety_harness.cli.warm import forget_old, warm_up

    return forget_old() if forget else warm_up()


@command(commands, interrupted="interrupted: the rest was not looked at", then=FIRST_RUN)
def doctor() -> int:
    """Check machine, Python, caches and packages.

    The command also judges one short run with a known verdict. Each line states ok, missing (an optional
    part, with its use) or problem.

    Exit code 0: no problem.
    Exit code 1: a part that every run needs has a problem.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.doctor import examine

    return examine()
