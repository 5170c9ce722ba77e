"""Check a user's Python file by its text, and execute the file to get an object from it.

``refuse_undefined`` parses the text without executing any code. ``made_by`` executes the file with all its
imports.
"""

from __future__ import annotations

import ast
import hashlib
import sys
import warnings
from collections.abc import Iterator, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from safety_harness.base.exceptions import InadmissibleError, Place, described
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.files import display_path, read_bytes
from safety_harness.seams.isolation.opened import DECLARED, declare, watch

MOST_SOURCE = 10_000_000  # bytes; a choice
MOST_PARSED = 1_000_000  # a tree is a hundred times its text
# Nodes that may define names that the text does not show.
_HIDDEN = frozenset({"exec", "eval", "globals", "locals", "setattr", "vars", "__getattr__"})
_INNER = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)


def source_of(path: Path, place: Place) -> bytes:
    """Return the bytes of a Python file.

    Raise InadmissibleError at ``place`` if the file is missing or too large.
    """
    source = read_bytes(path, most=MOST_SOURCE, place=place, error=InadmissibleError)
    if len(source) > MOST_SOURCE:
        expected = f"a Python file of at most {MOST_SOURCE:,} bytes"
        raise InadmissibleError(place=place, expected=expected, got="a larger one")
    return source


def refuse_undefined(
    path: Path, name: str, methods: Sequence[str], place: Place, hint: str, keywords: Sequence[str] = ()
) -> None:
    """Raise InadmissibleError at ``place`` unless the file is Python and seems to define ``name``.

    If ``name`` is a class without bases, it must define the ``methods``. Faults that only show during
    execution, or in a very long text, are detected in the run itself. ``hint`` is a text on further reading
    for the user.
    """
    source = source_of(path, place)
    if len(source) > MOST_PARSED:
        return
    try:
        with warnings.catch_warnings(action="ignore"):  # of the user's own code
            tree = ast.parse(source, str(path))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        got = described(error, str(path))
        raise InadmissibleError(place=place, expected=f"{path.name} to be a Python file", got=got) from None
    definitions = [node for node in _top(tree) if name in _defined(node)]
    if not definitions and not any(_hides(node) for node in ast.walk(tree)):
        expected, got = f"something called {name!r} in {path.name}", "no such name"
        raise InadmissibleError(place=place, expected=expected, got=got, hint=hint)
    for method in methods:
        if definitions and _lacks(definitions[-1], method):
            expected, got = f"{name} to have a method {method}", "a class without one"
            raise InadmissibleError(place=place, expected=expected, got=got, hint=hint)
        if definitions and keywords and (got := _misfit(definitions[-1], method, {*keywords})):
            expected = f"{name} in {path.name} to have {method}(*, {', '.join(keywords)})"
            raise InadmissibleError(place=place, expected=expected, got=f"{method}({got})", hint=hint)


def _misfit(node: ast.AST, method: str, keywords: set[str]) -> str:
    """Return the parameters of a method if the method cannot be called with ``keywords``.

    Otherwise return an empty text.

    The method may have a further parameter "seen".
    """
    if not isinstance(node, ast.ClassDef):
        return ""
    own = [item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == method]
    if not own or own[-1].decorator_list or own[-1].args.kwarg:
        return ""
    given = own[-1].args
    plain = [*given.posonlyargs, *given.args]
    needed = {arg.arg for arg in plain[1 : len(plain) - len(given.defaults)]}
    needed |= {arg.arg for arg, none in zip(given.kwonlyargs, given.kw_defaults, strict=True) if none is None}
    fits = keywords <= {arg.arg for arg in (*given.args, *given.kwonlyargs)} and needed <= keywords | {"seen"}
    return "" if fits else ast.unparse(given)


def _lacks(node: ast.AST, method: str) -> bool:
    """Return whether ``node`` is a class that certainly lacks the method.

    A class with bases or decorators, for example, may get the method from them.
    """
    if not isinstance(node, ast.ClassDef) or node.bases or node.keywords or node.decorator_list:
        return False
    return not any(method in _defined(inner) or _hides(inner) for inner in _top(node))


def _top(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes below a module or class in order, except nodes inside its functions and classes."""
    waiting = [*ast.iter_child_nodes(node)][::-1]  # no recursion: the text decides how deep it is
    while waiting:
        child = waiting.pop()
        yield child
        if not isinstance(child, _INNER):
            waiting += [*ast.iter_child_nodes(child)][::-1]


def _defined(node: ast.AST) -> set[str]:
    """Return the names that a node defines, such as the name of a function, a variable or an import."""
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


def made_by(path: Path, source: bytes, name: str, kind: str, place: Place, hint: str) -> object:
    """Execute the file and return the object called ``name``.

    Args:
        path: The user's file.
        source: The bytes of the file.
        name: The name of an attribute, which is an object, or a class that is instantiated without arguments.
        kind: The kind of object with its article, for error messages, such as "an avoider".
        place: The place that errors state.
        hint: A text on further reading for the user.

    Raises:
        InadmissibleError: The file fails, or has no such attribute.

    """
    watch(path, source)
    module = _module(path, source, place)
    try:
        for file in getattr(module, DECLARED, ()):
            declare(path.parent / file)
    except (OSError, TypeError) as error:
        raise raised(path, place, f"{DECLARED} to be a list of files that can be read", error) from error
    made_object = getattr(module, name, None)
    if made_object is None:
        expected, got = f"something called {name!r} in {path.name}", "no such name"
        raise InadmissibleError(place=place, expected=expected, got=got, hint=hint)
    if isinstance(made_object, type):
        try:
            made_object = made_object()
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            expected = f"{name}() to make {kind} without any arguments"
            raise raised(path, place, expected, error) from error
    made: object = made_object
    return made


def refuse_lacking(value: object, name: str, methods: Sequence[str], place: Place, hint: str) -> None:
    """Raise InadmissibleError at ``place`` unless the object has all ``methods`` and a valid name."""
    for method in methods:
        if not callable(getattr(value, method, None)):
            expected, got = f"{name} to have a method {method}", f"no such method in a {type(value).__name__}"
            if callable(value):
                hint = f"a class with a name and with {' and '.join(methods)} may call the function; {hint}"
            raise InadmissibleError(place=place, expected=expected, got=got, hint=hint)
    called = getattr(value, "name", None)
    if not isinstance(called, str) or not is_sentence(called):
        expected = f"{name} to have a name, {SENTENCE}"
        raise InadmissibleError(place=place, expected=expected, got=repr(called), hint=hint)


def _module(path: Path, source: bytes, place: Place) -> ModuleType:
    """Execute the file and return it as a module with a unique name.

    The function compiles the text itself, because Python's cache does not notice an edit within the same
    second.
    """
    digest = hashlib.sha256(str(path).encode()).hexdigest()[:12]
    spec = spec_from_file_location(f"user_{digest}_{path.stem}", path)
    assert spec is not None  # of a file that ends in .py
    module = module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # a user's code may raise anything
        sys.modules.pop(module.__name__, None)
        expected = f"{path.name} to be a Python file that can be imported"
        raise raised(path, place, expected, error) from error
    return module


def raised(path: Path, place: Place, expected: str, error: BaseException) -> InadmissibleError:
    """Return the error for a user's file that raised ``error`` where ``expected`` was expected."""
    neighbour = isinstance(error, ModuleNotFoundError) and (path.parent / f"{error.name}.py").is_file()
    hint = f"PYTHONPATH={display_path(path.parent)} lets it import modules of its folder" if neighbour else ""
    return InadmissibleError(place=place, expected=expected, got=described(error, str(path)), hint=hint)
