"""Texts in a scenario file that name another file: an avoider's program or model, a recording."""

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
    """Return the file of an avoider's or controller's reference, and the name within it.

    Both are empty for a reference without a file.  The name within an ONNX file is the layout of its inputs
    and outputs, if given (``onnx_names``).
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
    """Return a reference with ``name`` applied to its file; a reference without a file stays."""
    file, inner = file_and_name(reference)
    return type(reference)(name(file) + (f":{inner}" if inner else "")) if file else reference


def names_onnx(reference: str) -> bool:
    """Return whether a reference names an ONNX file."""
    return file_and_name(reference)[0].endswith(ONNX_SUFFIX)


def names_a_program(reference: str) -> bool:
    """Return whether a reference names a program that speaks our protocol, or that a package opens."""
    return reference.startswith((EXEC, TCP, UNIX)) or bool(added_way(reference))


def added_way(reference: str) -> str:
    """Return the package's part that opens a controller such as ``ros2:/arm``, by name; empty without one."""
    name = reference.partition(":")[0]
    return name if name != reference and name in _added_ways() else ""


@lru_cache
def _added_ways() -> frozenset[str]:
    """Return the names of ways that packages add.

    A name must be a word that is not ours, so that it never hides a file or a way of ours.
    """
    names = set()
    for part in parts(ExtensionPoint.CONTROLLERS):
        if not re.fullmatch("[a-z][a-z0-9-]+", part.name) or part.name in OWN_WAYS:
            warn(part, "its name is taken, or is no word of small letters, digits and dashes")
        else:
            names.add(part.name)
    return frozenset(names)


def seen_from(folder: Path, path: str, standing_in: Path) -> str:
    """Return ``path``, relative to the folder ``standing_in``, as a path relative to ``folder``.

    Absolute, home and shipped paths stay.
    """
    if Path(path).is_absolute() or path.startswith("~") or is_shipped(path):
        return path
    return Path(named_from(folder, standing_in / path)).as_posix()


def named_from(folder: Path, path: Path) -> str:
    """Return a file as a file in ``folder`` names it: by its shipped name, else by its relative path.

    Only an installation uses shipped names for files that have a path.
    """
    if is_shipped(path):
        return shipped_name(located(path))
    return (is_installed() and shipped_name(resolved(path))) or os.path.relpath(path, folder)


def portable(path: str, folder: Path) -> str:
    """Return a file as a result for other machines names it: as ``told`` does, but relative to ``folder``."""
    file = Path(os.path.expanduser(path))
    if not file.is_absolute():
        shared = os.path.commonpath([resolved(folder / file.parent), resolved(folder)])
        return file.name if Path(shared) in Path.home().parents else path
    below = resolved(folder) in resolved(file).parents
    return Path(os.path.relpath(resolved(file), resolved(folder))).as_posix() if below else file.name


def avoider_seen_from(folder: Path, reference: str, standing_in: Path) -> str:
    """Return an avoider's reference as ``seen_from`` does; a name without a file stays."""
    return with_file(reference, lambda file: seen_from(folder, file, standing_in))
