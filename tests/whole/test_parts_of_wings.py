"""What the wings of this repository register, and what is said where one is missing."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import typer
from toy_package import WITHOUT_WINGS, called

from safety_harness.base.extension_points import ExtensionPoint, InputFile, load, parts
from safety_harness.cli.main import CORE, TASK_OF, TASKS, commands_of
from tests.cli.test_own_avoider import VISIT


def test_the_help_groups_all_commands_by_task() -> None:
    text = called(Path.cwd(), "--help").stdout
    panels = [*re.findall(r"╭─ (.+?) ─", text)]
    assert [name for name in panels if name not in ("Options", "Not installed")] == [*TASKS]
    assert {name for names in CORE.values() for name in names} < {*TASK_OF}
    assert {part.name for part in parts(ExtensionPoint.COMMANDS)} < {*TASK_OF}


def test_a_command_of_a_wing_that_is_not_installed_says_how_to_get_it(tmp_path: Path) -> None:
    for command in ("certify", "judge"):
        (tmp_path / "LOG.yaml").write_text("log: a log\nclock: {}\nclaims: {}\n")
        done = called(tmp_path, command, "LOG.yaml", code=WITHOUT_WINGS)
        assert done.returncode == 2
        assert "pip install --force-reinstall hand-safety-harness" in done.stderr


def test_every_part_of_ours_can_be_loaded_and_is_of_its_type() -> None:
    kinds = {ExtensionPoint.COMMANDS: typer.Typer, ExtensionPoint.INPUTS: InputFile}
    for group in ExtensionPoint:
        ours = [part for part in parts(group) if not part.package]
        assert [part for part in ours if load(part, kinds.get(group, object)) is None] == []
    assert {part.name for part in parts(ExtensionPoint.INPUTS) if not part.package} == {"plan", "log"}


def test_every_command_of_a_module_of_the_core_is_in_its_row() -> None:
    for module, names in CORE.items():
        assert tuple(commands_of(import_module(f"safety_harness.cli.{module}").commands)) == names


def test_every_command_of_a_wing_has_an_entry_point_of_its_name() -> None:
    ours = [part for part in parts(ExtensionPoint.COMMANDS) if not part.package]
    groups = [group for part in ours if (group := load(part, typer.Typer)) is not None]
    assert {part.name for part in ours} == {name for group in groups for name in commands_of(group)}


def test_a_part_is_named_with_its_group_and_its_distribution() -> None:
    assert [str(part) for part in parts(ExtensionPoint.INPUTS) if not part.package] == [
        "safety_harness.inputs log",
        "safety_harness.inputs plan",
    ]


LOADED = """
import sys
from safety_harness.__main__ import main
sys.argv = ["safety-harness", "run", "visit.yaml", "--world", "kinematic", "--out", "out"]
try:
    main()
except SystemExit:
    print(*(name.removeprefix("safety_harness.") for name in sys.modules if "safety_harness." in name))
"""


def test_a_run_loads_nothing_that_serves_other_commands_and_other_systems(tmp_path: Path) -> None:
    (tmp_path / "visit.yaml").write_text(VISIT)
    modules = {*called(tmp_path, code=LOADED).stdout.split()}
    assert {"report.run_job", "extensions.pages.run_page"} <= modules
    rare = ("seams.isolation", "space.space", "cell.controller.named", "search", "cli.fuzz", "extensions.lab")
    assert {name for name in modules if name.startswith((*rare, "extensions.worlds"))} == set()
