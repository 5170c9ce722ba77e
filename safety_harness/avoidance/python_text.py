"""What a user's Python file defines, as far as its text tells: it is parsed and never executed."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Iterator
from pathlib import Path

from safety_harness.avoidance.avoider import described
from safety_harness.exceptions import InadmissibleError, Place
from safety_harness.scenario.files import read_bytes

MOST_SOURCE = 10_000_000
MOST_PARSED = 1_000_000  # a tree is a hundred times its text
# What may define names that no text shows.
_HIDDEN = frozenset({"exec", "eval", "globals", "locals", "setattr", "vars", "__getattr__"})
_INNER = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)


def source_of(path: Path, place: Place) -> bytes:
    """The text of a Python file; InadmissibleError at ``place`` for none, or one that is too large."""
    source = read_bytes(path, most=MOST_SOURCE, place=place, error=InadmissibleError)
    if len(source) > MOST_SOURCE:
        expected = f"a Python file of at most {MOST_SOURCE:,} bytes"
        raise InadmissibleError(place=place, expected=expected, got="a larger one")
    return source


def refuse_undefined(path: Path, name: str, place: Place) -> None:
    """InadmissibleError at ``place`` unless the file is Python and seems to define an avoider ``name``.

    A class without bases has to have a ``propose``.  What only the execution shows is for the run to meet,
    and so is a very long text.
    """
    source = source_of(path, place)
    if len(source) > MOST_PARSED:
        return
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the user's own code
            tree = ast.parse(source, str(path))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        expected, got = f"{path.name} to be a Python file", described(error, str(path))
        raise InadmissibleError(place=place, expected=expected, got=got) from None
    found = [node for node in _top(tree) if name in _defined(node)]
    if not found and not any(_hides(node) for node in ast.walk(tree)):
        expected, got = f"something called {name!r} in {path.name}", "nothing of that name"
        raise InadmissibleError(place=place, expected=expected, got=got, hint="see docs/avoiders.md")
    if found and _is_no_avoider(found[-1]):
        expected, got = f"{name} to have a method propose", "a class without one"
        raise InadmissibleError(place=place, expected=expected, got=got, hint="see docs/avoiders.md")


def _is_no_avoider(node: ast.AST) -> bool:
    """A class that has no ``propose`` and can have none from elsewhere."""
    if not isinstance(node, ast.ClassDef) or node.bases or node.keywords or node.decorator_list:
        return False
    return not any("propose" in _defined(inner) or _hides(inner) for inner in _top(node))


def _top(node: ast.AST) -> Iterator[ast.AST]:
    """Everything below a module or a class but what is within a function or another class, in its order."""
    waiting = [*ast.iter_child_nodes(node)][::-1]  # no recursion: the text decides how deep it is
    while waiting:
        child = waiting.pop()
        yield child
        if not isinstance(child, _INNER):
            waiting += [*ast.iter_child_nodes(child)][::-1]


def _defined(node: ast.AST) -> set[str]:
    """The names that a statement, or a target within one, defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return {node.id}
    if isinstance(node, ast.alias):
        return {node.asname or node.name.partition(".")[0]}
    return set()


def _hides(node: ast.AST) -> bool:
    star = isinstance(node, ast.alias) and node.name == "*"
    declared = isinstance(node, ast.Global)
    return star or declared or bool({getattr(node, "id", ""), getattr(node, "name", "")} & _HIDDEN)
