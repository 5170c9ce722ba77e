"""What CI runs for a change: a wing and those that import it; of the core everything; nothing is left out."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from tests import test_architecture

ROOT = Path(__file__).parents[2]
PARTS = runpy.run_path(str(ROOT / ".ci" / "parts.py"))
ALL = [*PARTS["ALL"]]


@pytest.mark.parametrize(
    ("path", "targets"),
    [
        (
            "safety_harness/extensions/field/logs/read.py",
            ["check", "test-assurance", "test-field", "test-selftest", "test-whole", "rest", "installed"],
        ),
        ("tests/gym/test_environments.py", ["check", "test-gym"]),
        ("tests/cli/test_fuzz.py", ["check", "test-core"]),
        ("docs/explanation/search.md", ["check", "rest"]),
        ("README.md", ["check", "rest"]),
        ("tests/assurance/campaign/plans.py", ALL),
        ("safety_harness/base/seeds.py", ALL),
        ("scenarios/fast-reach.yaml", ALL),
        ("requirements.lock", ALL),
        ("a/new/folder", ALL),
    ],
)
def test_a_change_runs_what_it_may_break(path: str, targets: list[str]) -> None:
    assert PARTS["of_paths"]([path]) == targets


def test_two_changes_run_what_either_runs_and_none_runs_nothing() -> None:
    assert PARTS["of_paths"](["docs/explanation/search.md", "tests/gym/test_x.py"]) == [
        "check",
        "test-gym",
        "rest",
    ]
    assert PARTS["of_paths"]([]) == []


def test_a_wing_brings_every_wing_that_may_import_it() -> None:
    for wing, imported in test_architecture.WINGS.items():
        assert all(wing in PARTS["those_that_use"](one) for one in imported)


def test_every_part_has_a_target_and_every_folder_of_tests_is_in_one() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for part in ALL:
        assert re.search(rf"^(test-%|[\w -]*\b{part}\b[\w -]*):", makefile, re.MULTILINE), part
    words = {*re.findall(r"[\w/.]+", makefile[makefile.index("LIGHT :=") : makefile.index("light: ")])}
    for path in (ROOT / "tests").glob("**/test_*.py"):
        first, *rest = path.relative_to(ROOT / "tests").parts
        name = first.removeprefix("test_") if not rest else first
        assert {first, name, f"tests/{first}", f"{first}/{rest[0] if rest else ''}"} & words, path
