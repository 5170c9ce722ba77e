"""Data flows one way: every import in the package points leftwards, and the public names stay."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import safety_harness

PACKAGE = Path(safety_harness.__file__).parent
ORDER = [
    {"exceptions"},
    {
        "compiled",
        "compiling",
        "distribution",
        "extras",
        "geometry",
        "interrupts",
        "proportions",
        "seeds",
        "settings",
        "shipped",
        "whole_file",
    },
    {"scenario"},
    {"trace"},
    {"contract"},
    {"isolation"},
    {"robot"},
    {"perception"},
    {"servoing"},
    {"avoidance"},
    {"space"},
    {"controller"},
    {"learning"},
    {"simulation"},
    {"properties"},
    {"formulas"},
    {"logs"},
    {"admission"},
    {"monitoring"},
    {"gym"},
    {"search"},
    {"statistics"},
    {"scoring"},
    {"proof"},
    {"attribution"},
    {"recorded"},
    {"campaign"},
    {"report"},
    {"certification"},
    {"selftest"},
    {"testing"},
    {"pytest_plugin"},
    {"cli"},
]
RANK = {room: rank for rank, rooms in enumerate(ORDER) for room in rooms}
FILES = sorted(PACKAGE.rglob("*.py"))
CONTRACT = ("controller.contract", "controller.rows")  # what controllers and avoiders are shown: a part apart


def room_of(file: Path) -> str:
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return "contract" if ".".join(parts) in CONTRACT else parts[0]


def rooms_imported_by(file: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(file.read_text())):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "safety_harness":
                names = [f"safety_harness.{alias.name}" for alias in node.names]
        ours = [name.removeprefix("safety_harness.") for name in names if name.startswith("safety_harness.")]
        rooms |= {"contract" if name in CONTRACT else name.split(".")[0] for name in ours}
    return rooms


def test_imports_point_leftwards() -> None:
    backward = [
        f"{file.relative_to(PACKAGE)} imports {imported}"
        for file in FILES
        if (room := room_of(file)) not in ("__init__", "__main__")
        for imported in rooms_imported_by(file)
        if RANK[imported] > RANK[room]
    ]
    assert backward == []


def test_the_import_test_sees_a_backward_arrow(tmp_path: Path) -> None:
    culprit = tmp_path / "culprit.py"
    culprit.write_text("from safety_harness.report import html\nimport safety_harness.cli.main\n")
    assert rooms_imported_by(culprit) == {"report", "cli"}


def test_a_run_needs_no_torch() -> None:
    for file in FILES:
        if room_of(file) == "learning":
            continue  # which nothing but the command line imports, and that only when asked to learn
        assert "torch" not in {
            name.split(".")[0]
            for node in ast.walk(ast.parse(file.read_text()))
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
        for node in ast.walk(ast.parse(file.read_text())):
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
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert len(classes) > 300
    assert [name for name, count in classes.items() if count > 1] == []


def test_only_the_command_line_imports_learning() -> None:
    importers = {room_of(file) for file in FILES if "learning" in rooms_imported_by(file)}
    assert importers <= {"learning", "cli"}


def test_only_the_entry_point_imports_the_command_line() -> None:
    importers = {room_of(file) for file in FILES if "cli" in rooms_imported_by(file)}
    assert importers == {"cli", "__main__"}


def test_nothing_in_the_package_imports_the_paper() -> None:
    for file in FILES:
        assert not re.search(r"^\s*(from|import) safety_harness_paper", file.read_text(), re.M), file
