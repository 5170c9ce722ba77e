"""The command that searches."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from safety_harness.cli.options import OfAvoider, Seed, end

commands = typer.Typer()


@commands.command()
def fuzz(
    space: Annotated[Path, typer.Argument(help="A scenario space.", metavar="SPACE")],
    avoider: OfAvoider = None,
    budget: Annotated[int, typer.Option(help="Runs to search with; shrinking has its own.")] = 1000,
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(help="Folder for fuzz.html, counterexamples, findings.json.")] = Path(
        "reports/fuzz"
    ),
    searcher: Annotated[
        str,
        typer.Option(
            help="default, uniform, quasi-random, cma-es, hypothesis, or diverse, which fills holes."
        ),
    ] = "default",
    claim: Annotated[
        list[str] | None,
        typer.Option(help="Search for violations of this, in place of the space's claims; may be repeated."),
    ] = None,
    baseline: Annotated[
        bool, typer.Option("--baseline", help="Sample the space uniformly as well, with the same budget.")
    ] = False,
) -> None:
    """Search a space for violations, and write each distinct one as a scenario file that run takes.

    Counterexamples are shrunk, confirmed in PyBullet and explained, with a page, fuzz.html, about them and
    a map of what was covered, coverage.svg; Ctrl-C keeps what was found so far.
    Exit code 0: nothing found, which is no evidence of safety; 1: violations, or an avoider that gave no
    answer; 2: bad input, or a place that cannot be written; 130: interrupted.
    """
    from safety_harness.cli.fuzz import fuzz as fuzz_space

    end(
        fuzz_space(
            space,
            out=out,
            avoider=avoider,
            budget=budget,
            seed=seed,
            searcher=searcher,
            claims=claim or (),
            baseline=baseline,
        )
    )
