"""``safety-harness fuzz``: search a space for violations."""

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
    baseline: Annotated[
        bool,
        Option(
            "--compare-with-uniform",
            "--baseline",
            help="Sample the space uniformly too, with the same budget.",
        ),
    ] = False,
    explain: Annotated[
        str,
        Option(help="causes: a violation of each claim, and others for as long as the search took; or all."),
    ] = "causes",
    verbose: Verbose = False,
) -> int:
    """Search a space for violations, and write each distinct one as a scenario file that run takes.

    With --against it searches for what the avoider or controller violates and the reference keeps, on the
    same draws.
    Each such difference is drawn again; what is not clearly worse then is listed as a flip near the limit.
    A violation of each claim is shrunk, confirmed in PyBullet and attributed (whose fault it is, as attribute
    says it), and others for as long as the search took; --explain all does the rest.
    A page, fuzz.html, is about them, with a map of what was covered, coverage.svg; Ctrl-C keeps what was
    found so far.
    A claim that the space expects to be violated has to be found within the budget.
    Exit code 0: as the space expects, which is no evidence of safety; 1: a violation that it does not expect,
    none of what it does, a claim that no run put to the test, or an avoider that gave no answer, or answered
    otherwise when asked again; 2: bad input, or a place that cannot be written; 130: interrupted.
    """
    from safety_harness.admission.avoiders import one_of, with_avoider
    from safety_harness.admission.driving import named_system
    from safety_harness.cli.progress import terminal
    from safety_harness.report.search_job import fuzz as fuzz_space
    from safety_harness.report.words import tested_words

    say_shared_modules()
    output = terminal(verbose)
    found = fuzz_space(
        space,
        avoider=avoider,
        controller=controller,
        against=against,
        budget=budget,
        seed=seed,
        searcher=searcher,
        claims=claims or (),
        baseline=baseline,
        explain=explain,
        out=out,
        output=output,
    ).kept(out, output)
    document(**found.data())
    read, asked = found.session.trials.space, one_of(avoider, controller)
    tested = read.simplest if asked is None else with_avoider(read.simplest, asked)
    say(f"tested in {read.name}: {tested_words(tested, named_system(tested))}")
    return found.exit_code
