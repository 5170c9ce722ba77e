"""Define ``safety-harness new``, which writes a small runnable file and prints the next commands."""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option, Typer

from safety_harness.base.exceptions import InputError, OutputError, near_miss
from safety_harness.base.extension_points import input_files
from safety_harness.base.whole_file import writing
from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.cli.options import command

commands = Typer()
FOLDER = Path(__file__).parent / "templates"
SUFFIXES = (".yaml", ".yml")
AVOIDER, CONTROLLER, FILTER = "{}_avoider.py", "{}_controller.py", "{}_filter.py"
PREDICTOR, SIMULATOR = "{}_predictor.py", "{}_simulator.py"
SUITE, RECORDING = "test_{}.py", "{}_recording.csv"


@dataclass(frozen=True)
class Template:
    """A template, with a description of its content and of the files that are written beside its scenario.

    Each such file is described by a pair: the name of its source file in ``FOLDER``, and a pattern for the
    name of the new file. The pattern contains ``{}``, which is replaced by the stem of the scenario's file
    name.
    """

    about: str
    beside: tuple[tuple[str, str], ...] = ()


TEMPLATES = {
    "reaching": Template("a hand reaches for the object under the tool"),
    "handover": Template("a hand is held out to the tool, stays, and leaves"),
    "two-people": Template("one of two people takes the part, the other's hand is beside it"),
    "space": Template("many scenarios: what varies, and between which limits"),
    "log": Template("a recorded hand, from a CSV file", (("recording.csv", RECORDING),)),
    "policy": Template(
        "an avoider of your own: a Python file, a scenario and a pytest file",
        (("avoider.py.txt", AVOIDER), ("test_policy.py.txt", SUITE)),
    ),
    "controller": Template(
        "a controller of your own: a Python file and a scenario", (("controller.py.txt", CONTROLLER),)
    ),
    "filter": Template(
        "a safety filter of your own: a Python file and a scenario", (("filter.py.txt", FILTER),)
    ),
    "predictor": Template(
        "a hand predictor of your own: a Python file and a scenario", (("predictor.py.txt", PREDICTOR),)
    ),
    "simulator": Template(
        "a simulator of your own: a Python program and a scenario", (("simulator.py.txt", SIMULATOR),)
    ),
}


@command(commands, interrupted="interrupted: nothing was written")
def new(
    template: Annotated[
        str | None,
        Argument(
            help=f"One of {', '.join(TEMPLATES)}, or plan. Without it, the command asks for a template."
        ),
    ] = None,
    file: Annotated[
        Path | None,
        Argument(
            help="The scenario file to write. Default: TEMPLATE.yaml. With the template plan, FILE is the "
            "existing space of the plan."
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        Argument(help="The plan to write, only with the template plan. Default: SPACE-plan.yaml."),
    ] = None,
    listed: Annotated[bool, Option("--list", help="List the templates, and write no file.")] = False,
) -> int:
    """Write a scenario with comments as a starting point.

    The command "new plan SPACE" drafts a plan for the claims of a space. The plan has the smallest number of
    runs that can show that at most 2 % of runs violate a claim. The template log also writes a recording. The
    template policy also writes an avoider in Python and a test of the avoider. The templates controller,
    filter, predictor and simulator also write a Python file. The command never overwrites a file.

    Exit code 0: the files are written.
    Exit code 2: an unknown template, an existing file, or a folder that cannot be written.
    Exit code 130: interrupted; no file was written.
    """
    if listed:
        document(templates=[{"name": name, "about": entry.about} for name, entry in TEMPLATES.items()])
        result(*_listed())
        return AS_EXPECTED
    added = None if template in TEMPLATES else input_files().get(template or "")
    if added is not None and added.draft is not None:
        return added.draft(file, plan)
    if plan is not None:
        raise InputError.of_option("new", "one file, but for a plan", str(plan))
    if template is None:
        template, file = _ask_at_terminal()
    chosen = _template(template)
    scenario = _scenario_file(template, file)
    written = _texts(template, chosen, scenario)
    _write(written)
    document(files=list(written))
    result(*(f"wrote {path}" for path in written))
    say("next:", *(f"  {line}" for line in _next(template, scenario)))
    return AS_EXPECTED


def _listed() -> list[str]:
    return [f"{name:<11} {template.about}" for name, template in TEMPLATES.items()]


def _ask_at_terminal() -> tuple[str, Path]:
    """Ask the user at the terminal for the template and the file.

    If there is no terminal, raise an error that lists the templates.
    """
    if not sys.stdin.isatty():
        raise _unknown("none, and no terminal to ask at")
    say(*_listed())
    try:
        name = typer.prompt("template", default="reaching", err=True)
        _template(name)
        return name, Path(typer.prompt("file", default=f"{name}.yaml", err=True))
    except typer.Abort:
        raise KeyboardInterrupt from None


def _template(name: str) -> Template:
    if name not in TEMPLATES:
        raise _unknown(repr(name), near_miss(name, TEMPLATES))
    return TEMPLATES[name]


def _unknown(got: str, hint: str = "") -> InputError:
    usage = "safety-harness new reaching my-cell.yaml"
    hint = hint or f"for example: {usage}; safety-harness new --list says what each is"
    return InputError.of_option("template", f"a template: {', '.join(TEMPLATES)}", got, hint)


def _scenario_file(template: str, file: Path | None) -> Path:
    """Return the path of the scenario.

    Its name must be printable and end in .yaml.
    """
    if file is None:
        return Path(f"{template}.yaml")
    if file.suffix not in SUFFIXES:
        if file.suffix in (".py", ".csv") or file.is_dir():
            raise OutputError.of_file(file, "a name such as my-cell.yaml", str(file))
        file = file.with_name(f"{file.name}.yaml")
    if not file.name.isprintable():
        raise OutputError.of_file(file, "a name that can be printed", repr(file.name))
    return file


def _texts(name: str, template: Template, scenario: Path) -> dict[Path, str]:
    """Return the text of each new file, with the file's path as the key.

    Files beside the scenario get names that Python can import.
    """
    stem = re.sub(r"\W+", "_", scenario.stem)
    files = {f"{name}.yaml": scenario}
    files |= {source: scenario.with_name(named.format(stem)) for source, named in template.beside}
    replacements = {
        "@FILE@": shlex.quote(scenario.name),
        "@SCENARIO@": repr(scenario.name),
        "@RECORDING@": RECORDING.format(stem),
        "@AVOIDER@": AVOIDER.format(stem),
        "@CONTROLLER@": CONTROLLER.format(stem),
        "@FILTER@": FILTER.format(stem),
        "@PREDICTOR@": PREDICTOR.format(stem),
        "@TEST@": SUITE.format(stem),
        "@SIMULATOR@": SIMULATOR.format(stem),
    }
    pattern = re.compile("|".join(replacements))
    return {
        path: pattern.sub(lambda match: replacements[match[0]], (FOLDER / source).read_text(encoding="utf-8"))
        for source, path in files.items()
    }


def _write(texts: dict[Path, str]) -> None:
    """Write all files, or write no file if any of them already exists."""
    # Check all paths before the first file is written.
    for path in texts:
        if path.exists() or path.is_symlink():
            raise OutputError.of_file(path, "a file that is not there yet", "one that is")
    for path, text in texts.items():
        with writing(path), path.open("x", encoding="utf-8") as stream:
            stream.write(text)


def _next(template: str, scenario: Path) -> list[str]:
    """Return the commands that the user should type next."""
    file, stem = shlex.quote(str(scenario)), re.sub(r"\W+", "_", scenario.stem)
    run = f"safety-harness run {file}"
    lines = [run, f"safety-harness show {file}"]
    if template == "space":
        return [
            f"safety-harness fuzz {file}",
            f"safety-harness show {file}",
            f"safety-harness new plan {file}",
        ]
    if template == "policy":
        suite, avoider = (shlex.quote(str(scenario.with_name(f.format(stem)))) for f in (SUITE, AVOIDER))
        lines += [f"pytest {suite}", f"safety-harness evaluate {avoider}:Away"]
    elif template == "controller":
        lines.append(f"{run} --controller 'stop when near'")
    elif template == "simulator":
        program = shlex.quote(str(scenario.with_name(SIMULATOR.format(stem))))
        lines.append(f"{run} --world {shlex.quote(f'exec:python3 {program}')}")
    else:
        lines.append(f"{run} --avoider 'opposite pose'")
    return [*lines, "safety-harness claims"]
