"""Define the commands about this machine: compile in advance, and check the installation."""

from __future__ import annotations

from typing import Annotated

from typer import Option, Typer

from safety_harness.cli.options import command

commands = Typer()
FIRST_RUN = "safety-harness run shipped:first-run"


@command(
    commands,
    interrupted="interrupted: the compiled functions are kept; warm continues",
    then=FIRST_RUN,
)
def warm(
    forget: Annotated[
        bool,
        Option(
            "--forget",
            help="Remove machine code that no process has used for 30 days, and do not compile.",
        ),
    ] = False,
) -> int:
    """Compile the control stack in advance (one to three minutes).

    One call per machine and version is enough. The command simulates short runs in each world whose engine is
    installed, and judges these runs by every claim of the catalogue. It discards the results, and stores the
    machine code for all later processes. The environment variable SAFETY_HARNESS_CACHE states the folder of
    the machine code. By default, it is in the user's cache.

    Exit code 0: the machine code is stored.
    Exit code 1: the machine code cannot be stored.
    Exit code 130: interrupted; the code that was compiled until then is stored.
    """
    from safety_harness.cli.warm import forget_old, warm_up

    return forget_old() if forget else warm_up()


@command(commands, interrupted="interrupted: the rest was not looked at", then=FIRST_RUN)
def doctor() -> int:
    """Check the machine, Python, the caches and the packages.

    The command also simulates and judges one short run with a known verdict. Each line of the result has the
    state ok, missing or problem. The state "missing" means that an optional part is not installed; the line
    states the features that need this part.

    Exit code 0: there is no problem with a part that every run needs.
    Exit code 1: there is a problem with a part that every run needs.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.doctor import examine

    return examine()
