"""The commands of ``safety-harness``, together; each imports what it needs when it is called."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated

import typer

from safety_harness.base.compiling import CompilationLine, watchers
from safety_harness.base.distribution import foreign_files, installed_version
from safety_harness.base.exceptions import ModelError, SafetyHarnessError
from safety_harness.cli.console import (
    BAD_INPUT,
    NARROW,
    columns_of,
    explain,
    give_up,
    no_escapes,
    result,
    say,
)
from safety_harness.cli.fuzz import commands as of_search
from safety_harness.cli.machine import commands as of_machine
from safety_harness.cli.new import commands as of_new
from safety_harness.cli.scenario_commands import commands as of_scenarios
from safety_harness.cli.shipped import commands as of_shipped
from safety_harness.extensions.arms.commands import commands as of_robots
from safety_harness.extensions.assurance.commands.campaign import commands as of_campaigns
from safety_harness.extensions.assurance.commands.certify import commands as of_reports
from safety_harness.extensions.assurance.commands.certify import of_certify
from safety_harness.extensions.assurance.commands.history import commands as of_history
from safety_harness.extensions.field.commands.hands import commands as of_hands
from safety_harness.extensions.field.commands.log import commands as of_logs
from safety_harness.extensions.field.commands.monitor import commands as of_monitor
from safety_harness.extensions.field.commands.recorded import commands as of_recorded
from safety_harness.extensions.field.commands.recorded import of_scenarios as of_scenario
from safety_harness.extensions.lab.commands.evaluate import commands as of_scoring
from safety_harness.extensions.lab.commands.learning import commands as of_learning
from safety_harness.extensions.lab.commands.prove import commands as of_proofs
from safety_harness.extensions.selftest.commands import commands as of_selftest

NAME = "safety-harness"
app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Verify a hand-avoidance controller of a robot arm: run scenarios, judge them, search what breaks "
    "it, score an avoider, and certify; make the data of a learned avoider, train and export it.",
)
for group in (
    of_new,
    of_scenarios,
    of_search,
    of_scoring,
    of_proofs,
    of_reports,
    of_history,
    of_selftest,
    of_recorded,
    of_shipped,
    of_machine,
    of_monitor,
):
    app.add_typer(group)
app.add_typer(of_certify, name="certify")
app.add_typer(of_campaigns, name="campaign")
app.add_typer(of_robots, name="robot")
app.add_typer(of_logs, name="log")
app.add_typer(of_scenario, name="scenario")
app.add_typer(of_hands, name="hands")
app.add_typer(of_learning)


def of_the_paper() -> typer.Typer:
    """The command of the package ``safety_harness_paper``, or one that says how to get it."""
    if find_spec("safety_harness_paper"):
        found: typer.Typer = import_module("safety_harness_paper.commands").commands
        return found
    commands = typer.Typer()

    about = "Measure the paper's tables and figures again (needs the package safety_harness_paper)."

    @commands.command(
        help=about,
        short_help=about,
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
    )
    def reproduce() -> None:
        expected = "the package safety_harness_paper, which has the paper's tables and figures"
        hint = "in a copy of the repository: pip install ./paper"
        raise ModelError.of_option("reproduce", expected, "not installed", hint)

    return commands


app.add_typer(of_the_paper())


def _say_version(asked: bool) -> None:
    if asked:
        result(f"{NAME} {installed_version()}")
        raise typer.Exit


@app.callback()
def of_all(
    version: Annotated[
        bool,
        typer.Option(
            "--version", "-V", callback=_say_version, is_eager=True, help="Say which version this is."
        ),
    ] = False,
) -> None:
    """Nothing is common to all commands."""


def main() -> None:
    """Entry point: one of our own errors is explained, and never a traceback."""
    watchers.append(CompilationLine(sys.stderr))
    if foreign := foreign_files():
        say(f"warning: {foreign}")
    columns = columns_of(sys.stdout) or 80
    plain = columns < NARROW or no_escapes()
    if plain:  # Rich cuts words where a table is too wide, and draws in bold without colour
        app.rich_markup_mode = None
    try:
        app(prog_name=NAME, terminal_width=columns if plain else None, color=False if plain else None)
    except SafetyHarnessError as error:
        explain(error)
        raise SystemExit(BAD_INPUT) from None
    except OSError as error:  # help that a full disk does not take, completion for a home that is read-only
        explain(error)
        give_up(sys.stdout)
        raise SystemExit(BAD_INPUT) from None
