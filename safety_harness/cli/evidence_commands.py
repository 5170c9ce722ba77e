"""Commands that make evidence, and that put the harness itself on trial."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from safety_harness.cli.options import OfAvoider, end


class _PlanOrCommand(TyperGroup):
    """``certify PLAN`` beside ``certify declare PLAN``: what is no command's name is a plan or an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As if the command that needs no name had been named."""
        return super().parse_args(ctx, args if args and args[0] in self.commands else ["plan", *args])

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Without its name in what a user reads."""
        name, command, rest = super().resolve_command(ctx, args)
        return (None if name == "plan" else name), command, rest


commands = typer.Typer()
of_certify = typer.Typer(cls=_PlanOrCommand)
commands.add_typer(
    of_certify, name="certify", help="Run a declared plan and write its evidence; declare, seal."
)


@of_certify.command("plan")
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
    declared: Annotated[
        Path | None,
        typer.Option(help="What certify declare wrote; without it PLAN.declared.json, if it is there."),
    ] = None,
) -> None:
    """Run a declared plan and write its evidence: one page, JSON, JUnit XML, and all to re-run it.

    certify declare PLAN, before, and certify seal REPORT, after, print hashes to be lodged elsewhere.
    A plan that is not as it was declared is refused.
    Bounds are made of the plan's own independent runs; what its search finds is shown and estimates nothing.
    A line a claim goes to standard output. Ctrl-C keeps every finished run; the same command goes on.
    It is no certificate, and says so.
    Exit code 0: every claim is shown; 1: any is not; 2: bad input, or a target that the plan's runs cannot
    meet; 130: interrupted.
    """
    from safety_harness.cli.certify import certify as certify_plan

    code = certify_plan(
        plan, out=out, pdf=pdf, workers=workers, selftest=selftest, oracles=oracles, declared=declared
    )
    end(code)


@of_certify.command()
def declare(
    plan: Annotated[Path, typer.Argument(help="A plan that has not been run yet.", metavar="PLAN")],
    out: Annotated[
        Path | None, typer.Option(help="File to write; without it PLAN.declared.json beside the plan.")
    ] = None,
) -> None:
    """Print a hash over plan, seed, avoider, targets and software, to be lodged elsewhere before the runs.

    verify REPORT --declared HASH shows later that the report is of what was declared.
    Exit code 0; 2: bad input, or another declaration is there.
    """
    from safety_harness.cli.certify import declare as declare_plan

    end(declare_plan(plan, out))


@of_certify.command()
def seal(
    report: Annotated[Path, typer.Argument(help="The folder of a report of certify.", metavar="REPORT")],
) -> None:
    """Print a hash over a report's rows, declaration and files, to be lodged elsewhere.

    It is written to REPORT.seal.json. verify REPORT --seal HASH shows later that nothing was altered since.
    Exit code 0; 1: files of the report are not those that were written; 2: bad input, or another seal is
    there.
    """
    from safety_harness.cli.certify import seal_report

    end(seal_report(report))


def _chance(text: str) -> float:
    """A chance as per cent or a number."""
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1.0:
        raise typer.BadParameter(f"{text!r} is no chance: expected 1% or 0.01, say")
    return value


@commands.command()
def verify(
    report: Annotated[Path, typer.Argument(help="The folder of a report of certify.", metavar="FOLDER")],
    runs: Annotated[
        int | None,
        typer.Option(
            help="Runs to make again, drawn at random; without it as --miss asks, 1000 at most.", min=0
        ),
    ] = None,
    miss: Annotated[
        float,
        typer.Option(
            parser=_chance, help="Chance of overlooking altered rows that turn a verdict.", metavar="CHANCE"
        ),
    ] = "1%",  # type: ignore[assignment]
    seal: Annotated[
        str | None,
        typer.Option(help="Hash that certify seal printed, as it was lodged elsewhere, or its file."),
    ] = None,
    declared: Annotated[
        str | None,
        typer.Option(help="Hash that certify declare printed, as it was lodged elsewhere, or its file."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            help="To repeat an earlier draw of runs; without it others each time, and it says which.", min=0
        ),
    ] = None,
    execute_avoider: Annotated[
        bool,
        typer.Option("--execute-avoider", help="Allow the Python files in the report to be executed."),
    ] = False,
) -> None:
    """Check a report: files, plan, ledger, traces; compute numbers and page anew, make some runs again.

    What has changed since (source, versions, networks, platform) is named, and so is what was not checked.
    Without a lodged --seal altered rows are seen only as far as runs made again tell: it says how few would
    turn a verdict, and with what chance they were missed.
    Exit code 0: the report stands; 1: it does not, and why; 2: no report, or a program in it that may not be
    executed; 130: interrupted.
    """
    from safety_harness.cli.certify import verify as verify_folder

    code = verify_folder(
        report,
        runs=runs,
        miss=miss,
        seed=seed,
        execute_avoider=execute_avoider,
        seal=seal,
        declared=declared,
    )
    end(code)


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
