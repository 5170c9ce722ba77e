"""``warm`` and ``doctor``, and what ``validate`` neither compiles nor loads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from safety_harness.base.compiled import cache_root
from safety_harness.base.extras import EXTRAS, Extra
from safety_harness.cell.simulation.worlds import OpensWorld, WorldEntry
from safety_harness.cli import doctor, warm
from safety_harness.cli.doctor import State, fits, required
from safety_harness.cli.main import app
from safety_harness.scenario.model import Verdict

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HEAVY = (
    "scipy.special",
    "scipy.stats",
    "hypothesis",
    "onnxruntime",
    "cv2",
    "torch",
    "pybullet",
)
AVOIDER = f"{Path(__file__).parents[2] / 'examples' / 'upwards.py'}:Upwards"
VALIDATE = f"""
import sys
from safety_harness.cli.main import app
app(["validate", *sys.argv[1:]], standalone_mode=False)
from safety_harness.base.compiled import _functions
print("compiled or loaded:", [one.py_func.__name__ for one in _functions if one.signatures])
print("heavy:", [name for name in {HEAVY} if name in sys.modules])
"""


def test_validate_compiles_nothing_and_loads_nothing_heavy(tmp_path: Path) -> None:
    arguments = [str(SCENARIOS / "hand-visits-and-leaves.yaml"), "--avoider", AVOIDER]
    ran = subprocess.run(
        [sys.executable, "-c", VALIDATE, *arguments],
        env=os.environ | {"SAFETY_HARNESS_CACHE": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "compiled or loaded: []" in ran.stdout, ran.stderr
    assert "heavy: []" in ran.stdout
    assert ran.stdout.startswith("ok ")


@pytest.mark.parametrize(
    ("version", "wanted", "good"),
    [
        ("2.4.6", ">=2.0,<3", True),
        ("2.4.6", "==2.4.6", True),
        ("2.4.6", "==2.4.*", True),
        ("2.4.6", "<2.4", False),
        ("2.4.6", ">=2.4.7", False),
        ("2.4", "!=2.4", False),
        ("2", ">=2.0", True),
        ("2.13.0+cpu", "==2.13.0", True),
        ("3.13.0", ">=3.11,<3.14", True),
        ("3.14.1", ">=3.11,<3.14", False),
        ("10.0", ">=9.0", True),
        ("1.0", "", True),
        ("1.0", "~=1.0", False),  # a form that ours do not have is none that is passed over
    ],
)
def test_a_version_is_within_a_range_or_not(version: str, wanted: str, good: bool) -> None:
    assert fits(version, wanted) is good


def test_what_is_required_is_what_every_installation_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = [
        "numpy<3,>=2",
        "ruamel.yaml==0.19.1",
        'torch==2.13.0; extra == "learning"',
        "old==1; python_version < '3.0'",
        "new==1; python_version >= '3.0'",
    ]
    monkeypatch.setattr(metadata, "requires", lambda _: asked)
    assert required() == {"numpy": "<3,>=2", "ruamel.yaml": "==0.19.1", "new": "==1"}


def examined(monkeypatch: pytest.MonkeyPatch) -> tuple[int, dict[str, dict[str, object]]]:
    """The exit code, and the checks by name; the self-check is another test's."""
    good = doctor.Examined("self-check", State.OK, "")
    monkeypatch.setattr(doctor, "_self_check", lambda: good)
    ran = CliRunner().invoke(app, ["doctor", "--json"])
    checks = json.loads(ran.stdout)["result"]["checks"]
    return ran.exit_code, {check["what"]: check for check in checks}


def test_doctor_says_what_is_there_and_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: ["numpy>=2", "numba"])
    monkeypatch.setattr(doctor, "EXTRAS", (Extra("no", ("none_such",), "nothing", package="none"),))
    monkeypatch.setattr(doctor, "shared_modules", dict)
    code, checks = examined(monkeypatch)
    assert code == 0
    assert checks["numpy"]["state"] == "ok"
    assert checks["none"] == {"what": "none", "state": "missing", "words": "for nothing", "needed": False}
    assert str(cache_root()) in str(checks["machine code"]["words"])


@pytest.mark.parametrize(
    ("asked", "words"), [("numpy<1", "which is not <1"), ("none-such==1", "not installed; pip install")]
)
def test_a_package_out_of_its_range_or_absent_is_a_problem(
    asked: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: [asked])
    code, checks = examined(monkeypatch)
    (name,) = required()
    assert code == 1
    assert checks[name]["state"] == "problem"
    assert words in str(checks[name]["words"])


@pytest.mark.parametrize(("package", "code"), [("numpy 2.0", 1), ("opencv-python 5.0", 0)])
def test_two_packages_with_one_module_are_a_problem_and_fatal_if_every_run_needs_it(
    package: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: ["numpy>=2"])
    monkeypatch.setattr(doctor, "shared_modules", lambda: {"module_of_two": (package, "other 1.0")})
    found, checks = examined(monkeypatch)
    assert found == code
    assert checks["module module_of_two"]["state"] == "problem"
    assert f"{package} and other 1.0" in str(checks["module module_of_two"]["words"])


def test_a_cache_that_cannot_be_written_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path / "file"))
    monkeypatch.setattr(doctor, "cache_folder", doctor.cache_folder.__wrapped__)  # of this root
    code, checks = examined(monkeypatch)
    assert code == 1
    assert "cannot write machine code" in str(checks["machine code"]["words"])


def test_doctor_looks_for_every_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: [])
    _, checks = examined(monkeypatch)
    assert {extra.package or extra.modules[0] for extra in EXTRAS} <= set(checks)


def test_machine_code_that_can_only_be_read_is_no_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stack.nbc").touch()
    monkeypatch.setattr(doctor, "cache_folder", lambda _: tmp_path)
    monkeypatch.setattr(doctor, "cache_problem", lambda _: "it cannot be kept")
    _, checks = examined(monkeypatch)
    assert checks["machine code"]["state"] == "ok"
    assert str(checks["machine code"]["words"]).endswith("machine code compiled here, read-only")


def test_the_self_check_sees_a_run_that_fails_and_a_verdict_that_differs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    good = doctor._self_check()
    assert good.state is State.OK, good.words
    monkeypatch.setattr(doctor, "SHORT_RUN", warm.SHORT_RUN.replace("finite and monotone", "nonsense"))
    assert doctor._self_check().state is State.PROBLEM
    monkeypatch.setattr(
        doctor, "_short_run", lambda: SimpleNamespace(sentence="it", verdict=Verdict.VIOLATED)
    )
    assert doctor._self_check().words == "a short kinematic run: it: violated"
    assert doctor._self_check().state is State.PROBLEM


def test_warm_says_where_the_machine_code_lies() -> None:
    ran = CliRunner().invoke(app, ["warm", "--json"])
    said = json.loads(ran.stdout)["result"]
    assert ran.exit_code == 0
    assert said["functions"] > 50
    assert said["bytes"] > 1_000_000
    assert said["folder"] == str(cache_root())


def test_warm_says_once_which_world_is_not_installed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing() -> OpensWorld:
        raise ModuleNotFoundError(name="gone")

    monkeypatch.setattr(warm, "WORLDS", [WorldEntry(name="gone", label="Gone", load=missing)])
    monkeypatch.setattr(warm, "run_many", lambda *_, **__: ())
    assert warm.warm_up() == 0
    assert capsys.readouterr().err.count("not for the world Gone") == 1


def test_warm_forgets_only_what_is_old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    for name in ("old", "new"):
        (tmp_path / "safety_harness" / name).mkdir(parents=True)
        (tmp_path / "safety_harness" / name / "code.nbc").write_bytes(bytes(1000))
    os.utime(tmp_path / "safety_harness" / "old", (0, 0))
    ran = CliRunner().invoke(app, ["warm", "--forget", "--json"])
    said = json.loads(ran.stdout)["result"]
    assert (ran.exit_code, said["removed_folders"], said["removed_bytes"]) == (0, 1, 1000)
    assert [folder.name for folder in (tmp_path / "safety_harness").iterdir()] == ["new"]


def test_warm_that_cannot_keep_anything_fails_and_ctrl_c_keeps_what_was_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(warm, "CATALOGUE", ())
    monkeypatch.setattr(warm, "run_trial", lambda *_, **__: None)
    monkeypatch.setattr(warm, "run_many", lambda *_, **__: ())
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path / "file"))
    ran = CliRunner().invoke(app, ["warm"])
    assert ran.exit_code == 1
    assert "SAFETY_HARNESS_CACHE" in ran.stderr
    monkeypatch.setattr(warm, "run_trial", interrupted)
    ran = CliRunner().invoke(app, ["warm"])
    assert ran.exit_code == 130
    assert "the compiled functions are kept" in ran.stderr
