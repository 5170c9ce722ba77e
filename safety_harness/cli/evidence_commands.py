"""Commands that make evidence, and that put the harness itself on trial."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from safety_harness.cli.options import OfAvoider, end

commands = typer.Typer()


@commands.command()
def certify(
    plan: Annotated[Path, typer.Argument(help="A plan: claims, strata, runs, confidence.", metavar="PLAN")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the report; without it reports/NAME of the plan.")
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Also print the page to evidence.pdf, with an installed Chromium.")
    ] = False,
    workers: Annotated[int | None, typer.Option(help="Processes; without it one a core.", min=1)] = None,
    selftest: Annotated[
        Path | None, typer.Option(help="selftest.json of safety-harness selftest, to be part of the report.")
    ] = None,
    oracles: Annotated[
        Path | None, typer.Option(help="Table of independent oracles (docs/oracles.json), likewise.")
    ] = None,
) -> None:
    """Run a declared plan and write its evidence: one page, JSON, JUnit XML, and all to re-run it.

    Bounds are made of the plan's own independent runs; what its search finds is shown and estimates nothing.
    A line a claim goes to standard output. Ctrl-C keeps every finished run; the same command goes on.
    It is no certificate, and says so.
    Exit code 0: every claim is shown; 1: any is not; 2: bad input, or a target that the plan's runs cannot
    meet; 130: interrupted.
    """
    from safety_harness.cli.certify import certify as certify_plan

    end(certify_plan(plan, out=out, pdf=pdf, workers=workers, selftest=selftest, oracles=oracles))


@commands.command()
def verify(
    report: Annotated[Path, typer.Argument(help="The folder of a report of certify.", metavar="FOLDER")],
    runs: Annotated[int, typer.Option(help="Runs to make again, drawn at random.", min=0)] = 20,
    seed: Annotated[
        int | None, typer.Option(help="Which runs: without it others each time, and it says which.", min=0)
    ] = None,
    execute_avoider: Annotated[
        bool,
        typer.Option("--execute-avoider", help="Allow the Python files in the report to be executed."),
    ] = False,
) -> None:
    """Check a report: files, plan, ledger, traces; compute numbers and page anew, make some runs again.

    What has changed since (source, versions, networks, platform) is named, and so is what was not checked.
    Exit code 0: the report stands; 1: it does not, and why; 2: no report, or a program in it that may not be
    executed; 130: interrupted.
    """
    from safety_harness.cli.certify import verify as verify_folder

    end(verify_folder(report, runs=runs, seed=seed, execute_avoider=execute_avoider))


@commands.command()
def selftest(
    profile: Annotated[
        str, typer.Option(help="quick: some minutes; nightly: every scenario, and many draws.")
    ] = "quick",
    avoider: OfAvoider = None,
    scenarios: Annotated[
        Path, typer.Option(help="Folder of scenario files, and of spaces/ in it, to try faults on.")
    ] = Path("scenarios"),
    fault: Annotated[str | None, typer.Option(help="Only faults with these words in their name.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for selftest.html and selftest.json.")] = Path(
        "reports/selftest"
    ),
    jobs: Annotated[int, typer.Option(help="Processes at once, each on one core.")] = 2,
) -> None:
    """Put the harness itself on trial: seed faults into a sound system, and tell what caught each.

    A fault is caught by a claim that is violated with it and holds without it on the same scenario. The
    table says which, after how many episodes, and the slightest magnitude that was caught. With --avoider
    the faults are seeded into yours. Harmless changes are tried as well, and must raise no alarm.
    What was tried is kept, however it ends.
    Exit code 0; 1: a fault survives that is no stated limit, a harmless change raises a false alarm, or no
    fault applies; 2: bad input; 130: interrupted.
    """
    from safety_harness.cli.selftest import selftest as try_harness

    end(try_harness(scenarios=scenarios, profile=profile, avoider=avoider, fault=fault, out=out, jobs=jobs))
