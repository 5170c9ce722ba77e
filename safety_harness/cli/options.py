"""Define the options and arguments that several commands share, and a decorator for commands."""

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
    Argument(
        help="Scenario files, suites, folders of *.yaml files, or shipped:NAME (a name that the "
        "command list prints).",
        metavar="FILE...",
    ),
]
KeepGoing = Annotated[
    bool, Option("--keep-going", help="Report and count unusable inputs, and continue with the other inputs.")
]
Out = Annotated[Path, Option(help="Folder for report.html and the traces (traces/).")]
OfAvoider = Annotated[
    str | None,
    Option(
        help="The avoider that replaces the avoider of the files: mc-dropout, mc-dropout-full, "
        "deterministic, ensemble, optimum, student, student-ensemble, 'opposite pose', 'nearest "
        "candidate', FILE.py:NAME, FILE.safetensors, FILE.onnx, or FILE.onnx:LAYOUT.",
        metavar="AVOIDER",
    ),
]
OfController = Annotated[
    str | None,
    Option(
        help="The controller that replaces the visual servo and its avoider: 'stop when near', "
        "'learned policy', FILE.py:NAME, FILE.onnx, or a program (exec:COMMAND, tcp:HOST:PORT, "
        "unix:PATH).",
        metavar="CONTROLLER",
    ),
]
OfFilter = Annotated[
    str | None,
    Option(
        "--safety-filter",
        help="The safety filter of the trace: FILE.py:NAME or a program. Required if the run used a "
        "filter of yours, because the command executes the filter.",
        metavar="FILTER",
    ),
]
OfPredictor = Annotated[
    str | None,
    Option(
        "--predictor",
        help="The predictor of the trace: FILE.py:NAME or a program. Required if the run used a "
        "predictor of yours, because the command executes the predictor.",
        metavar="PREDICTOR",
    ),
]
OfReference = Annotated[
    str | None,
    Option(
        "--against",
        help="The reference to compare with on the same draws: an avoider, a controller, or 'the "
        "unfiltered system'. The result then depends only on the differences between the two "
        "systems.",
        metavar="REFERENCE",
    ),
]
OfWorld = Annotated[
    str | None,
    Option(
        "--world",
        help="The world of the runs: PyBullet, MuJoCo, kinematic or exec:SIMULATOR. Default: the "
        "first of PyBullet and MuJoCo that is installed, otherwise kinematic.",
        metavar="WORLD",
    ),
]
OfReplays = Annotated[
    str | None,
    Option("--world", help="The world of the replays. Default: the kinematic world.", metavar="WORLD"),
]
OfWorldAgain = Annotated[
    str | None,
    Option(
        "--world",
        help="The simulator of the trace. Required if the run used your simulator, because the command"
        " executes the simulator.",
        metavar="WORLD",
    ),
]
OfSpace = Annotated[Path, Argument(help="A scenario space: a file, or shipped:NAME.", metavar="SPACE")]
Confirm = Annotated[
    bool,
    Option(
        "--confirm",
        help="Also repeat each violation in a reference world, once unchanged and once with the cause "
        "changed.",
    ),
]
AttributionOut = Annotated[
    Path | None,
    Option(help="Folder for attribution.json and attribution.svg. Without it, no file is written."),
]
Executes = Annotated[
    bool, Option("--execute-programs", help="Allow the command to execute the programs of the input.")
]
Verbose = Annotated[
    bool, Option("--verbose", "-v", help="Print every line, not only the most important lines.")
]
Workers = Annotated[
    int | None, Option("--jobs", help="Number of processes. Default: one for each core.", min=1)
]
Seed = Annotated[int, Option(help="Seed of all random numbers.", min=0)]
_AsJson = Annotated[bool, Option("--json", help="Print one JSON document instead of lines for people.")]
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
    """Return a decorator that registers a function as a command of ``group``.

    The function must return an exit code. If the user made a mistake, the command explains it and ends with
    exit code 2. The command also explains any other error of the harness, and then ends with the exit code
    ``failed``. If ``failed`` is None, the error is raised instead. After Ctrl-C, the command prints
    ``interrupted``, or raises KeyboardInterrupt if ``interrupted`` is empty. The command has an option --json
    only if ``json`` is true. After exit code 0 or 1, the command prints ``then``, which is the command that a
    user most likely needs next. Names of options in braces within ``then`` are replaced by their values.
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
