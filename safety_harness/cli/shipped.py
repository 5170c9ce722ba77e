"""Define ``safety-harness list``, ``copy`` and ``docs``, which give access to the package's files."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import OutputError
from safety_harness.base.shipped.contents import (
    PREFIX,
    ShippedKind,
    contents,
    is_shipped,
    located,
    shipped_files,
)
from safety_harness.cli.console import AS_EXPECTED, document, next_step, result, say
from safety_harness.cli.options import command

commands = Typer()
REFERRING = (
    "arm",
    "avoider",
    "capsules",
    "extends",
    "predictor",
    "recording",
    "robot",
    "safety filter",
    "scenarios",
    "space",
    "urdf",
)


@command(commands, "list", then="safety-harness copy shipped:NAME")
def list_shipped(
    kind: Annotated[
        ShippedKind | None, Argument(help="The kind of files to list. Without it, all kinds are listed.")
    ] = None,
) -> int:
    """List the scenarios, spaces and other files of the package.

    The list also contains plans, examples, recordings and robots, with one name per line. You can use a name
    such as shipped:NAME wherever a command accepts a file. A name such as shipped:scenarios stands for a
    folder.

    Exit code 0: the list is printed.
    """
    files = [file for file in shipped_files() if kind in (None, file.kind)]
    document(
        files=[
            {"kind": file.kind, "name": PREFIX + file.name, "about": file.description, "file": file.path}
            for file in files
        ]
    )
    for number, each in enumerate(ShippedKind if kind is None else (kind,)):
        of_kind = [file for file in files if file.kind is each]
        width = max((len(PREFIX + file.name) for file in of_kind), default=0)
        say(*[""] * (number > 0), f"{each}, together {PREFIX}{each}:")
        result(*(f"{PREFIX + file.name:<{width}}  {file.description}".rstrip() for file in of_kind))
    return AS_EXPECTED


@command(commands)
def copy(
    name: Annotated[str, Argument(help="A name that the command list prints.", metavar="shipped:NAME")],
    folder: Annotated[Path, Argument(help="Folder for the copies.")] = Path(),
    overwrite: Annotated[
        bool, Option("--overwrite", help="Replace existing files that have another content.")
    ] = False,
) -> int:
    """Copy a shipped file and all files to which it refers.

    You can then edit the copies. They have the same places relative to each other as the shipped files. The
    command prints the path of each copy on standard output, beginning with the requested file.

    Exit code 0: the files are copied.
    Exit code 2: an unknown name, or an existing file with another content; the command then copies no file.
    """
    from safety_harness.base.whole_file import writing
    from safety_harness.scenario.kinds import FileKind, kind_of

    source = located(name if is_shipped(name) else PREFIX + name)
    copies = {folder / relative: path.read_bytes() for relative, path in _with_references(source).items()}
    # Check all paths before the first file is written.
    for path, data in copies.items():
        if path.exists() and not overwrite and not (path.is_file() and path.read_bytes() == data):
            got = "another one; nothing was copied"
            raise OutputError.of_file(path, "no file there yet", got, "--overwrite replaces it")
    for path, data in copies.items():
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        result(str(path))
    document(files=list(copies))
    first = next(iter(copies))
    if kind_of(first) in (FileKind.SCENARIO, FileKind.SPACE, FileKind.SUITE, FileKind.PLAN):
        next_step(shlex.join(["safety-harness", "validate", str(first)]))
    return AS_EXPECTED


def _with_references(source: Path) -> dict[Path, Path]:
    """Return ``source``, all files that it refers to, and their licences.

    The keys are relative paths.
    """
    import os

    waiting = sorted(source.rglob("*")) if source.is_dir() else [source]
    references: dict[Path, None] = {}
    while waiting:
        path = waiting.pop(0)
        if path.is_file() and path not in references and "__pycache__" not in path.parts:
            references[path] = None
            waiting += _references(path) if path.suffix == ".yaml" else ()
    licences = {path.with_name("LICENSE"): None for path in references}  # the licences of recordings
    references |= {path: None for path in licences if path.is_file()}
    # The common folder, so that the places of the copies relative to each other stay the same.
    root = Path(os.path.commonpath([source.parent, *(path.parent for path in references)]))
    return {path.relative_to(root): path for path in references}


def _references(path: Path) -> Iterator[Path]:
    """Yield the shipped files to which the texts of the YAML file ``path`` refer."""
    from safety_harness.scenario.nodes import parse_tree, references_in
    from safety_harness.scenario.references import file_and_name

    tree = parse_tree(path.read_text("utf-8"), path)
    for text in references_in(tree, REFERRING):
        named = located(path.parent / (file_and_name(text)[0] or text)).resolve()
        if contents() in named.parents and named.is_file():
            yield named


@command(commands)
def docs(
    section: Annotated[
        list[str] | None,
        Argument(
            help="A page, page#section, or words of a heading, for example: claims. Without it, the first "
            "page."
        ),
    ] = None,
    where: Annotated[
        bool, Option("--where", help="Only print the path of the page, and do not open the page.")
    ] = False,
) -> int:
    """Open the package's documents in a browser.

    The command prints the path of the page on standard output. On a terminal, it then opens the page in a
    browser. If the documents were not built as a site, it shows the section as text in the terminal instead.

    Exit code 0: the page exists.
    Exit code 2: an unknown section.
    """
    from safety_harness.base.shipped.documents import Section, path_of, section_named, text_of

    heading = " ".join(section or [])
    page = section_named(heading) if heading else Section("index", "the first page")
    path, anchor = path_of(page)
    place = f"#{anchor}" if anchor else ""
    document(file=path, section=anchor or None)
    result(f"{path}{place}")
    if where or not sys.stdout.isatty():
        return AS_EXPECTED
    if path.suffix == ".md":
        _show(text_of(page))
    else:
        _open(path.as_uri() + place)
    return AS_EXPECTED


def _show(text: str) -> None:
    """Show a Markdown text on the terminal."""
    from rich.console import Console
    from rich.markdown import Markdown

    Console().print(Markdown(text))


def _open(uri: str) -> None:
    """Open the page ``uri`` in a browser, if there is a browser."""
    import webbrowser

    try:
        opened = webbrowser.open(uri)
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        say("no browser was found: open this file in one")
