"""The command ``safety-harness``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from safety_harness.exceptions import SafetyHarnessError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Verify a hand-avoidance controller of a UR10: run scenarios, judge them, report.",
)

Files = Annotated[list[Path], typer.Argument(help="Scenario files, or folders of *.yaml.", metavar="FILE...")]
Out = Annotated[Path, typer.Option(help="Folder for report.html and traces/.")]
TraceFile = Annotated[Path, typer.Argument(help="A .trace file of an earlier run.", metavar="TRACE")]
TraceFiles = Annotated[list[Path], typer.Argument(help="Trace files of earlier runs.", metavar="TRACE...")]


@app.command()
def run(files: Files, out: Out = Path("reports/run")) -> None:
    """Run scenario files on the PyBullet UR10, judge their claims and write a report.

    One line a claim goes to standard output: verdict, margin, time of the worst moment.
    Exit code 0: every verdict as its file expects; 1: any differs; 2: bad input, nothing was run;
    130: interrupted, what was finished is kept.
    """
    from safety_harness.cli.run import run as run_files

    raise typer.Exit(run_files(files, out))


@app.command()
def replay(trace: TraceFile) -> None:
    """Repeat a recorded run bit by bit: "identical", or the first step that differs.

    Exit code 0: identical; 1: it differs; 2: not a trace that can be read.
    """
    from safety_harness.cli.replay import replay as replay_trace

    raise typer.Exit(replay_trace(trace))


@app.command()
def judge(traces: TraceFiles) -> None:
    """Judge stored traces again by their claims, without simulating.

    Exit codes as for run.
    """
    from safety_harness.cli.replay import judge_again

    raise typer.Exit(judge_again(traces))


def main() -> None:
    """Entry point; neither a Ctrl-C outside a run nor one of our own errors ends in a traceback."""
    try:
        app()
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except SafetyHarnessError as error:
        from safety_harness.cli.console import BAD_INPUT, explain

        explain(error)
        raise SystemExit(BAD_INPUT) from None


if __name__ == "__main__":
    main()
