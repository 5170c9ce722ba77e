"""Data flows one way: every import in the package points leftwards, and the public names stay."""

from __future__ import annotations

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

import safety_harness
from safety_harness.base import compiled

PACKAGE = Path(safety_harness.__file__).parent
# A package of the core imports those before it, and no wing.
CORE = (
    *("base", "scenario", "trace", "seams", "cell", "space", "claims", "admission", "search", "report"),
    *("testing", "cli"),
)
CELL = (
    "robot",
    "perception",
    "servoing",
    "avoidance",
    "controller",
    "simulation",
)  # likewise, within the cell
# A wing imports the core, and the wings that stand here.
WINGS = {
    "attribution": (),
    "pages": ("attribution",),
    "arms": ("pages",),
    "worlds": (),
    "gym": (),
    "lab": ("pages",),
    "field": (),
    "assurance": ("attribution", "pages", "lab", "field"),
    "selftest": ("attribution", "pages", "assurance"),
}
ROOT = ("__init__", "__main__")
# The one exception: names at the root of the package that lead to a wing, which is imported on first use.
NAMES_OF_WINGS = {
    "extensions.attribution.attribute_job",
    "extensions.pages.run_page",
    "extensions.assurance.certify_job",
    "extensions.field.read_log_job",
    "extensions.lab.evaluate_job",
    "extensions.lab.prove_job",
}
FILES = sorted(PACKAGE.rglob("*.py"))


def module_of(file: Path) -> str:
    """Return the dotted name of a file below the package, such as ``cell.robot.inverse``."""
    return ".".join(file.relative_to(PACKAGE).with_suffix("").parts)


def room_of(module: str) -> str:
    """Return the package of the core, or ``extensions.WING``, that a module is in."""
    first, *rest = module.split(".")
    return f"extensions.{rest[0]}" if first == "extensions" and rest[0] != "__init__" else first


@cache
def statements_of(file: Path) -> tuple[ast.Import | ast.ImportFrom | ast.ClassDef, ...]:
    """Return the imports and classes of a file, wherever in it they stand."""
    wanted = (ast.Import, ast.ImportFrom, ast.ClassDef)
    return tuple(node for node in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(node, wanted))


@cache
def imports_of(file: Path) -> frozenset[str]:
    """Return the modules of this package that a file imports anywhere in it."""
    found = set()
    for node in statements_of(file):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("safety_harness."):
            found.add(node.module.removeprefix("safety_harness."))
        elif isinstance(node, ast.ImportFrom) and node.module == "safety_harness":
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names = (alias.name for alias in node.names)
            found |= {
                name.removeprefix("safety_harness.") for name in names if name.startswith("safety_harness.")
            }
    return frozenset(found)


def is_allowed(importer: str, imported: str) -> bool:
    """Return whether a file of the room ``importer`` may import from the room ``imported``."""
    wing = importer.removeprefix("extensions.")
    if imported.startswith("extensions."):
        return imported == importer or (wing in WINGS and imported.removeprefix("extensions.") in WINGS[wing])
    if wing in WINGS and importer != wing:
        return imported in CORE
    return importer in ROOT or CORE.index(imported) <= CORE.index(importer)


def test_the_core_imports_no_wing_and_every_arrow_points_to_an_earlier_package() -> None:
    rooms = {room_of(module_of(file)) for file in FILES}
    assert rooms == {*CORE, *ROOT, "extensions", *(f"extensions.{wing}" for wing in WINGS)}
    wrong = [
        f"{module_of(file)} imports {imported}"
        for file in FILES
        for imported in imports_of(file)
        if not is_allowed(room_of(module_of(file)), room_of(imported))
        and not (file == PACKAGE / "__init__.py" and imported in NAMES_OF_WINGS)
    ]
    assert wrong == []


def test_the_names_of_wings_at_the_root_are_the_one_exception_and_import_nothing_by_themselves() -> None:
    assert {*safety_harness._WINGS} == NAMES_OF_WINGS
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    (checked,) = (node for node in tree.body if isinstance(node, ast.If))
    assert ast.unparse(checked.test) == "TYPE_CHECKING"
    outside = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert not any((node.module or "").startswith("safety_harness") for node in outside)


def test_within_the_cell_every_arrow_points_to_an_earlier_part() -> None:
    wrong = [
        f"{module_of(file)} imports {imported}"
        for file in (PACKAGE / "cell").rglob("*/*.py")
        for imported in imports_of(file)
        if imported.startswith("cell.")
        and CELL.index(imported.split(".")[1]) > CELL.index(module_of(file).split(".")[1])
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        ("cli", "extensions.assurance"),
        ("report", "cli"),
        ("scenario", "trace"),
        ("extensions.field", "extensions.assurance"),
        ("extensions.lab", "extensions.gym"),
    ],
)
def test_the_rule_sees_an_arrow_that_points_backward(importer: str, imported: str) -> None:
    assert not is_allowed(importer, imported)


def test_the_rule_sees_imports_of_every_form(tmp_path: Path) -> None:
    culprit = tmp_path / "culprit.py"
    culprit.write_text(
        "from safety_harness.report.words import x\n"
        "import safety_harness.cli.main\n"
        "def f():\n    from safety_harness import certify\n"
    )
    assert imports_of(culprit) == {"report.words", "cli.main", "certify"}


def test_no_file_is_in_a_circle_of_imports() -> None:
    """Files that import none of those left are taken away, again and again, until none is left."""
    graph = {module_of(file): imports_of(file) for file in FILES if module_of(file) not in ROOT}
    while free := [module for module, imported in graph.items() if not imported & {*graph}]:
        for module in free:
            del graph[module]
    assert sorted(graph) == []


@pytest.mark.parametrize("wing", WINGS)
def test_the_hash_of_the_source_covers_every_file_of_a_wing(
    wing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {*compiled._package_sources()}
    ours = {*(PACKAGE / "extensions" / wing).rglob("*.py")}
    assert ours
    assert ours <= files
    before, changed = compiled.source_hash(), min(ours)
    read = compiled._content
    monkeypatch.setattr(compiled, "_content", lambda file: read(file) + b"#" * (file == changed))
    assert compiled._hash(files) != before


def test_a_run_needs_no_torch() -> None:
    for file in FILES:
        if module_of(file).startswith(("extensions.lab.learning", "extensions.gym.exporting")):
            continue  # which no run imports, but only a command that learns, and a user's training
        assert "torch" not in {
            name.split(".")[0]
            for node in statements_of(file)
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in (
                [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            )
        }, file


def test_every_import_of_the_package_has_the_form_that_the_machine_code_cache_reads() -> None:
    """``from safety_harness.room.file import name``: the cache follows these to know what to recompile."""
    for file in FILES:
        if file.name == "__init__.py" and file.parent == PACKAGE:
            continue
        for node in statements_of(file):
            if isinstance(node, ast.Import):
                assert not any(alias.name.startswith("safety_harness") for alias in node.names), file
            elif isinstance(node, ast.ImportFrom) and (
                node.level or (node.module or "").startswith("safety_harness")
            ):
                module = PACKAGE.parent / (node.module or "").replace(".", "/")
                assert node.level == 0, file
                assert module.with_suffix(".py").is_file(), f"{file}: {node.module} is no file"


def test_no_two_files_of_tests_have_one_name() -> None:
    """Folders of tests are no packages: of two modules with one name the second is the first."""
    folders = Path(__file__).parent, Path(__file__).parents[1] / "paper" / "tests"
    files = [file for folder in folders for file in folder.rglob("*.py")]
    names = Counter(file.name for file in files if file.name != "conftest.py")
    assert [name for name, count in names.items() if count > 1] == []


def test_no_two_public_classes_have_one_name() -> None:
    classes = Counter(
        node.name
        for file in FILES
        for node in statements_of(file)
        if isinstance(node, ast.ClassDef) and node.col_offset == 0 and not node.name.startswith("_")
    )
    assert len(classes) > 300
    assert [name for name, count in classes.items() if count > 1] == []


def test_only_commands_and_the_entry_point_import_the_command_line() -> None:
    """Of a wing its commands do, and what the core calls of it: its inputs."""
    importers = {
        module_of(file) for file in FILES if any(imported.startswith("cli.") for imported in imports_of(file))
    }
    core = {module for module in importers if not module.startswith("extensions.")}
    assert {room_of(module) for module in core} == {"cli", "__main__"}
    assert all({"commands", "inputs"} & {*module.split(".")} for module in importers - core)


def test_nothing_in_the_package_imports_the_paper() -> None:
    for file in FILES:
        assert not re.search(r"^\s*(from|import) safety_harness_paper", file.read_text(), re.M), file
