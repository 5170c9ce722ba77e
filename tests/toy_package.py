"""A toy package that adds a part of each kind; some of its parts cannot be used."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TOY = '''
from dataclasses import fields, replace
from pathlib import Path

import typer

import numpy as np
from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.extension_points import CheckedFile, InputFile
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.claims.formulas.measures import Measure
from safety_harness.claims.formulas.signal import Interpolation, at_ticks
from safety_harness.claims.properties.catalogue import HAND_DISTANCE
from safety_harness.extensions.pages.page_parts import PageSection
from safety_harness.scenario.codec import Key, QuantityValue
from safety_harness.scenario.units import LENGTH
from safety_harness.seams.contract import ControllerOpener, Move

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
    words = "toy distance > {minimum_m:mm}"


ToyDistance.__name__ = "ToyDistance"
NAMES = [field.name for field in fields(HAND_DISTANCE.prop) if field.init]
VALUES = {name: getattr(HAND_DISTANCE.prop, name) for name in NAMES}
CLAIM = replace(HAND_DISTANCE, prop=ToyDistance(**VALUES), pattern="", make=None)
TOY_WORLD = replace(KINEMATIC, name="toy", label="toy")
FALSE_REFERENCE = replace(KINEMATIC, name="mine", label="PyBullet", model_only=False)


def cell(reference):
    return replace(KINEMATIC, name=reference, label=reference)


def note(entry):
    yield "toy", "a note of the toy"


def height(trace):
    return at_ticks(trace.ticks["transform_tcp_to_base"][:, 2, 3])


HEIGHT = Measure(
    words="toy height", dimension=LENGTH, meaning="how high the TCP is", between=Interpolation.HELD,
    sample=height, reads=("transform_tcp_to_base",), lowest=-9.0, least=-9.0,
)
WHEEL = Key("toy", QuantityValue(LENGTH, least=0.0, most=1.0), "how wide the wheels are", "30 mm")


class Slowly:
    name = "toy"
    sees = ("joints",)

    def __init__(self, reference):
        if "locked" in reference:
            raise RuntimeError("the toy is locked")

    def reset(self, **about):
        pass

    def act(self, seen):
        return Move(tcp_velocity_mps=np.array([0.0, 0.0, 0.01]))


OPENER = ControllerOpener(open=Slowly, sha256=lambda reference: "0" * 64)


def least_height(trace):
    return height(trace).value.min()


def fails(*given):
    raise RuntimeError("no wheels")


def as_text(trace, evaluations, path):
    path.write_text(f"{trace.scenario.title}: {len(evaluations)} claims")
    return (path,)


def of_runs(rows, page="run"):
    return PageSection(page=page, heading="Toy <wheels>", caption="How high", heads=("what", "mm"), rows=rows)


HEIGHTS = of_runs(lambda run: [("least & last", f"{1e3 * least_height(run.trace):.0f}")])
EVIDENCE = of_runs(lambda evidence: [("claims", len(evidence.claims))], page="evidence")
NO_ROWS, FAILING = of_runs(lambda run: []), of_runs(fails)
'''
PAGES = """
from safety_harness.admission.admit import Admitter
from safety_harness.search.counterexample import Explanation


def write(path, runs, **about):
    path.write_text(f"a page of {len(runs)} runs")


class Explains:
    def __init__(self, world):
        self.admitter = Admitter()

    def explain(self, scenario, claim, allowance=None, *, confirms=True):
        return Explanation(("whose fault: the wheels",), ("wheels",))

    def of_search(self, session):
        return None

    def answers(self, shown):
        return {written.path.name: {"answer": "wheels"} for written in shown}
"""
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
[safety_harness.world_programs]
toy = toy:cell
exec = toy:fails
[safety_harness.warming]
toy = toy:note
[safety_harness.scenario_keys]
toy = toy:WHEEL
spoiled = toy:no_such_name
[safety_harness.controllers]
toy = toy:OPENER
exec = toy:OPENER
mine.py = toy:OPENER
[safety_harness.run_formats]
toy = toy:as_text
[safety_harness.ledger_columns]
toy_height = toy:least_height
toy_broken = toy:fails
seed = toy:least_height
[safety_harness.pages]
runs = toy_pages:write
[safety_harness.explainers]
attribution = toy_pages:Explains
[safety_harness.page_sections]
toy = toy:HEIGHTS
evidence = toy:EVIDENCE
empty = toy:NO_ROWS
failing = toy:FAILING
"""


def install(folder: Path) -> Path:
    """Make of a folder the installation of the toy; ``called`` finds it there."""
    (folder / "toy.py").write_text(TOY)
    (folder / "toy_pages.py").write_text(PAGES)
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
