"""An avoider from a user's own Python file: what its text defines, and what its execution gives.

``refuse_undefined`` parses the text and executes nothing; ``avoider_in`` executes the file, with all that it
imports.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import sys
import warnings
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from safety_harness.avoidance.avoider import Avoider, decision_time_of, described, spread_threshold_of
from safety_harness.exceptions import AvoiderError, InadmissibleError, Place
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.files import read_bytes

MOST_SOURCE = 10_000_000
MOST_PARSED = 1_000_000  # a tree is a hundred times its text
# What may define names that no text shows.
_HIDDEN = frozenset({"exec", "eval", "globals", "locals", "setattr", "vars", "__getattr__"})
_INNER = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)
AVOIDER = Place(field="avoider")  # who asked for it knows the place of the reference to it
QUESTION = ("hand_position_in_base_m", "tcp_position_in_base_m", "seed")  # the keywords of propose


def source_of(path: Path, place: Place) -> bytes:
    """The text of a Python file; InadmissibleError at ``place`` for none, or one that is too large."""
    source = read_bytes(path, most=MOST_SOURCE, place=place, error=InadmissibleError)
    if len(source) > MOST_SOURCE:
        _refuse(place, f"a Python file of at most {MOST_SOURCE:,} bytes", "a larger one", hint="")
    return source


def refuse_undefined(path: Path, name: str, place: Place, methods: tuple[str, ...] = ("propose",)) -> None:
    """InadmissibleError at ``place`` unless the file is Python and seems to define ``name`` with ``methods``.

    Those are of a class without bases; of an avoider ``propose``.  What only the execution shows is for the
    run to meet, and so is a very long text.
    """
    source = source_of(path, place)
    if len(source) > MOST_PARSED:
        return
    try:
        with warnings.catch_warnings(action="ignore"):  # of the user's own code
            tree = ast.parse(source, str(path))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        _refuse(place, f"{path.name} to be a Python file", described(error, str(path)), hint="")
    found = [node for node in _top(tree) if name in _defined(node)]
    if not found and not any(_hides(node) for node in ast.walk(tree)):
        _refuse(place, f"something called {name!r} in {path.name}", "nothing of that name")
    for method in methods:
        if found and _is_without(found[-1], method):
            _refuse(place, f"{name} to have a method {method}", "a class without one")


def _is_without(node: ast.AST, method: str) -> bool:
    """A class that has no such method and can have none from elsewhere."""
    if not isinstance(node, ast.ClassDef) or node.bases or node.keywords or node.decorator_list:
        return False
    return not any(method in _defined(inner) or _hides(inner) for inner in _top(node))


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


def avoider_in(path: Path, source: bytes, name: str) -> Avoider:
    """The avoider called ``name``: an object, or an instance of a class without required arguments.

    InadmissibleError, at a place that its receiver knows better, if the file ``path`` gives none.
    """
    found = getattr(module_of(path, source), name, None)
    if found is None:
        _refuse(AVOIDER, f"something called {name!r} in {path.name}", "nothing of that name")
    if isinstance(found, type):
        try:
            found = found()
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            _raised(path, f"{name}() to make an avoider without any arguments", error)
    return _admissible(path, found, name)


def module_of(path: Path, source: bytes, place: Place = AVOIDER) -> ModuleType:
    """The file, executed afresh; InadmissibleError at ``place`` if it cannot be.

    Its name is its own, so that it hides no module and none hides it.  Compiled from
    its text: Python's own cache takes an edit within a second for none.
    """
    digest = hashlib.sha256(str(path).encode()).hexdigest()[:12]
    spec = spec_from_file_location(f"avoider_{digest}_{path.stem}", path)
    assert spec is not None  # of a file that ends in .py
    module = module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # a user's code may raise anything
        sys.modules.pop(module.__name__, None)
        _raised(path, f"{path.name} to be a Python file that can be imported", error, place)
    return module


def _admissible(path: Path, found: object, name: str) -> Avoider:
    """``found`` if it has what an avoider needs."""
    try:
        propose, called = getattr(found, "propose", None), getattr(found, "name", None)
    except Exception as error:  # a user's property
        _raised(path, f"{name} to have a name and a propose", error)
    if not callable(propose):
        _refuse(AVOIDER, f"{name} to have a method propose", f"none in a {type(found).__name__}")
    asked = f"propose(*, {', '.join(QUESTION)})"
    try:
        signature = inspect.signature(propose)
        signature.bind(**dict.fromkeys(QUESTION))
    except TypeError:
        _refuse(AVOIDER, f"{name} to have {asked}", f"propose{signature}")
    except ValueError:
        pass  # a function that is not written in Python does not tell
    if not isinstance(called, str) or not is_sentence(called):
        _refuse(AVOIDER, f"{name} to have a name, {SENTENCE}", repr(called))
    avoider: Avoider = found  # type: ignore[assignment]  # as has just been looked at
    for read, attribute, kind in (
        (spread_threshold_of, "spread_threshold_m", "a length"),
        (decision_time_of, "decision_time_s", "a time"),
    ):
        try:
            read(avoider)
        except AvoiderError as error:
            _refuse(AVOIDER, f"{name} to have a {attribute} that is {kind}, or none", str(error))
        except Exception as error:  # a user's property
            _raised(path, f"{name} to have a {attribute} that can be read", error)
    return avoider


def _raised(path: Path, expected: str, error: BaseException, place: Place = AVOIDER) -> NoReturn:
    raise InadmissibleError(place=place, expected=expected, got=described(error, str(path))) from error


def _refuse(
    place: Place, expected: str, got: str, hint: str = "safety-harness docs avoiders#a-python-file"
) -> NoReturn:
    raise InadmissibleError(place=place, expected=expected, got=got, hint=hint) from None
