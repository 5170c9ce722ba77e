"""Define all commands of ``safety-harness``.

A command imports the modules that it needs only when it is called.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, MutableMapping
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from safety_harness.base.compiling import CompilationLine, watchers
from safety_harness.base.distribution import DISTRIBUTION, foreign_files, installed_version
from safety_harness.base.exceptions import MissingPackageError, SafetyHarnessError
from safety_harness.base.extension_points import ExtensionPoint, RegisteredPart, load, parts, warn
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
from safety_harness.cli.help_text import lay_out_help
from safety_harness.report.compile_ahead import SecondProcess

NAME = "safety-harness"
# The commands of the core by the modules of ``cli``; a module is imported when one of its commands is used.
CORE = {
    "new": ("new",),
    "scenario_commands": (
        *("run", "validate", "fmt", "explain", "claims", "schema", "replay", "judge", "sample"),
    ),
    "fuzz": ("fuzz",),
    "shipped": ("list", "copy", "docs"),
    "machine": ("warm", "doctor"),
}
# Commands of this distribution by task, in the order of the help; commands of other packages follow.
TASKS = {
    "The three jobs": ("run", "fuzz", "certify"),
    "Write and run": ("new", "validate", "show", "sample", "explain", "claims", "fmt", "list", "copy"),
    "Search and explain": ("attribute", "view", "judge", "replay", "history"),
    "Evidence": ("campaign", "verify"),
    "Your avoider, controller, robot, cell": (
        *("evaluate", "prove", "metrics", "time", "dataset", "train", "export"),
        *("robot", "scenario", "log", "monitor", "hands", "compare-worlds"),
    ),
    "Tools": ("doctor", "warm", "docs", "schema", "selftest", "reproduce"),
}
TASK_OF = {name: task for task, names in TASKS.items() for name in names}
REINSTALL = f"pip install --force-reinstall {DISTRIBUTION}"
# Commands of other packages, with the text for a user who has not installed the package.
ELSEWHERE = {
    "reproduce": (
        "Measure the paper's tables and figures again (needs the package safety_harness_paper).",
        "in a copy of the repository: pip install ./paper",
    )
}


class _Commands(MutableMapping[str, Any]):
    """A mapping from names to commands, for the commands of the core and of other packages.

    The mapping loads a package's command when it is first used.  If a command fails to load, the mapping
    lists its name but raises KeyError for it.
    """

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}
        own = {name: f"{__package__}.{module}:commands" for module, names in CORE.items() for name in names}
        point = ExtensionPoint.COMMANDS
        self._parts = {name: RegisteredPart(point, name, value) for name, value in own.items()}
        self._hidden: list[RegisteredPart] = []  # parts whose names are already in use
        for part in parts(ExtensionPoint.COMMANDS):
            if part.name in self._parts:
                self._hidden.append(part)
            else:
                self._parts[part.name] = part

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            loaded = self._load(self._parts[name]) if name in self._parts else _absent(name, *ELSEWHERE[name])
            if loaded is None:
                raise KeyError(name)
            self._made[name] = loaded
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        there = dict.fromkeys((*self._made, *self._parts, *ELSEWHERE))
        return iter(
            [*(name for name in TASK_OF if name in there), *(name for name in there if name not in TASK_OF)]
        )

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __setitem__(self, name: str, command: Any) -> None:
        self._made[name] = command

    def __delitem__(self, name: str) -> None:
        del self._made[name]

    def warn_of_hidden(self) -> None:
        """Warn of commands that are omitted because their names are already in use."""
        for part in self._hidden:
            warn(part, f"the command {part.name} is there already")

    def _load(self, part: RegisteredPart) -> Any:
        """Return the command of ``part``.

        If the part does not provide a command of that name, warn and return None.
        """
        if (group := load(part, typer.Typer)) is None:
            return None if part.package else _absent(part.name, "Not installed.", REINSTALL)
        if (loaded := commands_of(group).get(part.name)) is None:
            warn(part, f"it has no command {part.name}")
            return None
        loaded.rich_help_panel = (
            TASK_OF.get(part.name) or part.package.removeprefix("safety_harness_").capitalize()
        )
        return lay_out_help(loaded)


class _Group(TyperGroup):
    """The Typer group that contains all commands."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = self._lazy = _Commands()

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, and warn of commands whose names are already in use."""
        self._lazy.warn_of_hidden()
        return [*self.commands]


def commands_of(group: typer.Typer) -> MutableMapping[str, Any]:
    """Return the commands and groups that the Typer application ``group`` adds, by their names."""
    holder = typer.Typer(rich_markup_mode=app.rich_markup_mode)
    holder.add_typer(group)
    return typer.main.get_group(holder).commands


def _absent(name: str, description: str, hint: str) -> Any:
    """Return a placeholder for a command whose package is not installed.

    The placeholder explains how to install the package.
    """
    commands = typer.Typer()
    settings = {"ignore_unknown_options": True, "allow_extra_args": True}

    @commands.command(name, help=description, short_help=description, context_settings=settings)
    def absent() -> None:
        raise MissingPackageError.of_option(name, "the package with this command", "none", hint)

    placeholder = commands_of(commands)[name]
    placeholder.rich_help_panel = "Not installed"
    return placeholder


OLDER_OPTIONS = {"workers": "jobs", "baseline": "compare-with-uniform"}  # older names, which still work
app = typer.Typer(
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "token_normalize_func": lambda name: OLDER_OPTIONS.get(name, name),
    },
    help="Verify a hand-avoidance controller of a robot arm: run and judge scenarios, search for "
    "violations, and write the evidence as a report.",
)


def _say_version(requested: bool) -> None:
    if requested:
        result(f"{NAME} {installed_version()}")
        raise typer.Exit


@app.callback()
def of_all(
    version: Annotated[
        bool,
        typer.Option(
            "--version", "-V", callback=_say_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Do nothing, because ``--version`` is the only option that all commands share."""


def main() -> None:
    """Run the command line, and print an error of the harness without a traceback."""
    second = SecondProcess()
    watchers.extend((second, CompilationLine(sys.stderr, second.finished_part)))
    if sys.argv[1:2] == ["run"]:  # which reads and admits its scenarios before it compiles anything
        second.start_if_cold()
    if foreign := foreign_files():
        say(f"warning: {foreign}")
    columns = columns_of(sys.stdout) or 80
    plain = columns < NARROW or no_escapes()
    if plain:  # Rich cuts words if a table is too wide, and uses bold even without colour
        app.rich_markup_mode = None
    try:
        app(prog_name=NAME, terminal_width=columns if plain else None, color=False if plain else None)
    except SafetyHarnessError as error:
        explain(error)
        raise SystemExit(BAD_INPUT) from None
    except OSError as error:  # a full disk for the help, or a read-only home folder for the completion
        explain(error)
        give_up(sys.stdout)
        raise SystemExit(BAD_INPUT) from None
