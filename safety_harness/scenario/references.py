"""Texts in a scenario file that name another file, such as an avoider's program or model, or a recording."""

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
EXEC, TCP, UNIX = "exec:", "tcp:", "unix:"  # of a controller: a program that is started, or that listens

OWN_WAYS = ("exec", "tcp", "unix", "shipped")


def file_and_name(reference: str) -> tuple[str, str]:
    """Return the file in a reference to an avoider or controller, and the name within that file.

    Both are empty for a reference without a file.  For an ONNX file, the name is the layout of its inputs and
    outputs, if given (``onnx_names``).
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
    """Return a reference with ``name`` applied to its file; a reference without a file is unchanged."""
    file, inner = file_and_name(reference)
    return type(reference)(name(file) + (f":{inner}" if inner else "")) if file else reference


def names_onnx(reference: str) -> bool:
    """Return whether a reference names an ONNX file."""
    return file_and_name(reference)[0].endswith(ONNX_SUFFIX)


def names_a_program(reference: str) -> bool:
    """Return whether a reference names a program that speaks our protocol, or one that a package opens."""
    return reference.startswith((EXEC, TCP, UNIX)) or bool(added_way(reference))


def added_way(reference: str) -> str:
    """Return the name of the package's part that opens a controller such as ``ros2:/arm``; empty if none."""
    name = reference.partition(":")[0]
    return name if name != reference and name in _added_ways() else ""


@lru_cache
def _added_ways() -> frozenset[str]:
    """Return the names of the parts with which packages open controllers.

    A name must be a word that we do not use, so that it hides no file and no controller of ours.
    """
    names = set()
    for part in parts(ExtensionPoint.CONTROLLERS):
        if not re.fullmatch("[a-z][a-z0-9-]+", part.name) or part.name in OWN_WAYS:
            warn(part, "its name is taken, or is no word of small letters, digits and dashes")
        else:
            names.add(part.name)
    return frozenset(names)


def seen_from(folder: Path, path: str, standing_in: Path) -> str:
    """Return ``path``, which is relative to ``standing_in``, as a path relative to ``folder``.

    Absolute paths, home paths and shipped names are unchanged.
    """
    if Path(path).is_absolute() or path.startswith("~") or is_shipped(path):
        return path
    return Path(named_from(folder, standing_in / path)).as_posix()


def named_from(folder: Path, path: Path) -> str:
    """Return how a file in ``folder`` names the file ``path``: by its shipped name, else relatively.

    A file given by its path gets a shipped name only in an installation.
    """
    if is_shipped(path):
        return shipped_name(located(path))
    return (is_installed() and shipped_name(resolved(path))) or os.path.relpath(path, folder)


def portable(path: str, folder: Path) -> str:
    """Return ``path`` as a result names it on any machine: relative to ``folder``, or its name alone."""
    file = Path(os.path.expanduser(path))
    if not file.is_absolute():
        shared = os.path.commonpath([resolved(folder / file.parent), resolved(folder)])
        return file.name if Path(shared) in Path.home().parents else path
    below = resolved(folder) in resolved(file).parents
    return Path(os.path.relpath(resolved(file), resolved(folder))).as_posix() if below else file.name


def avoider_seen_from(folder: Path, reference: str, standing_in: Path) -> str:
    """Return an avoider's reference with its file named as by ``seen_from``.

    A reference without a file is unchanged.
    """
    return with_file(reference, lambda file: seen_from(folder, file, standing_in))
