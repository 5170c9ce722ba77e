"""Which tables are out of date?  Run: python benchmarks/stale.py, or make bench-stale.

Each table of this folder has a row in tables.toml: its revision, and the files that it depends on.  A table
is stale if a commit since touched one of them.  The exit code is 1 if a table is more than LIMIT such commits
old, and 2 where the repository has no history.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parent
LIMIT = 250  # commits that touched what a table depends on


@dataclass(frozen=True)
class Table:
    """A table: the revision that it was measured at, and globs of the files that it depends on."""

    name: str
    revision: str
    globs: tuple[str, ...]

    @classmethod
    def of(cls, name: str, row: dict[str, Any]) -> Table:
        """Read a row of tables.toml; KeyError or ValueError for one that is none."""
        if unknown := set(row) - {"revision", "scripts", "packages", "files"}:
            expected = "revision, scripts, packages and files"
            raise ValueError(f"tables.toml, {name}: expected {expected}; got {', '.join(sorted(unknown))}")
        scripts = [f"benchmarks/{script}.py" for script in row["scripts"]]
        packages = [f"safety_harness/**/{package}/**/*" for package in row.get("packages", ())]
        return cls(name, row["revision"], (*scripts, *packages, *row.get("files", ())))

    def commits_since(self) -> int:
        """Count the commits since the revision on files of the globs; CalledProcessError without it."""
        paths = [f":(glob){glob}" for glob in self.globs]
        return int(git("rev-list", "--count", f"{self.revision}..HEAD", "--", *paths))


def git(*words: str) -> str:
    """Return what git prints in the root of the repository; CalledProcessError where it fails."""
    done = subprocess.run(("git", *words), cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def tables(text: str | None = None) -> list[Table]:
    """Return the tables of tables.toml, or of such a text."""
    text = (HERE / "tables.toml").read_text(encoding="utf-8") if text is None else text
    return [Table.of(name, row) for name, row in tomllib.loads(text).items()]


def history() -> bool:
    """Return whether git knows the commits before this one."""
    try:
        return git("rev-parse", "--is-shallow-repository") == "false"
    except (OSError, subprocess.CalledProcessError):
        return False


def report(ages: dict[Table, int]) -> list[str]:
    """Return a line for each table, the oldest first."""
    lines = []
    for table, age in sorted(ages.items(), key=lambda one: -one[1]):
        word = "TOO OLD" if age > LIMIT else "stale" if age else "current"
        lines.append(f"{word:8} {age:4} commits since {table.revision}  {table.name}.md")
    return lines


def main() -> int:
    """Print each table's age; 1 if one is too old, 2 without a history."""
    if not history():
        print("expected a git repository with its whole history; got none", file=sys.stderr)
        return 2
    ages = {table: table.commits_since() for table in tables()}
    print("\n".join(report(ages)))
    return int(max(ages.values()) > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
