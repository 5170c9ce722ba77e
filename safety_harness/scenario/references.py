"""Texts in a scenario file that mean another file: an avoider's program or model, a recording."""

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
    """The file of an avoider's or controller's reference, and the name within it; two empty texts if none.

    Of an ONNX file the name is the layout of its inputs and outputs, if it has one (``onnx_names``).
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
    """Return a reference whose file, if it has one, is named as ``name`` says."""
    file, within = file_and_name(reference)
    return type(reference)(name(file) + (f":{within}" if within else "")) if file else reference


def names_onnx(reference: str) -> bool:
    """Does it mean an ONNX file?"""
    return file_and_name(reference)[0].endswith(ONNX_SUFFIX)


def names_a_program(reference: str) -> bool:
    """Return whether it means a program: one that speaks our protocol, or one that a package opens."""
    return reference.startswith((EXEC, TCP, UNIX)) or bool(added_way(reference))


def added_way(reference: str) -> str:
    """Return the name of the package's part that opens a controller such as ``ros2:/arm``; empty for none."""
    name = reference.partition(":")[0]
    return name if name != reference and name in _added_ways() else ""


@lru_cache
def _added_ways() -> frozenset[str]:
    """Return the names of ways that packages add: words, so that no file and no way of ours is taken."""
    found = set()
    for part in parts(ExtensionPoint.CONTROLLERS):
        if not re.fullmatch("[a-z][a-z0-9-]+", part.name) or part.name in OWN_WAYS:
            warn(part, "its name is taken, or is no word of small letters, digits and dashes")
        else:
            found.add(part.name)
    return frozenset(found)


def seen_from(folder: Path, path: str, standing_in: Path) -> str:
    """``path``, relative to the folder ``standing_in``, as ``folder`` has to say it."""
    if Path(path).is_absolute() or path.startswith("~") or is_shipped(path):
        return path
    return Path(named_from(folder, standing_in / path)).as_posix()


def named_from(folder: Path, path: Path) -> str:
    """How a file in ``folder`` names another: what an installation ships by its name, others relatively."""
    if is_shipped(path):
        return shipped_name(located(path))
    return (is_installed() and shipped_name(resolved(path))) or os.path.relpath(path, folder)


def portable(path: str, folder: Path) -> str:
    """A file as a result names it that is read on other machines: ``told``, but relative to ``folder``."""
    file = Path(os.path.expanduser(path))
    if not file.is_absolute():
        way = os.path.commonpath([resolved(folder / file.parent), resolved(folder)])
        return file.name if Path(way) in Path.home().parents else path
    below = resolved(folder) in resolved(file).parents
    return Path(os.path.relpath(resolved(file), resolved(folder))).as_posix() if below else file.name


def avoider_seen_from(folder: Path, reference: str, standing_in: Path) -> str:
    """An avoider's reference likewise; a name without a file stays as it is."""
    return with_file(reference, lambda file: seen_from(folder, file, standing_in))
