"""Texts in a scenario file that refer to another file, such as an avoider's program or a recording."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from safety_harness.base.extension_points import ExtensionPoint, parts, warn
from safety_harness.base.shipped.contents import is_installed, is_shipped, located, shipped_name
from safety_harness.scenario.files import resolved

MODEL_SUFFIX, ONNX_SUFFIX = ".safetensors", ".onnx"
LEARNED = "learned policy"  # the shipped controller that is an ONNX file
EXEC, TCP, UNIX = "exec:", "tcp:", "unix:"  # of a controller: a program that is started, or that listens

OWN_WAYS = ("exec", "tcp", "unix", "shipped")


def file_and_name(reference: str) -> tuple[str, str]:
    """Divide a reference to an avoider or controller into a file and a name within the file.

    Both parts are empty for a reference without a file. For an ONNX file, the name is the part of the
    reference that states the layout of the inputs and outputs (``onnx_names``). It may be empty.
    """
    if names_a_program(reference):
        return "", ""
    file, _, layout = reference.partition(f"{ONNX_SUFFIX}:")
    if layout:
        return file + ONNX_SUFFIX, layout
    file, _, name = reference.rpartition(":")
    if file.endswith(".py"):
        return file, name
    return (reference, "") if reference.endswith((MODEL_SUFFIX, ONNX_SUFFIX)) else ("", "")


def with_file(reference: str, name: Callable[[str], str]) -> str:
    """Return a reference with ``name`` applied to its file.

    A reference without a file is unchanged.
    """
    file, inner = file_and_name(reference)
    return type(reference)(name(file) + (f":{inner}" if inner else "")) if file else reference


def names_onnx(reference: str) -> bool:
    """Return whether a reference leads to an ONNX file."""
    return file_and_name(reference)[0].endswith(ONNX_SUFFIX)


def names_a_program(reference: str) -> bool:
    """Return whether a reference leads to a program.

    The program uses the harness's own protocol, or an installed package opens it.
    """
    return reference.startswith((EXEC, TCP, UNIX)) or bool(added_way(reference))


def added_way(reference: str) -> str:
    """Return the name of the package part that opens a controller such as ``ros2:/arm``.

    The name is empty if there is no such part.
    """
    name = reference.partition(":")[0]
    return name if name != reference and name in _added_ways() else ""


@lru_cache
def _added_ways() -> frozenset[str]:
    """Return the names of the parts with which packages open controllers.

    Such a name must be a word that the harness does not use. Otherwise the name could hide a file or a
    built-in controller.
    """
    names = set()
    for part in parts(ExtensionPoint.CONTROLLERS):
        if not re.fullmatch("[a-z][a-z0-9-]+", part.name) or part.name in OWN_WAYS:
            warn(part, "its name is taken, or is no word of small letters, digits and dashes")
        else:
            names.add(part.name)
    return frozenset(names)


def seen_from(folder: Path, path: str, standing_in: Path) -> str:
    """Return ``path`` as a path relative to ``folder``.

    The given path is relative to ``standing_in``. Absolute paths, home paths and shipped names are unchanged.
    """
    if Path(path).is_absolute() or path.startswith("~") or is_shipped(path):
        return path
    return Path(named_from(folder, standing_in / path)).as_posix()


def named_from(folder: Path, path: Path) -> str:
    """Return the text with which a file in ``folder`` refers to the file ``path``.

    The text is a shipped name or else a relative path. A shipped file that is given by its path gets its
    shipped name only if the harness is installed.
    """
    if is_shipped(path):
        return shipped_name(located(path))
    return (is_installed() and shipped_name(resolved(path))) or os.path.relpath(path, folder)


def portable(path: str, folder: Path) -> str:
    """Return ``path`` in a form that is valid on any machine.

    The result is relative to ``folder``, or is the file's name alone.
    """
    file = Path(os.path.expanduser(path))
    if not file.is_absolute():
        shared = os.path.commonpath([resolved(folder / file.parent), resolved(folder)])
        return file.name if Path(shared) in Path.home().parents else path
    below = resolved(folder) in resolved(file).parents
    return Path(os.path.relpath(resolved(file), resolved(folder))).as_posix() if below else file.name


def avoider_seen_from(folder: Path, reference: str, standing_in: Path) -> str:
    """Return an avoider's reference with its file rewritten by ``seen_from``.

    A reference without a file is unchanged.
    """
    return with_file(reference, lambda file: seen_from(folder, file, standing_in))
