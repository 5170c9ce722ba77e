"""Options and arguments that several commands have, and how a command is called and ends."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, ParamSpec

from typer import Argument, Exit, Option, Typer

from safety_harness.cli.console import BAD_INPUT, INTERRUPTED, explain, say
from safety_harness.exceptions import InputError, SafetyHarnessError

Files = Annotated[
    list[Path], Argument(help="Scenario files, suites, or folders of *.yaml.", metavar="FILE...")
]
KeepGoing = Annotated[
    bool, Option("--keep-going", help="What cannot be used is told and counted, and the rest goes on.")
]
Out = Annotated[Path, Option(help="Folder for report.html and traces/.")]
OfAvoider = Annotated[
    str | None,
    Option(
        help="In place of what the files name: mc-dropout, mc-dropout-full, deterministic, ensemble, "
        "optimum, 'opposite pose', 'nearest candidate', FILE.py:NAME, FILE.safetensors or FILE.onnx.",
        metavar="AVOIDER",
    ),
]
OfReference = Annotated[
    str | None,
    Option(
        "--against",
        help="A reference, as for --avoider: the same draws for both, and only what it does not do is told.",
        metavar="AVOIDER",
    ),
]
Seed = Annotated[int, Option(help="Root of every random number.", min=0)]
_Asked = ParamSpec("_Asked")


def command(
    group: Typer, name: str | None = None, *, interrupted: str = "", failed: int | None = None
) -> Callable[[Callable[_Asked, int]], Callable[_Asked, int]]:
    """A command of ``group``, of a function that returns an exit code, which it ends with.

    The user's mistakes are explained, and are exit code 2.  Any other error of ours is ``failed`` (None: it
    is raised), and Ctrl-C is answered with the words ``interrupted`` (none: it is raised).
    """

    def registered(work: Callable[_Asked, int]) -> Callable[_Asked, int]:
        @wraps(work)
        def answer(*args: _Asked.args, **options: _Asked.kwargs) -> int:
            try:
                return work(*args, **options)
            except SafetyHarnessError as error:
                code = BAD_INPUT if isinstance(error, InputError) else failed
                if code is None:
                    raise
                explain(error)
                return code
            except KeyboardInterrupt:
                if not interrupted:
                    raise
                say(interrupted)
                return INTERRUPTED

        @group.command(name)
        @wraps(work)
        def ended(*args: _Asked.args, **options: _Asked.kwargs) -> None:
            raise Exit(answer(*args, **options))

        return answer

    return registered
