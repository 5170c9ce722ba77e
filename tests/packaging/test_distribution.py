"""The distribution's name is ours in every text, and files of another project in our folder are noticed."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from safety_harness.base.distribution import DISTRIBUTION, foreign_files, installed_version
from safety_harness.base.extras import EXTRAS

ROOT = Path(__file__).parents[2]
FOREIGN_INSTALL = re.compile(r"pip install [^`\n]*(?<![\w./-])safety-harness(?!-)")


def project(folder: Path = ROOT) -> dict[str, str]:
    """The table of a project's metadata."""
    return dict(tomllib.loads((folder / "pyproject.toml").read_text())["project"])


def test_no_text_tells_anybody_to_install_the_other_project() -> None:
    """History is left: the changelog names the old distribution."""
    assert FOREIGN_INSTALL.search("pip install 'safety-harness[onnx]'")
    assert not FOREIGN_INSTALL.search("pip install hand-safety-harness")
    for name in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines():
        path = ROOT / name
        if name == "CHANGELOG.md" or path == Path(__file__) or not path.is_file():
            continue
        found = FOREIGN_INSTALL.search(path.read_bytes().decode("utf-8", "replace"))
        assert found is None, f"{name}: {found and found[0]}"


def test_the_name_of_the_distribution_stands_in_one_place() -> None:
    """Every other file of the package asks ``distribution.py``."""
    assert project()["name"] == DISTRIBUTION
    assert DISTRIBUTION in project(ROOT / "paper")["dependencies"]
    for path in (ROOT / "safety_harness").rglob("*.py"):
        text = path.read_text()
        assert path.name == "distribution.py" or DISTRIBUTION not in text, path
        assert not re.search(r"version\(.safety-harness", text), path


def test_the_version_is_that_of_the_installation_or_of_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    assert installed_version() == project()["version"]
    installed_version.cache_clear()
    monkeypatch.setattr(
        metadata, "version", lambda name: (_ for _ in ()).throw(metadata.PackageNotFoundError(name))
    )
    assert installed_version() == project()["version"]
    installed_version.cache_clear()


def test_the_hint_of_an_extra_installs_ours() -> None:
    assert any(f"pip install '{DISTRIBUTION}[" in extra.hint for extra in EXTRAS)


def with_another_project(folder: Path, record: str) -> dict[str, str]:
    """The environment of a process that sees a distribution ``safety-harness`` with these files."""
    info = folder / "safety_harness-0.3.14.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: safety-harness\nVersion: 0.3.14\n")
    (info / "RECORD").write_text(record)
    return {"PYTHONPATH": f"{folder}:{ROOT}", "PATH": "/usr/bin:/bin"}


@pytest.mark.parametrize(
    ("record", "warned"),
    [("safety_harness/__init__.py,,\n", True), ("__editable__.safety_harness.pth,,\n", False)],
    ids=["its files lie in our folder", "it has no files there"],
)
def test_every_command_warns_of_another_project_in_our_folder(
    tmp_path: Path, record: str, warned: bool
) -> None:
    environment = with_another_project(tmp_path, record)
    command = [sys.executable, "-m", "safety_harness", "explain", "duration"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0
    assert ("warning: safety-harness 0.3.14, another project" in done.stderr) == warned


def test_doctor_finds_another_project_in_our_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_another_project(tmp_path, "safety_harness/guard.py,,\n")
    monkeypatch.syspath_prepend(tmp_path)
    from safety_harness.cli.doctor import State, _clashes

    (found,) = [row for row in _clashes() if row.what == "package safety_harness"]
    assert found.state is State.PROBLEM
    assert found.needed
    assert found.words == foreign_files()
    assert f"pip uninstall safety-harness {DISTRIBUTION}" in found.words
