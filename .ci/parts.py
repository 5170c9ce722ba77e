#!/usr/bin/env python3
"""What continuous integration has to run for a change: a list of make's targets as JSON.

    .ci/parts.py BASE        for what differs from the merge base with BASE
    .ci/parts.py             everything, as at night

A change of the core, of what is shipped and of any path that is not known here runs everything.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "safety_harness"
WINGS = sorted(path.parent.name for path in (PACKAGE / "extensions").glob("*/__init__.py"))
ALL = ("check", "test-core", *(f"test-{wing}" for wing in WINGS), "test-whole", "rest", "oldest", "installed")
# By the first folders of a path.
OF_FOLDERS = {
    ".ci/alone": ("check", "test-core"),
    "tests/whole": ("check", "test-whole"),
    "paper": ("check", "test-whole", "rest"),
    **dict.fromkeys(("tests/docs", "tests/packaging", "docs", "benchmarks", "reports"), ("check", "rest")),
}


def imported_by(wing: str) -> set[str]:
    """The wings that the files of one import."""
    texts = "".join(file.read_text("utf-8") for file in (PACKAGE / "extensions" / wing).rglob("*.py"))
    return {*re.findall(r"from safety_harness\.extensions\.(\w+)", texts)} - {wing}


def those_that_use(wing: str) -> set[str]:
    """A wing and every wing that imports it, directly or not."""
    found = {wing}
    while more := {one for one in WINGS if found & imported_by(one)} - found:
        found |= more
    return found


def of_path(path: str) -> Iterable[str]:
    """The targets of a change of one file."""
    first, second, third, *_ = *path.split("/"), "", ""
    if first == "safety_harness" and second == "extensions" and third in WINGS:
        # The documents' tables and the wheel are made of wings too.
        wings = (f"test-{one}" for one in those_that_use(third))
        return ("check", *wings, "test-whole", "rest", "installed")
    if first == "tests" and not path.rpartition("/")[2].startswith("test_"):
        return ALL  # which others share
    if first == "tests" and second in WINGS:
        return ("check", f"test-{second}")
    if first == "tests" and (PACKAGE / second).is_dir():
        return ("check", "test-core")
    if not second and path.endswith(".md"):
        return ("check", "rest")
    return OF_FOLDERS.get(f"{first}/{second}") or OF_FOLDERS.get(first) or ALL


def of_paths(paths: Iterable[str]) -> list[str]:
    """The targets of a change of several files, in their order."""
    wanted = {target for path in paths for target in of_path(path)}
    return [target for target in ALL if target in wanted]


def main(bases: list[str]) -> None:
    """Print the list."""
    command = ["git", "diff", "--name-only", *(f"{base}...HEAD" for base in bases)]
    changed = subprocess.check_output(command, cwd=ROOT, text=True).splitlines()
    print(json.dumps(of_paths(changed) if bases else ALL))


if __name__ == "__main__":
    main(sys.argv[1:])
