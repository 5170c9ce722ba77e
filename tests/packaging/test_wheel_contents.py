"""The wheel holds what ``list`` names, and its names, readers and copies work where it is installed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from safety_harness.base.compiled import source_hash
from safety_harness.base.shipped.contents import PREFIX, contents, shipped_files

ROOT = Path(__file__).parents[2]
PARTS = ("safety_harness", "scenarios", "plans", "examples", "robots", "docs")
FILES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built of a copy, since a build leaves its own folders beside the sources."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for part in PARTS:
        shutil.copytree(ROOT / part, source / part, ignore=shutil.ignore_patterns("__pycache__"))
    for file in FILES:
        shutil.copy(ROOT / file, source / file)
    (source / "site").mkdir()
    (source / "site/index.html").write_text("a site")
    # What pip asks of it, once; to press what is unpacked at once would take a third of the time.
    build = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1], {OPTIONS})"
    options = {"--build-option": ["--compression", "stored"]}
    done = subprocess.run(
        [sys.executable, "-c", build.format(OPTIONS=options), str(out)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=source,
    )
    assert done.returncode == 0, done.stderr
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel unpacked as an installation has it."""
    folder = tmp_path_factory.mktemp("installed")
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


def in_installation(installed: Path, here: Path, *command: str) -> str:
    """What a program of the installation, asked in ``here``, prints."""
    done = subprocess.run(
        [sys.executable, *command],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=here,
        env=os.environ | {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_everything_that_has_a_name(wheel: Path) -> None:
    held = zipfile.ZipFile(wheel).namelist()
    for one in shipped_files():
        files = [file for file in one.path.rglob("*") if file.is_file()] if one.path.is_dir() else [one.path]
        for file in files:
            if "__pycache__" not in file.parts:
                assert f"safety_harness/base/shipped/{file.relative_to(contents()).as_posix()}" in held
    assert "safety_harness/base/shipped/site/index.html" in held
    assert "safety_harness/base/shipped/plans/oracles.json" in held
    pages = [page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md")]
    assert {f"safety_harness/base/shipped/{page}" for page in pages} <= {*held}
    assert "safety_harness/base/shipped/scenarios/recordings/LICENSE" in held
    assert not [name for name in held if name.startswith(("scenarios", "tests"))]


def test_an_installation_lists_the_same_and_finds_it_in_itself(installed: Path, tmp_path: Path) -> None:
    answer = json.loads(in_installation(installed, tmp_path, "-m", "safety_harness", "list", "--json"))
    told = answer["result"]["files"]
    assert [one["name"] for one in told] == [PREFIX + one.name for one in shipped_files()]
    assert all(installed in Path(one["file"]).parents for one in told)


USED = """
from pathlib import Path
from safety_harness import read_scenario, read_space
from safety_harness.admission.avoiders import as_seen_from, with_avoider
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.certification.lodged import declaration_file
from safety_harness.base.compiled import source_hash
from safety_harness.scenario.files import display_path

scenario = read_scenario(Path("shipped:recorded-handover"))
moved = as_seen_from(Path("out"), with_avoider(scenario, "shipped:upwards.py:Upwards"))
print(moved.hands[0].recording, moved.avoider, display_path(scenario.file))
print(*(file.name for file in read_plan(Path("shipped:quick")).files))
print(*(file.name for file in read_plan(Path("mine.yaml")).files))
print(read_scenario(Path("recorded.yaml")).hands[0].recording)
print(declaration_file(Path("shipped:quick")))
print(source_hash())
"""


def test_results_of_an_installation_name_no_folder_of_this_machine(installed: Path, tmp_path: Path) -> None:
    """Not even where the installation lies below the working directory, as ``.venv`` often does."""
    (tmp_path / "mine.yaml").write_text(
        "plan: mine\nclaims:\n  - claim: repulsive poses reachable\n"
        "strata:\n  - stratum: seen\n    space: shipped:recorded-variations\n    runs: 1\n"
    )
    (tmp_path / "recorded.yaml").write_text("extends: shipped:recorded-handover\n")
    shutil.copytree(installed, tmp_path / "env")
    lines = in_installation(tmp_path / "env", tmp_path, "-c", USED).splitlines()
    recording = "robothumanhandover-0.csv"
    assert lines[:5] == [
        f"shipped:{recording} shipped:upwards.py:Upwards shipped:recorded-handover",
        "plans/quick.yaml scenarios/spaces/nominal.yaml scenarios/spaces/unseen-both.yaml",
        "mine.yaml shipped/scenarios/spaces/recorded-variations.yaml "
        f"shipped/scenarios/recordings/{recording}",
        f"shipped:{recording}",
        "quick.declared.json",
    ]
    assert lines[5] == source_hash()  # what is shipped is no part of the program
