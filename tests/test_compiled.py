from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import pytest

from safety_harness import compiled as module
from safety_harness.compiled import cache_folder, compiled, source_hash


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small package in place of ours."""
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "inner" / "b.py").write_text("y = 2\n")
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    return tmp_path


def fresh_hash() -> str:
    return source_hash.__wrapped__()


CHANGES: dict[str, Callable[[Path], object]] = {
    "an edit": lambda root: (root / "a.py").write_text("x = 2\n"),
    "an edit below": lambda root: (root / "inner" / "b.py").write_text("y = 3\n"),
    "a new file": lambda root: (root / "inner" / "c.py").write_text(""),
    "a deletion": lambda root: (root / "a.py").unlink(),
    "a new name": lambda root: (root / "a.py").rename(root / "d.py"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_the_cache_folder_moves_with_every_source_file(
    change: Callable[[Path], object], package: Path
) -> None:
    before = fresh_hash()
    change(package)
    assert fresh_hash() != before


def test_the_cache_folder_stays_where_only_other_files_change(package: Path) -> None:
    before = fresh_hash()
    (package / "notes.txt").write_text("no code")
    (package / "a.py").touch()
    assert fresh_hash() == before


def test_another_numba_is_another_folder(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = fresh_hash()
    monkeypatch.setattr(numba, "__version__", "0.0.0")
    assert fresh_hash() != before


def test_the_hash_covers_this_package_wherever_it_stands(tmp_path: Path) -> None:
    copy = shutil.copytree(module.PACKAGE, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PACKAGE", copy)
        assert fresh_hash() == source_hash()
        with (copy / "seeds.py").open("a") as file:
            file.write("# one more line\n")
        assert fresh_hash() != source_hash()


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
    assert cache_folder.__wrapped__() == Path(expected) / "safety_harness" / source_hash()


def test_compiling_leaves_numbas_own_settings_alone() -> None:
    before = module.numba_config.CACHE_DIR
    quotient = compiled(lambda a, b: a / b)
    assert before == module.numba_config.CACHE_DIR
    assert np.isnan(quotient(0.0, 0.0))  # like numpy: every caller looks for NaN
    assert quotient(1.0, 0.0) == np.inf


def test_only_old_machine_code_of_other_sources_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path / module.source_hash())
    ours, old, fresh = (tmp_path / name for name in (module.source_hash(), "old", "fresh"))
    for folder in (ours, old, fresh):
        folder.mkdir()
        (folder / "code").write_text("x")
    for folder in (ours, old):
        os.utime(folder, (0, 0))
    module.forget_old_machine_code()
    assert ours.exists()
    assert fresh.exists()
    assert not old.exists()
