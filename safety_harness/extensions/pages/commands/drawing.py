"""Define the commands ``show`` and ``view``, which draw scenarios and stored runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.options import Seed, command

commands = Typer()


@command(commands, interrupted="interrupted: this picture and those after it were not drawn")
def show(
    files: Annotated[
        list[Path], Argument(help="Scenario files, spaces, suites or folders.", metavar="FILE...")
    ],
    out: Annotated[
        Path, Option(help="Folder for the pictures (SVG), or an SVG file for a single picture.")
    ] = Path("reports/show"),
    draws: Annotated[int, Option(help="Number of draws in the picture of a space.", min=1)] = 200,
    seed: Seed = 0,
) -> int:
    """Draw the scenarios of a file without running them.

    The picture shows the hands, the TCP start, the regions and the camera's view.

    Exit code 0: all pictures are drawn.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    from safety_harness.extensions.pages.commands.show_files import show as show_files

    return show_files(files, out=out, draws=draws, seed=seed)


@command(commands, interrupted="interrupted: nothing was written")
def view(
    trace: Annotated[
        Path,
        Argument(help="A trace of an earlier run, or the description of a log (LOG.yaml).", metavar="TRACE"),
    ],
    second: Annotated[
        Path | None,
        Argument(help="A second trace or log, shown beside the first at the same times.", metavar="TRACE"),
    ] = None,
    out: Annotated[
        Path | None, Option(help="The HTML page to write. Default: reports/view/NAME.html.")
    ] = None,
    opens: Annotated[bool, Option("--open/--no-open", help="Open the page in the browser.")] = True,
) -> int:
    """Show a stored run in 3-D, or two runs side by side.

    The command writes one HTML page and opens it. Useful pairs are an avoider and its reference, a run with a
    shield and a run without it, or a simulated and a recorded run. The command judges the claims again, but
    it does not simulate and executes no program. For a log, the page leaves out the parts that were not
    measured, and lists them.

    Exit code 0: the page is written.
    Exit code 2: the trace or log cannot be read.
    Exit code 130: interrupted.
    """
    from safety_harness.extensions.pages.commands.view_run import view as view_runs

    return view_runs([trace] if second is None else [trace, second], out, opens=opens)
