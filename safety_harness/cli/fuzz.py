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
    budget: Annotated[int, Option(help="Runs to search with; shrinking has its own.")] = 1000,
    seed: Seed = 0,
    out: Annotated[Path, Option(help="Folder for fuzz.html, counterexamples, findings.json.")] = Path(
        "reports/fuzz"
    ),
    searcher: Annotated[
        str, Option(help="default, uniform, quasi-random, cma-es, or diverse, which fills holes.")
    ] = "default",
    claims: Annotated[
        list[str] | None,
        Option(
            "--claim", help="Search for violations of this, in place of the space's claims; may be repeated."
        ),
    ] = None,
    world: Annotated[
        str | None,
        Option(
            "--world",
            help="Search in this world, such as exec:SIMULATOR; without it in the kinematic world.",
            metavar="WORLD",
        ),
    ] = None,
    baseline: Annotated[
        bool,
        Option(
            "--compare-with-uniform",
            help="Sample the space uniformly too, with the same budget.",
        ),
    ] = False,
    explain: Annotated[
        str,
        Option(help="causes: an example for each cause, with no more simulation than the search; or all."),
    ] = "causes",
    verbose: Verbose = False,
) -> int:
    """Search a space for violations; write each as a scenario file.

    The command repeats a violation of each claim in every reference. It shrinks and
    attributes one example for each cause, as far as that simulates no more than
    the search did; --explain all explains the rest. It writes a page, fuzz.html,
    with a map of the coverage, coverage.svg.
    Ctrl-C keeps the findings so far.

    With --against it searches for claims that the avoider or controller violates
    and the reference keeps, on the same draws. It draws each difference again,
    and lists a difference without a clear result as a flip near the limit.

    The search must find every claim that the space expects to be violated.

    Exit code 0: as the space expects; this is no evidence of safety.
    Exit code 1: an unexpected violation, an expected violation not found, a claim
    that no run tested, or an avoider without an answer or with another answer to
    the same question.
    Exit code 2: bad input, or a folder that cannot be written.
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
