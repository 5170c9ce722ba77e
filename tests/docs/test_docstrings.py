"""Docstrings read easily, and those of documented functions name every parameter."""

import ast
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType, ModuleType

import pytest

import safety_harness

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
from prose import found_in, sentences, worst  # noqa: E402
from shapes import with_entry  # noqa: E402

PACKAGE = ROOT / "safety_harness"
WINGS = PACKAGE / "extensions"
ROOMS = sorted(path.parent for home in (PACKAGE, WINGS) for path in home.glob("*/__init__.py"))
DOCUMENTED = 95  # per cent of the parameters of documented functions


def docstrings(room: Path) -> Iterator[str]:
    """Yield every docstring of a package."""
    for path in sorted(room.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                yield ast.get_docstring(node) or ""


@pytest.mark.parametrize("room", [room for room in ROOMS if room != WINGS], ids=lambda room: room.name)
def test_the_docstrings_of_a_package_have_at_most_20_hard_constructions_in_100_sentences(room: Path) -> None:
    found = [(text, found_in(text)) for docstring in docstrings(room) for text in sentences(docstring)]
    share = 100 * sum(len(names) for _, names in found) / max(len(found), 40)
    assert share <= 20, f"{room.name}: {share:.1f} in 100 sentences\n{worst(found)}"


def resolved(name: str) -> object:
    """Return the object that has a dotted name."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise AssertionError(name)


def functions(documented: object) -> Iterator[FunctionType]:
    """Yield the public functions and methods of a module, a class or a function."""
    if isinstance(documented, ModuleType):
        for value in vars(documented).values():
            if getattr(value, "__module__", None) == documented.__name__:
                yield from functions(value)
    elif inspect.isclass(documented):
        for value in vars(documented).values():
            yield from functions(value) if not inspect.isclass(value) else ()
    else:
        inner = getattr(documented, "__func__", getattr(documented, "py_func", documented))
        function = inspect.unwrap(inner) if callable(inner) else inner
        if isinstance(function, FunctionType) and not function.__name__.startswith("_"):
            yield function


def test_documented_functions_name_at_least_95_percent_of_their_parameters() -> None:
    names = {f"safety_harness.{name}" for name in safety_harness.__all__}
    for page in (ROOT / "docs" / "reference" / "python").glob("*.md"):
        names |= set(re.findall(r"^::: (\S+)", page.read_text(encoding="utf-8"), re.MULTILINE))
    documented = {function for name in names for function in functions(resolved(name))}
    silent, count = [], 0
    for function in documented:
        parameters = [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]
        text = function.__doc__ or ""
        absent = [name for name in parameters if not re.search(rf"\b{re.escape(name)}\b", text)]
        count += len(parameters)
        silent += [f"{function.__module__}.{function.__qualname__}: {name}" for name in absent]
    assert count > 250
    assert 100 * (count - len(silent)) / count >= DOCUMENTED, "\n".join(sorted(silent))


def test_the_reference_puts_the_shape_in_front_of_what_a_docstring_says_about_a_parameter() -> None:
    docstring = "Return the pose.\n\nArgs:\n    joints: Of the arm.\n\nRaises:\n    InputError: Never."
    both = with_entry(docstring, "Args", "joints", "(6,) [rad]")
    assert "    joints: (6,) [rad]. Of the arm.\n" in both
    assert with_entry(both, "Args", "joints", "(6,) [rad]") == both
    added = with_entry(both, "Args", "seat", "(4, 4)")
    assert "    joints: (6,) [rad]. Of the arm.\n    seat: (4, 4)\n\nRaises:" in added
    assert with_entry("Return it.", "Args", "seat", "(4, 4)") == "Return it.\n\nArgs:\n    seat: (4, 4)\n"
