"""The commands of ``safety-harness``, together; each imports what it needs when it is called."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from safety_harness.base.compiling import CompilationLine, watchers
from safety_harness.base.distribution import DISTRIBUTION, foreign_files, installed_version
from safety_harness.base.exceptions import MissingPackageError, Place, SafetyHarnessError
from safety_harness.base.extension_points import ExtensionPoint, load, parts, warn
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

NAME = "safety-harness"
app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Verify a hand-avoidance controller of a robot arm: run scenarios, judge them, search what breaks "
    "it, score an avoider, and certify; make the data of a learned avoider, train and export it.",
)
CORE = (of_new, of_scenarios, of_search, of_shipped, of_machine)
NOT_HERE, REINSTALL = "Not installed.", f"pip install --force-reinstall {DISTRIBUTION}"
# Commands of other packages: what somebody is told who has not got them.
ELSEWHERE = {
    "reproduce": (
        "Measure the paper's tables and figures again (needs the package safety_harness_paper).",
        "in a copy of the repository: pip install ./paper",
    )
}


def add_commands(app: typer.Typer) -> None:
    """Add the core's commands, and those of packages under names that are not taken."""
    for group in CORE:
        app.add_typer(group)
    for part in parts(ExtensionPoint.COMMANDS):
        if (found := load(part, typer.Typer)) is None:
            found = None if part.package else _absent(part.name, NOT_HERE, REINSTALL)
        if found is not None and (names := _names(found)) & _names(app):
            warn(part, f"the command {', '.join(sorted(names & _names(app)))} is there already")
        elif found is not None:
            app.add_typer(found)
    for name, (about, hint) in ELSEWHERE.items():
        if name not in _names(app):
            app.add_typer(_absent(name, about, hint))


def _names(group: typer.Typer) -> set[str]:
    """Return the names that a group adds: its own, or those of its commands and groups."""
    if isinstance(group.info.name, str) and group is not app:
        return {group.info.name}
    commands = (
        one.name or one.callback.__name__.replace("_", "-")
        for one in group.registered_commands
        if one.callback
    )
    groups = (one.typer_instance for one in group.registered_groups)
    return {*commands}.union(*(_names(one) for one in groups if one is not None))


def _absent(name: str, about: str, hint: str) -> typer.Typer:
    """Return a command in place of one whose package is not installed, which says how to get it."""
    commands = typer.Typer()
    settings = {"ignore_unknown_options": True, "allow_extra_args": True}

    @commands.command(name, help=about, short_help=about, context_settings=settings)
    def absent() -> None:
        raise MissingPackageError(
            place=Place(field=name), expected="the package with this command", got="none", hint=hint
        )

    return commands


add_commands(app)


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
