"""Define options and arguments that several commands share, and how a command is called and ends."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from functools import partial, update_wrapper, wraps
from inspect import Parameter, cleandoc, signature
from pathlib import Path
from typing import Annotated, ParamSpec

from typer import Argument, Exit, Option, Typer

from safety_harness.base.exceptions import InputError, SafetyHarnessError
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    answered_as_json,
    explain,
    next_step,
    say,
)

Files = Annotated[
    list[Path],
    Argument(help="Scenario files, suites, folders of *.yaml, or shipped:NAME (list).", metavar="FILE..."),
]
KeepGoing = Annotated[
    bool, Option("--keep-going", help="Report and count unusable inputs, and continue with the rest.")
]
Out = Annotated[Path, Option(help="Folder for report.html and traces/.")]
OfAvoider = Annotated[
    str | None,
    Option(
        help="An avoider in place of the files' own: mc-dropout, mc-dropout-full, deterministic, ensemble, "
        "optimum, student, student-ensemble, 'opposite pose', 'nearest candidate', FILE.py:NAME, "
        "FILE.safetensors, FILE.onnx, FILE.onnx:LAYOUT.",
        metavar="AVOIDER",
    ),
]
OfController = Annotated[
    str | None,
    Option(
        help="A controller in place of the visual servo and its avoider: 'stop when near', "
        "'learned policy', FILE.py:NAME, FILE.onnx, or a program (exec:COMMAND, tcp:HOST:PORT, unix:PATH).",
        metavar="CONTROLLER",
    ),
]
OfFilter = Annotated[
    str | None,
    Option(
        "--safety-filter",
        help="The safety filter of the trace, named again because it is executed: FILE.py:NAME or a program.",
        metavar="FILTER",
    ),
]
OfPredictor = Annotated[
    str | None,
    Option(
        "--predictor",
        help="The predictor of the trace, named again because it is executed: FILE.py:NAME or a program.",
        metavar="PREDICTOR",
    ),
]
OfReference = Annotated[
    str | None,
    Option(
        "--against",
        help="A reference avoider or controller, or 'the unfiltered system', on the same draws; only "
        "differences from it count.",
        metavar="REFERENCE",
    ),
]
OfWorld = Annotated[
    str | None,
    Option(
        "--world",
        help="PyBullet, MuJoCo, kinematic or exec:SIMULATOR; without it the first that is installed.",
        metavar="WORLD",
    ),
]
OfReplays = Annotated[
    str | None,
    Option("--world", help="The world of the replays; without it the kinematic world.", metavar="WORLD"),
]
OfWorldAgain = Annotated[
    str | None,
    Option(
        "--world", help="The simulator of the trace, named again because it is executed.", metavar="WORLD"
    ),
]
OfSpace = Annotated[Path, Argument(help="A scenario space: a file, or shipped:NAME.", metavar="SPACE")]
Confirm = Annotated[
    bool,
    Option(
        "--confirm",
        help="Repeat each violation, and the run with the changed cause, in a reference too.",
    ),
]
AttributionOut = Annotated[
    Path | None, Option(help="Folder for attribution.json and attribution.svg; none for neither.")
]
Executes = Annotated[bool, Option("--execute-programs", help="Allow the input's programs to be executed.")]
Verbose = Annotated[bool, Option("--verbose", "-v", help="Print every line, not only what matters.")]
Workers = Annotated[int | None, Option("--jobs", help="Processes; without it, one for each core.", min=1)]
Seed = Annotated[int, Option(help="Root of every random number.", min=0)]
_AsJson = Annotated[bool, Option("--json", help="One JSON document in place of lines for people.")]
_Parameters = ParamSpec("_Parameters")


def _on_command_line(value: object) -> str:
    return shlex.join(map(str, value)) if isinstance(value, list) else shlex.quote(str(value))


def command(
    group: Typer,
    name: str | None = None,
    *,
    interrupted: str = "",
    failed: int | None = None,
    then: str = "",
    json: bool = True,
) -> Callable[[Callable[_Parameters, int]], Callable[_Parameters, int]]:
    """Return a decorator that makes a command of ``group`` from a function that returns an exit code.

    A mistake of the user is explained, and the exit code is 2.  Any other error of the harness is explained
    with the exit code ``failed``, or raised if ``failed`` is None.  After Ctrl-C the command prints
    ``interrupted``, or raises KeyboardInterrupt if ``interrupted`` is empty.  The command has an option
    --json only if ``json``.  After exit code 0 or 1, the command prints ``then``, the command that a user
    most likely wants next.  Names of options in ``then`` are replaced by their values.
    """

    def registered(work: Callable[_Parameters, int]) -> Callable[_Parameters, int]:
        @wraps(work)
        def answer(*args: _Parameters.args, **options: _Parameters.kwargs) -> int:
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

        def ended(*args: _Parameters.args, **options: _Parameters.kwargs) -> None:
            as_json = options.pop("as_json", False)
            answered = partial(answer, *args, **options)
            code = answered_as_json(answered) if as_json else answered()
            if then and not as_json and code in (AS_EXPECTED, DIFFERS):
                next_step(then.format_map({name: _on_command_line(value) for name, value in options.items()}))
            raise Exit(code)

        update_wrapper(ended, work)
        if json:
            parameters = signature(work, eval_str=True)
            option = Parameter("as_json", Parameter.KEYWORD_ONLY, default=False, annotation=_AsJson)
            ended.__signature__ = parameters.replace(  # type: ignore[attr-defined]
                parameters=[*parameters.parameters.values(), option], return_annotation=None
            )
        short = cleandoc(work.__doc__ or "").partition("\n\n")[0]  # lists of commands do not shorten it
        group.command(name, short_help=short)(ended)
        return answer

    return registered
