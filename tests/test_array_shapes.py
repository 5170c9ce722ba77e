"""Every array of floats that a function takes says its shape: in its type, beside it or in the docstring.

ends: NDArray[np.float64],  # (n, 2, 3) [m], both ends of each
'''Distance [m] from ``point`` (3,) to the segment from ``start`` to ``end``, (3,) both.'''
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import pytest

import safety_harness

PACKAGE = Path(safety_harness.__file__).parent
ROOMS = sorted({file.parent.relative_to(PACKAGE).as_posix() for file in PACKAGE.rglob("*/*.py")})
KERNEL = {"compiled", "inlined", "njit_no_nrt"}
SHAPE = r"\((?:\.\.\.|[^().]*?,[^().]*?|\.\.\.,[^().]*?|[^().]*?, \.\.\.)\)"
ALIAS = re.compile(r"^(\w+) = NDArray\[np\.float64\]$", re.MULTILINE)
OURS = re.compile(r"^from safety_harness\.([\w.]+) import (.+)$", re.MULTILINE)


@lru_cache
def shapeless(module: str) -> frozenset[str]:
    """The names of a module for arrays of floats whose shape is not said beside the name."""
    return frozenset(ALIAS.findall((PACKAGE / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")))


def floats(source: str) -> set[str]:
    """The types of a file that are arrays of floats without a shape."""
    theirs = [shapeless(module) & set(names.split(", ")) for module, names in OURS.findall(source)]
    return {"NDArray[np.float64]", *ALIAS.findall(source)}.union(*theirs)


def functions(node: ast.AST, about: str = "") -> Iterator[tuple[ast.FunctionDef, str]]:
    """Public functions and methods, and compiled ones of any name, each with what may describe it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
            yield from functions(child, ast.get_docstring(child) or "")
        elif isinstance(child, ast.FunctionDef):
            kernel = any(isinstance(by, ast.Name) and by.id in KERNEL for by in child.decorator_list)
            if kernel or child.name == "__init__" or not child.name.startswith("_"):
                own = ast.get_docstring(child) or ""
                yield child, about if child.name == "__init__" else own


def without_shape(source: str) -> list[str]:
    """The parameters of a file that are arrays of floats of a shape that is not said."""
    lines, found, shapeless_here = source.splitlines(), [], floats(source)
    for function, docstring in functions(ast.parse(source)):
        given = function.args
        for one in given.posonlyargs + given.args + given.kwonlyargs:
            if one.annotation is None or not shapeless_here & set(ast.unparse(one.annotation).split(" | ")):
                continue
            beside = lines[(one.end_lineno or 0) - 1][one.end_col_offset or 0 :]
            told = rf"(?:``{one.arg}``|\n *{one.arg}:)[^;.]*?{SHAPE}"  # in a sentence, or in "Args:"
            if not (re.search("#.*" + SHAPE, beside) or re.search(told, docstring)):
                found.append(f"{function.name}({one.arg})")
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_every_array_of_floats_says_its_shape(room: str) -> None:
    files = sorted((PACKAGE / room).glob("*.py"))
    missing = {file.name: found for file in files if (found := without_shape(file.read_text("utf-8")))}
    assert missing == {}


HEAD = "def move({}) -> None:\n    '''{}'''\n"
FLOAT = "NDArray[np.float64]"


@pytest.mark.parametrize(
    ("parameters", "docstring", "missing"),
    [
        (f"way: {FLOAT}", "Along ``way`` (3,) [m].", []),
        (f"way: {FLOAT}", "Along ``way``, of shape\n    (..., 3).", []),
        (f"way: {FLOAT}", "Along ``way`` (n, ...).", []),
        (f"way: {FLOAT}", "Along it.\n\n    Args:\n        way: The way (3,).\n    ", []),
        (
            f"way: {FLOAT}",
            "Along it.\n\n    Args:\n        way: It.\n        by: One (3,).\n    ",
            ["move(way)"],
        ),
        (f"way: {FLOAT}, by: {FLOAT}", "Along ``way`` and ``by`` (n, 3).", []),
        (f"\n    way: {FLOAT},  # (n, 3)\n", "Along it.", []),
        (f"\n    way: {FLOAT} | None = None,  # (n, 3)\n", "Along it.", []),
        ("way: NDArray[np.int64], far: float", "Along ``way``.", []),
        (f"way: {FLOAT}", "Along ``way`` (metres).", ["move(way)"]),
        (f"way: {FLOAT}", "Along ``way``.  Others are (3,).", ["move(way)"]),
        (f"way: {FLOAT}", "Along (3,).", ["move(way)"]),
        (f"\n    way: {FLOAT},  # metres\n", "Along it.", ["move(way)"]),
        (f"*, way: {FLOAT} | None = None", "Along it.", ["move(way)"]),
    ],
)
def test_the_test_tells_a_shape_from_none(parameters: str, docstring: str, missing: list[str]) -> None:
    assert without_shape(HEAD.format(parameters, docstring)) == missing


def test_a_type_that_says_its_shape_needs_no_more() -> None:
    source = (PACKAGE / "base" / "geometry" / "arrays.py").read_text(encoding="utf-8")
    types = re.findall(r"^(\w+) = NDArray.*?(#.*)?$", source, re.MULTILINE)
    assert len(types) > 1
    assert all(re.search("#.*" + SHAPE, beside) for _, beside in types)
    assert not shapeless("base.geometry.arrays")


def test_the_test_looks_at_kernels_of_any_name_and_at_constructors() -> None:
    function = HEAD.format(f"way: {FLOAT}", "Along it.")
    assert without_shape(function.replace("move", "_move")) == []
    assert without_shape("@compiled\n" + function.replace("move", "_move")) == ["_move(way)"]
    method = "    " + function.replace("move(", "__init__(self, ").replace("\n    ", "\n        ")
    assert without_shape("class Mover:\n    '''Along a way.'''\n\n" + method) == ["__init__(way)"]
    assert without_shape("class Mover:\n    '''Along ``way`` (3,).'''\n\n" + method) == []
    assert without_shape("class _Mover:\n    '''Along a way.'''\n\n" + method) == []
