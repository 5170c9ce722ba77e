"""``safety-harness attribute``: the output of an attribution in a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safety_harness.base.input_errors import InputErrors
from safety_harness.cli.console import BAD_INPUT, document, result, say
from safety_harness.cli.progress import TERMINAL
from safety_harness.report.attribution_job import DATA, PICTURE, AttributionResult, attribute


def attribute_runs(paths: Sequence[Path], avoider: str | None, out: Path | None, confirm: bool) -> int:
    """Attribute the violations of runs, print and write the result; return the exit code.

    Args:
        paths: scenario files, traces or folders.
        avoider: the program of the traces; None if they need no program.
        out: the folder to write; None writes no files.
        confirm: whether PyBullet repeats each attribution.

    """
    try:
        return conclude(attribute(paths, avoider=avoider, confirm=confirm, output=TERMINAL), out)
    except InputErrors as error:
        say(f"{len(error.errors)} of the inputs cannot be used; nothing was run.")
        return BAD_INPUT


def conclude(attributed: AttributionResult, out: Path | None) -> int:
    """Print the groups of an attribution and write the files; return the exit code."""
    result(*attributed.tally.lines())
    document(**attributed.data())
    if out is not None:
        attributed.write(out)
        say(f"picture: {out / PICTURE} (for programs: {DATA})")
    if attributed.interrupted:
        say("interrupted: what was attributed until then is above")
    return attributed.exit_code
