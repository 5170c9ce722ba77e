"""``make release`` tags a version once, and only where all files agree on it and nothing is uncommitted."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
GIT = ("git", "-c", "user.name=a", "-c", "user.email=a@example.org")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A repository that is ready to be released as 1.2.3."""
    (tmp_path / ".ci").mkdir()
    (tmp_path / "paper").mkdir()
    shutil.copy(ROOT / ".ci" / "release", tmp_path / ".ci" / "release")
    for project in ("pyproject.toml", "paper/pyproject.toml"):
        (tmp_path / project).write_text('[project]\nversion = "1.2.3"\n')
    (tmp_path / "CITATION.cff").write_text("version: 1.2.3\n")
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3 - 2026-11-22\n\n## 1.2.2 - 2026-10-01\n")
    for command in (("init", "-q"), ("add", "-A"), ("commit", "-qm", "all")):
        subprocess.run((*GIT, *command), cwd=tmp_path, check=True)
    return tmp_path


def release(clone: Path) -> subprocess.CompletedProcess[str]:
    env = {"PATH": "/usr/bin:/bin", "HOME": str(clone.parent)}
    for who in ("AUTHOR", "COMMITTER"):
        env |= {f"GIT_{who}_NAME": "a", f"GIT_{who}_EMAIL": "a@example.org"}
    return subprocess.run([clone / ".ci" / "release"], capture_output=True, text=True, env=env)


def test_a_version_is_tagged_once(clone: Path) -> None:
    first, second = release(clone), release(clone)
    assert (first.returncode, second.returncode) == (0, 1), first.stderr
    assert "v1.2.3 is there already" in second.stderr
    tags = subprocess.run((*GIT, "cat-file", "-t", "v1.2.3"), cwd=clone, capture_output=True, text=True)
    assert tags.stdout == "tag\n"


@pytest.mark.parametrize(
    ("file", "text", "why"),
    [
        ("CHANGELOG.md", "## Unreleased\n\n## 1.2.3\n", "begins with 'Unreleased'"),
        ("CITATION.cff", "version: 1.2.30\n", "CITATION.cff has another version"),
        ("paper/pyproject.toml", 'version = "1.2.2"\n', "paper/pyproject.toml has another version"),
        ("left.txt", "", "not clean"),
    ],
)
def test_a_tree_that_is_not_ready_is_refused(clone: Path, file: str, text: str, why: str) -> None:
    (clone / file).write_text(text)
    done = release(clone)
    assert done.returncode == 1
    assert why in done.stderr
    assert not subprocess.run((*GIT, "tag"), cwd=clone, capture_output=True).stdout
