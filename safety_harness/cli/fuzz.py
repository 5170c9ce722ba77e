"""Define ``safety-harness fuzz``, which searches a space for violations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option, Typer

from safety_harness.cli.console import document, say, say_shared_modules
from safety_harness.cli.options import OfAvoider, OfController, OfReference, OfSpace, Seed, Verbose, command

commands = Typer()


@command(commands, interrupted="interrupted before anything was tried")
def fuzz(
    space: OfSpace,
    avoider: OfAvoider = None,
    controller: OfController = None,
    against: OfReference = None,
    budget: Annotated[
        int, Option(help="Number of runs of the search. Shrinking uses additional runs.")
    ] = 1000,
    seed: Seed = 0,
    out: Annotated[Path, Option(help="Folder for fuzz.html, findings.json and the counterexamples.")] = Path(
        "reports/fuzz"
    ),
    searcher: Annotated[
        str,
        Option(
            help="The search method: default, uniform, quasi-random, cma-es or diverse. The method diverse"
            " favours rarely visited kinds of runs."
        ),
    ] = "default",
    claims: Annotated[
        list[str] | None,
        Option(
            "--claim",
            help="Search for violations of this claim instead of the space's claims. May be repeated.",
        ),
    ] = None,
    world: Annotated[
        str | None,
        Option(
            "--world",
            help="The world of the search, for example exec:SIMULATOR. Default: the kinematic world.",
            metavar="WORLD",
        ),
    ] = None,
    baseline: Annotated[
        bool,
        Option(
            "--compare-with-uniform",
            help="Also sample the space uniformly, with the same budget, and compare the two searches.",
        ),
    ] = False,
    explain: Annotated[
        str,
        Option(
            help="The value causes explains one example of each cause, with at most as much simulated time"
            " as the search. The value all explains every violation."
        ),
    ] = "causes",
    verbose: Verbose = False,
) -> int:
    """Search a space for violations, and write each as a scenario file.

    The command repeats one violation of each claim in every reference world. It also shrinks one example of
    each cause to a simpler scenario, and attributes the example to parts of the system. Shrinking and
    attribution simulate at most as much time as the search, unless you pass --explain all. The command writes
    a page, fuzz.html, and a map of the coverage, coverage.svg. If you press Ctrl-C, the findings so far are
    saved.

    With --against, the command searches for claims that your avoider or controller violates although the
    reference satisfies them on the same draw. It repeats each such difference with new draws. If the result
    is unclear, it lists the difference as a flip near the limit.

    If the space expects a claim to be violated, the search must find a violation of this claim.

    Exit code 0: all results are as the space expects; this is no evidence of safety.
    Exit code 1: a violation is unexpected, an expected violation was not found, or no run tested a claim.
    Exit code 1 too: the avoider did not always answer, or gave two different answers to the same question.
    Exit code 2: bad input, or the command cannot write to the folder.
    Exit code 130: interrupted.
    """
    from safety_harness.admission.avoiders import one_of, with_avoider
    from safety_harness.admission.driving import named_system
    from safety_harness.cell.simulation.worlds import world_named
    from safety_harness.cli.progress import terminal
    from safety_harness.report.search_job import fuzz as fuzz_space
    from safety_harness.report.words import tested_words

    say_shared_modules()
    output = terminal(verbose)
    searched = fuzz_space(
        space,
        avoider=avoider,
        controller=controller,
        against=against,
        budget=budget,
        seed=seed,
        searcher=searcher,
        claims=claims or (),
        world=None if world is None else world_named(world, "--world"),
        baseline=baseline,
        explain=explain,
        out=out,
        output=output,
    ).kept(out, output)
    document(**searched.data())
    read, chosen = searched.session.trials.space, one_of(avoider, controller)
    tested = read.simplest if chosen is None else with_avoider(read.simplest, chosen)
    say(f"tested in {read.name}: {tested_words(tested, named_system(tested))}")
    return searched.exit_code
