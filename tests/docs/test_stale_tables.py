"""Each table of benchmarks/ names its revision and what it depends on; one that is too old fails."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest
import stale

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
TABLES = {table.name: table for table in stale.tables()}
IN_EVERY_SCRIPT = {"base", "scenario", "space", "trace", "admission"}  # tables.toml leaves them out

has_history = pytest.mark.skipif(not stale.history(), reason="git's whole history is not here")
each_table = pytest.mark.parametrize("table", TABLES.values(), ids=TABLES.keys())


def test_every_table_has_a_row_and_every_row_a_table() -> None:
    assert set(TABLES) == {page.stem for page in BENCHMARKS.glob("*.md")}


@each_table
def test_every_glob_of_a_table_matches_a_file(table: stale.Table) -> None:
    for glob in table.globs:
        assert any(path.is_file() for path in ROOT.glob(glob)), glob


@each_table
def test_a_table_depends_on_what_its_scripts_import(table: stale.Table) -> None:
    covered = {path for glob in table.globs for path in ROOT.glob(glob)}
    scripts = [path for path in covered if path.parent == BENCHMARKS and path.suffix == ".py"]
    for script in scripts:
        for name in imports_of(script):
            top, _, rest = name.partition(".")
            file = ROOT / (name.replace(".", "/") + ".py")
            if top == "safety_harness" and rest.split(".")[0] not in IN_EVERY_SCRIPT and file.is_file():
                assert file in covered, f"{script.name} imports {name}"


def imports_of(script: Path) -> set[str]:
    """Return the names of the modules that a script imports."""
    tree = ast.walk(ast.parse(script.read_text()))
    return {node.module for node in tree if isinstance(node, ast.ImportFrom) and node.module}


@has_history
@each_table
def test_the_revision_of_a_table_is_in_the_history_and_is_the_one_that_it_names(table: stale.Table) -> None:
    stale.git("merge-base", "--is-ancestor", table.revision, "HEAD")
    words = re.findall(r"\b[0-9a-f]{7,8}\b", (BENCHMARKS / f"{table.name}.md").read_text())
    named = [word for word in words if re.search("[a-f]", word) and re.search("[0-9]", word)]
    assert not named or any(table.revision.startswith(word) for word in named)


@has_history
def test_no_table_is_too_old() -> None:
    ages = {table: table.commits_since() for table in TABLES.values()}
    assert max(ages.values()) <= stale.LIMIT, "\n".join(stale.report(ages))


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty git repository, which stale.py asks in place of this one."""
    subprocess.run(("git", "init", "-q"), cwd=tmp_path, check=True)
    monkeypatch.setattr(stale, "ROOT", tmp_path)
    return tmp_path


def commit(repository: Path, *files: str) -> str:
    """Change these files, commit them, and return the revision."""
    for file in files:
        path = repository / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(path.read_text() + "x\n" if path.is_file() else "x\n")
    subprocess.run(("git", "add", "-A"), cwd=repository, check=True)
    name = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(("git", *name, "commit", "-qm", "a change"), cwd=repository, check=True)
    return stale.git("rev-parse", "HEAD")


def test_commits_on_a_table_s_files_make_it_stale_and_no_others_do(repository: Path) -> None:
    measured = commit(repository, "benchmarks/speed.py", "safety_harness/robot/arm.py")
    (table,) = stale.tables(f'[SPEED]\nrevision = "{measured}"\nscripts = ["speed"]\npackages = ["robot"]\n')
    commit(repository, "README.md", "safety_harness/robots.py")
    assert table.commits_since() == 0
    commit(repository, "safety_harness/robot/arm.py")
    commit(repository, "safety_harness/cell/robot/arm.py")  # where the package moved
    commit(repository, "benchmarks/speed.py")
    assert table.commits_since() == 3


def test_the_report_has_the_oldest_first_and_says_what_is_too_old() -> None:
    old, fresh, a_bit = (stale.Table(name, "abc", ()) for name in ("OLD", "FRESH", "BIT"))
    lines = stale.report({fresh: 0, old: stale.LIMIT + 1, a_bit: stale.LIMIT})
    assert [line.split()[-1] for line in lines] == ["OLD.md", "BIT.md", "FRESH.md"]
    assert [line[:8].strip() for line in lines] == ["TOO OLD", "stale", "current"]


def test_a_row_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="SPEED"):
        stale.tables('[SPEED]\nrevision = "abc"\nscripts = []\nfolders = []\n')
