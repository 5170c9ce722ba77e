from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from safety_harness.base import compiled as module
from safety_harness.base.compiled import (
    cache_folder,
    compiled,
    njit_no_nrt,
    source_hash,
)
from safety_harness.base.interpreted import calls_of, without_compiling
from safety_harness.cell.controller import stack


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small package in place of ours."""
    root = tmp_path / "safety_harness"
    (root / "inner").mkdir(parents=True)
    (root / "a.py").write_text("x = 1\n")
    (root / "inner" / "b.py").write_text("y = 2\n")
    monkeypatch.setattr(module, "PACKAGE", root)
    return root


def package_hash() -> str:
    module._content.cache_clear()
    return source_hash.__wrapped__()


CHANGES: dict[str, Callable[[Path], object]] = {
    "an edit": lambda root: (root / "a.py").write_text("x = 2\n"),
    "an edit below": lambda root: (root / "inner" / "b.py").write_text("y = 3\n"),
    "a new file": lambda root: (root / "inner" / "c.py").write_text(""),
    "a deletion": lambda root: (root / "a.py").unlink(),
    "a new name": lambda root: (root / "a.py").rename(root / "d.py"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_the_source_hash_changes_with_every_source_file(
    change: Callable[[Path], object], package: Path
) -> None:
    before = package_hash()
    change(package)
    assert package_hash() != before


def test_the_source_hash_stays_where_only_other_files_change(package: Path) -> None:
    before = package_hash()
    (package / "notes.txt").write_text("no code")
    (package / "a.py").touch()
    assert package_hash() == before


def test_another_numba_is_another_hash(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = package_hash()
    monkeypatch.setattr(numba, "__version__", "0.0.0")
    assert package_hash() != before


def folder_name(file: Path) -> str:
    module._imports.cache_clear()
    module._content.cache_clear()
    return cache_folder.__wrapped__(file).name


def test_machine_code_moves_with_every_file_that_it_may_call_and_with_no_other(package: Path) -> None:
    (package / "a.py").write_text("from safety_harness.inner.b import y\n")
    (package / "inner" / "b.py").write_text("def y():\n    from safety_harness.c import z\n")
    (package / "c.py").write_text("z = 1\n")
    (package / "d.py").write_text("from safety_harness.a import y\n")
    before = {name: folder_name(package / f"{name}.py") for name in ("a", "c", "d")}
    (package / "c.py").write_text("z = 2\n")
    after = {name: folder_name(package / f"{name}.py") for name in ("a", "c", "d")}
    assert all(before[name] != after[name] for name in before)
    (package / "d.py").write_text("# another caller\n")
    assert folder_name(package / "a.py") == after["a"]
    assert folder_name(package / "d.py") != after["d"]


def test_files_that_import_one_another_have_one_fate(package: Path) -> None:
    (package / "a.py").write_text("from safety_harness.inner.b import y\n")
    (package / "inner" / "b.py").write_text("from safety_harness.a import x\n")
    assert module.sources_of(package / "a.py") == module.sources_of(package / "inner" / "b.py")


def test_code_outside_the_package_depends_on_all_of_it(package: Path) -> None:
    outside = package.parent / "outside.py"
    before = folder_name(outside)
    (package / "inner" / "b.py").write_text("y = 4\n")
    assert folder_name(outside) != before


def test_code_of_a_package_beside_depends_on_what_it_imports_of_both(package: Path) -> None:
    beside = package.parent / "beside"
    beside.mkdir()
    for name, text in {
        "__init__": "",
        "one": "from beside.two import x\nfrom numpy.linalg import norm\n",
        "two": "from safety_harness.a import x\n",
        "three": "",
    }.items():
        (beside / f"{name}.py").write_text(text)
    expected = {beside / "one.py", beside / "two.py", package / "a.py"}
    assert module.sources_of(beside / "one.py") == expected


def test_the_control_stack_depends_on_geometry_and_not_on_the_report() -> None:
    sources = {
        path.relative_to(module.PACKAGE).parent.name for path in module.sources_of(Path(stack.__file__))
    }
    assert {"controller", "geometry", "perception", "servoing", "robot"} <= sources
    assert not {"report", "cli", "simulation", "properties"} & sources


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"SAFETY_HARNESS_CACHE": "/a", "XDG_CACHE_HOME": "/b"}, "/a"),
        ({"XDG_CACHE_HOME": "/b"}, "/b"),
        ({"HOME": "/h"}, "/h/.cache"),
    ],
)
def test_the_environment_says_where_machine_code_is_kept(
    variables: dict[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("SAFETY_HARNESS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert module.cache_root() == Path(expected) / "safety_harness"


def test_compiling_leaves_numbas_own_settings_alone() -> None:
    before = module.numba_config.CACHE_DIR
    quotient = compiled(lambda a, b: a / b)
    assert before == module.numba_config.CACHE_DIR
    assert np.isnan(quotient(0.0, 0.0))  # like numpy: every caller looks for NaN
    assert quotient(1.0, 0.0) == np.inf


def test_only_old_machine_code_is_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "cache_root", lambda: tmp_path)
    old, fresh = tmp_path / "old", tmp_path / "fresh"
    for folder in (old, fresh):
        folder.mkdir()
        (folder / "code").write_text("x")
    os.utime(old, (0, 0))
    module.forget_old_machine_code()
    assert fresh.exists()
    assert not old.exists()


def test_using_machine_code_keeps_it_fresh(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "cache_root", lambda: package.parent / "cache")
    folder = cache_folder.__wrapped__(package / "a.py")
    folder.mkdir(parents=True)
    os.utime(folder, (0, 0))
    assert cache_folder.__wrapped__(package / "a.py") == folder
    assert folder.stat().st_mtime > 1e9


HALF = """from safety_harness.base.compiled import compiled

@compiled
def half(x: float) -> float:
    return x / 2.0
"""


def half_in(folder: Path, text: str = HALF) -> Any:
    """``half`` of a module in ``folder``, called once."""
    (folder / "of_a_user.py").write_text(text)
    spec = importlib.util.spec_from_file_location("mine.of_a_user", folder / "of_a_user.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    loaded.half(3.0)
    return loaded.half


def test_the_same_package_elsewhere_finds_its_machine_code_and_another_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path / "cache"))
    texts = {"here": HALF, "there": HALF, "other": HALF.replace("2.0", "4.0"), "alone": HALF}
    for place in texts:
        (tmp_path / place / "mine").mkdir(parents=True)
        if place != "alone":
            (tmp_path / place / "mine" / "__init__.py").touch()
    made = {place: half_in(tmp_path / place / "mine", text) for place, text in texts.items()}
    hits = {place: sum(one.stats.cache_hits.values()) for place, one in made.items()}
    assert hits == {"here": 0, "there": 1, "other": 0, "alone": 0}
    assert made["other"](3.0) == 0.75


def test_a_function_without_arrays_may_call_one_that_makes_them() -> None:
    @compiled
    def total(n: int) -> float:
        return float(np.full(n, 2.0).sum())

    @njit_no_nrt
    def twice(n: int) -> float:
        return 2.0 * total(n)

    assert twice(3) == 12.0


def test_without_compiling_the_python_runs_and_afterwards_machine_code() -> None:
    half = compiled(lambda x: x / 2.0)
    assert without_compiling(lambda: half(3.0)) == 1.5
    assert not half.signatures
    assert half(3.0) == 1.5
    assert half.signatures


def test_what_is_defined_without_compiling_is_not_compiled_and_is_later() -> None:
    half = without_compiling(lambda: compiled(lambda x: x / 2.0))
    made, answer = without_compiling(lambda: (one := compiled(lambda x: x + 1.0), one(1.0)))
    assert answer == 2.0
    assert not made.signatures
    assert half(3.0) == 1.5
    assert half.signatures


def test_without_compiling_records_are_read_and_written_by_attribute() -> None:
    @compiled
    def advance(states: np.ndarray, one: np.void) -> float:
        states[0].x += one.step
        one.step = 3.0
        one.way[1] = 4.0
        return float(states[0].x)

    states = np.zeros(1, np.dtype([("x", float)]))
    steps = np.ones(1, np.dtype([("step", float), ("way", float, (2,))]))
    assert without_compiling(lambda: advance(states, steps[0])) == 1.0
    assert steps[0].tolist()[0] == 3.0
    assert steps[0]["way"].tolist() == [1.0, 4.0]
    assert advance(states, steps[0]) == states["x"][0] == 4.0


def test_where_python_refuses_what_machine_code_answers_machine_code_answers() -> None:
    quotient = compiled(lambda a, b: a / b)
    assert without_compiling(lambda: quotient(1.0, 0.0)) == np.inf
    assert quotient.signatures


def test_an_error_leaves_machine_code_in_its_place() -> None:
    half = compiled(lambda x: x / 2.0)

    def work() -> None:
        raise KeyError

    with pytest.raises(KeyError):
        without_compiling(work)
    half(1.0)
    assert half.signatures


def test_outermost_calls_are_noted_without_compiling_even_those_before_an_error() -> None:
    half = compiled(lambda x: x / 2.0)
    quarter = compiled(lambda x: half(half(x)))

    def work() -> None:
        quarter(1.0)
        half(1)
        quarter(2.0)
        raise KeyError

    assert calls_of(work) == [(quarter, (numba.float64,)), (half, (numba.int64,))]
    assert not half.signatures
    assert quarter(4.0) == 1.0


def test_one_version_serves_every_constant_and_every_array_of_a_record() -> None:
    @compiled
    def entry(values: np.ndarray, i: int) -> float:
        return float(values[i])

    @compiled
    def both(records: np.ndarray, plain: np.ndarray) -> float:
        return entry(records[0].short, 1) + entry(records[0].long, 2) + entry(plain, len(plain) - 1)

    records = np.zeros(1, np.dtype([("short", float, (2,)), ("long", float, (3,))]))
    records["short"], records["long"] = [1.0, 2.0], [3.0, 4.0, 5.0]
    assert both(records, np.array([8.0])) == 2.0 + 5.0 + 8.0
    assert len(entry.signatures) == 1


@pytest.fixture
def fresh() -> Iterator[None]:
    """Nothing is known of this file's folder."""
    module.cache_folder.cache_clear()
    yield
    module.cache_folder.cache_clear()


@pytest.fixture
def no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: None) -> Path:
    """A file in the place of the folder: root may write everywhere else."""
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(file))
    return file


def test_a_cache_that_cannot_be_written_is_named_and_compiled_functions_run(no_folder: Path) -> None:
    half = compiled(lambda x: x / 2.0)
    assert half(3.0) == 1.5
    said = module.compilation().unwritable
    assert str(no_folder) in said
    assert "SAFETY_HARNESS_CACHE" in said
    assert half.stats.cache_path.startswith(str(no_folder))  # numba has not looked for a place of its own


@pytest.mark.usefixtures("fresh")
def test_a_cache_that_can_only_be_read_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(30, "Read-only file system")

    def half(x: float) -> float:
        return x / 2.0

    def third(x: float) -> float:
        return x / 3.0

    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    monkeypatch.setattr(module._progress, "unwritable", "")
    compiled(half)(3.0)
    before = sorted(tmp_path.rglob("*"))
    module.cache_problem.cache_clear()
    for name in ("TemporaryFile", "NamedTemporaryFile"):
        monkeypatch.setattr(module.tempfile, name, read_only)
    monkeypatch.setattr(module.os, "utime", read_only)
    again, other = compiled(half), compiled(third)
    assert (again(3.0), other(3.0)) == (1.5, 1.0)
    assert (again.stats.cache_hits, other.stats.cache_hits) == ({(numba.float64,): 1}, {})
    assert sorted(tmp_path.rglob("*")) == before
    assert "Read-only file system" in module.compilation().unwritable


def test_a_user_without_a_home_has_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("SAFETY_HARNESS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", home)
    assert module.cache_problem(module.cache_root())
    assert module.machine_code() == []


def test_a_full_disk_costs_the_machine_code_and_not_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.FunctionCache, "save_overload", full)
    monkeypatch.setattr(module._progress, "unwritable", "")
    assert compiled(lambda x: x / 2.0)(3.0) == 1.5
    assert "No space left" in module.compilation().unwritable
