"""``safety-harness dataset``: the data that a network is trained or tested on, with its manifest."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, explain, result, say
from safety_harness.exceptions import InputError
from safety_harness.learning.dataset import CompactDataset, generate
from safety_harness.learning.manifest import data_hash, save_dataset
from safety_harness.learning.spaces import space_named
from safety_harness.settings import DEFAULTS


def dataset(
    out: Path,
    *,
    space: str = "seen",
    tcps: int = 10_000,
    candidates: int = 100,
    hands: int = 500,
    seed: int = 0,
) -> int:
    """Generate, save, sum up; returns the exit code.  Nothing is written unless all of it is made."""
    try:
        made = _generate(space, tcps, candidates, hands, seed)
        save_dataset(made, out)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted: no data set was written")
        return INTERRUPTED
    for line in summary(made):
        result(line)
    say(f"data set: {out}")
    return AS_EXPECTED


def _generate(space: str, tcps: int, candidates: int, hands: int, seed: int) -> CompactDataset:
    """The data set, with a bar over the TCPs on a terminal and a line elsewhere."""
    where = space_named(space, DEFAULTS)
    console = Console(stderr=True)
    if not console.is_terminal:
        say(f"{where.name} space: {tcps} TCPs, {candidates} candidates each, {hands} hands")
    columns = (
        TextColumn(where.name),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("TCPs"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=tcps)
        return generate(
            DEFAULTS,
            where,
            seed=seed,
            tcps=tcps,
            candidates=candidates,
            hands=hands,
            on_progress=lambda done: bar.update(task, completed=done),
        )


def summary(made: CompactDataset) -> list[str]:
    """What a user wants to know of a data set."""
    views = made.tcps * made.candidates
    away = made.views_without_object
    return [
        f"space       {made.space.name}",
        f"samples     {len(made):,} = {made.tcps:,} TCPs x {made.hands:,} hands",
        f"candidates  {views:,}; object not wholly in view of {away:,} ({away / views:.2%}), "
        "which are not selected",
        f"blind TCPs  {made.tcps_without_view:,}, with no candidate in view: "
        "selected as if the image had no border",
        f"seed        {made.seed}",
        f"sha256      {data_hash(made)}",
    ]
