"""Define ``safety-harness attribute``, which finds the causes of violations and prints them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from safety_harness.admission.avoiders import BESIDE, option_of
from safety_harness.base.input_errors import InputErrors
from safety_harness.cell.simulation.worlds import confirming_world, references, world_named
from safety_harness.cli.console import BAD_INPUT, document, next_step, result, say
from safety_harness.cli.progress import TERMINAL
from safety_harness.extensions.attribution.attribute_job import (
    DATA,
    PICTURE,
    TRACE,
    AttributionResult,
    attribute,
)


def attribute_runs(
    paths: Sequence[Path],
    avoider: str | None,
    out: Path | None,
    confirm: bool,
    world: str | None = None,
    **beside: str | None,
) -> int:
    """Attribute the violations of runs to causes, print and write the result, and return the exit code.

    Args:
        paths: scenario files, traces or folders.
        avoider: the program that made the traces, or None if no program is needed.
        out: the folder for the files, or None to write no files.
        confirm: whether each attribution is repeated in a reference world.
        world: the world of the replays.  None means the kinematic world.
        **beside: the safety filter and the predictor with which the traces were recorded, or None.

    """
    try:
        made = attribute(
            paths,
            avoider=avoider,
            **beside,
            confirm=confirm,
            world=None if world is None else world_named(world, "--world"),
            output=TERMINAL,
        )
    except InputErrors as error:
        say(f"{error.inputs} of the inputs cannot be used; nothing was run.")
        return BAD_INPUT
    code = conclude(made, out)
    first = min(paths[0].rglob(f"*{TRACE}"), default=paths[0])
    if made.interrupted:
        return code
    if made.attributions and not confirm and any(references()):
        chosen = [] if avoider is None else [option_of(avoider), str(avoider)]
        for field, reference in beside.items():
            chosen += [] if reference is None else [BESIDE[field], reference]
        chosen += [] if world is None else ["--world", world]
        command = ["safety-harness", "attribute", *map(str, paths), *chosen, "--confirm"]
        next_step(shlex.join(command), f"the same in {confirming_world()}")
    else:
        next_step(shlex.join(["safety-harness", "view" if first.suffix == TRACE else "run", str(first)]))
    return code


def conclude(attributed: AttributionResult, out: Path | None) -> int:
    """Print the causes of an attribution, write its files, and return the exit code."""
    result(*attributed.tally.lines())
    document(**attributed.data())
    if out is not None:
        attributed.write(out)
        drawn = (out / PICTURE).exists()
        say(f"picture: {out / PICTURE} (for programs: {DATA})" if drawn else f"causes: {out / DATA}")
    if attributed.interrupted:
        say("interrupted: the finished attributions are above; the same command repeats all")
    return attributed.exit_code
