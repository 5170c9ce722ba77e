"""Options and arguments that several commands have, and how a command ends."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NoReturn

import typer

Files = Annotated[
    list[Path], typer.Argument(help="Scenario files, suites, or folders of *.yaml.", metavar="FILE...")
]
Out = Annotated[Path, typer.Option(help="Folder for report.html and traces/.")]
OfAvoider = Annotated[
    str | None,
    typer.Option(
        help="In place of what the files name: mc-dropout, mc-dropout-full, deterministic, ensemble, "
        "optimum, 'opposite pose', 'nearest candidate', FILE.py:NAME, FILE.safetensors or FILE.onnx.",
        metavar="AVOIDER",
    ),
]
TraceFile = Annotated[Path, typer.Argument(help="A .trace file of an earlier run.", metavar="TRACE")]
TraceFiles = Annotated[list[Path], typer.Argument(help="Trace files of earlier runs.", metavar="TRACE...")]
Seed = Annotated[int, typer.Option(help="Root of every random number.", min=0)]
ModelFiles = Annotated[
    list[str],
    typer.Argument(help="Model files (*.safetensors), or names of shipped models.", metavar="MODEL..."),
]


def end(code: int) -> NoReturn:
    """End the command with this exit code."""
    raise typer.Exit(code)
