"""A toy package adds a part of each kind without an edit of the core; one that is broken stops nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from safety_harness.base.extension_points import ExtensionPoint, InputFile, load, parts
from safety_harness.cli.main import CORE, TASKS, commands_of

TOY = '''
from dataclasses import replace
from pathlib import Path

import typer

from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.extension_points import CheckedFile, InputFile
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.claims.formulas.measures import Measure
from safety_harness.claims.formulas.signal import Interpolation, at_ticks
from safety_harness.claims.properties.catalogue import HAND_DISTANCE
from safety_harness.scenario.units import LENGTH

commands = typer.Typer()


@commands.command("toy")
def toy() -> None:
    """Say that the toy is there."""
    typer.echo("the toy is there")


greedy = typer.Typer()


@greedy.command("run")
def run() -> None:
    """Take the place of a command of the core."""
    typer.echo("taken over")


def check(path, look):
    if "broken" in path.read_text():
        raise ScenarioError.of_file(path, "a toy that is whole", "a broken one")
    return CheckedFile(file=path, words="with two wheels", data={"wheels": 2})


def explain(path):
    typer.echo(f"{path.name} has two wheels")
    return 0


TOYS = InputFile(words="a toy", command="safety-harness toy {file}", check=check, explain=explain)


class ToyDistance(type(HAND_DISTANCE.prop)):
    sentence = "toy distance > 30 mm"


ToyDistance.__name__ = "ToyDistance"
CLAIM = replace(HAND_DISTANCE, prop=ToyDistance(**vars(HAND_DISTANCE.prop)), pattern="", make=None)
TOY_WORLD = replace(KINEMATIC, name="toy", label="toy")
FALSE_REFERENCE = replace(KINEMATIC, name="mine", label="PyBullet", confirmed_by=None)


def note(entry):
    yield "toy", "a note of the toy"


def height(trace):
    return at_ticks(trace.ticks["transform_tcp_to_base"][:, 2, 3])


HEIGHT = Measure(
    words="toy height", dimension=LENGTH, meaning="how high the TCP is", between=Interpolation.HELD,
    sample=height, reads=("transform_tcp_to_base",), lowest=-9.0, least=-9.0,
)
'''
SHORT = """
scenario: short
duration: 0.2 s
seed: 1
tcp start:
  offset: [30 mm, -60 mm, 60 mm]
avoider: opposite pose
hands:
  - hand: right hand
    starts at: [840 mm, -350 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -340 mm, 300 mm]
        speed: 1 m/s
claims:
  toy distance > 30 mm: holds
  always toy height > -1 m: holds
"""
ENTRY_POINTS = """
[safety_harness.commands]
toy = toy:commands
greedy = toy:greedy
run = toy:greedy
gone = toy:no_such_name
wrong = toy:TOYS
[safety_harness.inputs]
toy = toy:TOYS
scenario = toy:TOYS
reaching = toy:TOYS
[safety_harness.claims]
toy = toy:CLAIM
[safety_harness.claim_notes]
toy = toy:note
[safety_harness.signals]
toy = toy:HEIGHT
[safety_harness.worlds]
toy = toy:TOY_WORLD
pybullet = toy:TOY_WORLD
zz = toy:FALSE_REFERENCE
[safety_harness.warming]
toy = toy:note
"""


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is the installation of a package with a part of each kind, three of them unusable."""
    folder = tmp_path_factory.mktemp("toy")
    (folder / "toy.py").write_text(TOY)
    info = folder / "toy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


def called(toy: Path, *args: str, code: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *(("-c", code) if code else ("-m", "safety_harness")), *args]
    path = os.pathsep.join([str(toy), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        command, cwd=toy, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )


def test_the_toys_command_is_there_and_nothing_else_is_loaded(toy: Path) -> None:
    done = called(toy, "toy")
    assert (done.returncode, done.stdout, done.stderr) == (0, "the toy is there\n", "")


def test_the_help_has_the_toys_command_and_names_those_that_cannot_be_used(toy: Path) -> None:
    done = called(toy, "--help")
    assert done.returncode == 0
    assert re.search(r"─ Toy 1.0 ─.*\n. toy  +Say that the toy is there", done.stdout)
    warnings = [line for line in done.stderr.splitlines() if line.startswith("warning: left out")]
    found = {line.partition(" of ")[0].rpartition(" ")[2]: line for line in warnings}
    assert {*found} == {"gone", "greedy", "run", "wrong"}
    assert "no_such_name" in found["gone"]
    assert "it has no command greedy" in found["greedy"]
    assert "the command run is there already" in found["run"]
    assert "expected Typer, got InputFile" in found["wrong"]


def test_the_help_groups_commands_by_task_and_by_wing() -> None:
    text = called(Path.cwd(), "--help").stdout
    panels = [*re.findall(r"╭─ (.+?) ─", text)]
    assert panels[1:5] == [*TASKS]
    assert {"Assurance", "Field", "Lab", "Arms", "Selftest"} < {*panels[5:]}
    assert {name for names in TASKS.values() for name in names} == {
        name for group in CORE for name in commands_of(group)
    }


@pytest.mark.parametrize("command", ["gone", "greedy", "wrong"])
def test_a_command_that_cannot_be_loaded_is_no_command(toy: Path, command: str) -> None:
    done = called(toy, command)
    assert done.returncode == 2
    assert f"left out, safety_harness.commands {command} of toy 1.0" in done.stderr
    assert "No such command" in done.stderr


def test_no_part_replaces_a_command(toy: Path) -> None:
    done = called(toy, "run", "--help")
    assert "Run scenario files" in done.stdout
    assert "taken over" not in done.stdout


def test_the_version_loads_no_wing(toy: Path) -> None:
    code = """
import sys
from safety_harness.__main__ import main
try:
    main()
finally:
    print([one for one in sys.modules if one.startswith("safety_harness.extensions.") or one == "toy"])
"""
    assert called(toy, "--version", code=code).stdout.endswith("\n[]\n")


def test_the_toys_files_are_checked_explained_and_called_by_their_name(toy: Path) -> None:
    (toy / "mine.yaml").write_text("toy: a cart\n")
    (toy / "bad.yaml").write_text("toy: broken\n")
    done = called(toy, "validate", "mine.yaml")
    assert (done.returncode, done.stdout) == (0, "ok mine.yaml: a toy, with two wheels\n")
    bad = called(toy, "validate", "bad.yaml")
    assert bad.returncode == 2
    assert "expected a toy that is whole" in bad.stderr
    assert called(toy, "explain", "mine.yaml").stdout == "mine.yaml has two wheels\n"
    run = called(toy, "run", "mine.yaml")
    assert run.returncode == 2
    assert "a toy" in run.stderr
    assert "safety-harness toy mine.yaml" in run.stderr


def test_no_package_takes_the_place_of_files_that_the_core_reads(toy: Path) -> None:
    (toy / "own.yaml").write_text(
        SHORT.partition("claims:")[0] + "claims:\n  trace finite and monotone: holds\n"
    )
    done = called(toy, "validate", "own.yaml")
    assert "with two wheels" not in done.stdout
    assert done.stdout.startswith("ok own.yaml: 1 hand")


def test_the_toys_claim_signal_world_and_note_are_used_and_evidence_names_them(toy: Path) -> None:
    code = """
from pathlib import Path
from safety_harness import admit, judge, read_scenario, run_trial, WORLDS
from safety_harness.cli.explain import explain_claims
world = next(one for one in WORLDS if one.name == "toy")
text = Path("short.yaml").read_text()
trace = run_trial(admit(read_scenario(Path("short.yaml"))), world=world)
print(*(f"{one.sentence}: {one.verdict.value}" for one in judge(trace)), sep="\\n")
print(*(name for name, _ in trace.provenance.libraries if "entry point" in name), sep="\\n")
print([one.name for one in WORLDS])
from safety_harness.cell.simulation.worlds import worlds_by_label
print("the reference is", worlds_by_label()["PyBullet"].name)
explain_claims(["toy", "distance"])
"""
    (toy / "short.yaml").write_text(SHORT)
    done = called(toy, code=code)
    assert done.returncode == 0, done.stderr
    assert "always toy height > -1 m: holds" in done.stdout
    assert "toy distance > 30 mm: " in done.stdout
    assert "entry point safety_harness.worlds toy of toy 1.0" in done.stdout
    assert "['pybullet', 'kinematic', 'toy']" in done.stdout
    assert "a note of the toy" in done.stdout
    assert "the reference is pybullet" in done.stdout
    assert "left out, safety_harness.worlds zz: its name is taken" in done.stderr
    assert "the name is taken" in done.stderr


WITHOUT_WINGS = """
import sys

class NoWings:
    def find_spec(self, name, path=None, target=None):
        if name.startswith("safety_harness.extensions"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoWings())
from safety_harness.__main__ import main
sys.argv[0] = "safety-harness"
main()
"""


@pytest.mark.parametrize(
    "command",
    [
        ("validate", "short.yaml"),
        ("run", "short.yaml", "--world", "kinematic", "--out", "out"),
        ("claims", "hand", "distance"),
        ("explain", "critical", "distance"),
        ("sample", "shipped:unseen-hand", "--count", "1", "--out", "drawn"),
    ],
    ids=lambda command: command[0],
)
def test_the_core_works_where_no_wing_is_installed(command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(
        SHORT.partition("claims:")[0] + "claims:\n  trace finite and monotone: holds\n"
    )
    done = called(tmp_path, *command, code=WITHOUT_WINGS)
    assert (done.returncode, "warning: left out" in done.stderr, "Traceback" in done.stderr) == (
        0,
        False,
        False,
    ), done.stderr


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


def test_every_command_of_a_wing_has_an_entry_point_of_its_name() -> None:
    ours = [part for part in parts(ExtensionPoint.COMMANDS) if not part.package]
    groups = [group for part in ours if (group := load(part, typer.Typer)) is not None]
    assert {part.name for part in ours} == {name for group in groups for name in commands_of(group)}


def test_a_part_is_named_with_its_group_and_its_distribution() -> None:
    assert [str(part) for part in parts(ExtensionPoint.INPUTS) if not part.package] == [
        "safety_harness.inputs log",
        "safety_harness.inputs plan",
    ]
