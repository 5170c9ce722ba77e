#!/usr/bin/env python3
"""Run the core's tests where there is no wing: in a copy without ``safety_harness/extensions`` and its tests.

    .ci/core_alone.py [ARGUMENT OF PYTEST...]         ("make test-core" sets up and runs it)

The copy has metadata of its own, with the core's entry points alone: what is installed elsewhere is not found.
"""

import configparser
import importlib.metadata
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
WING = "safety_harness.extensions."
# Of the whole are tests of several rings and wings, of pages about both, and of what is installed.
OF_THE_WHOLE = ("whole", "docs", "packaging", "test_readme.py", "test_release.py")


def copy_of_the_core(folder: Path) -> None:
    """Everything of this repository but wings and what needs one."""
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    wings = {path.name for path in (ROOT / "safety_harness" / "extensions").iterdir() if path.is_dir()}
    for name in filter(None, tracked.decode().split("\0")):
        of_a_wing = name.startswith("safety_harness/extensions/")
        of_other_tests = name.startswith("tests/") and name.split("/")[1] in {*wings, *OF_THE_WHOLE}
        if (ROOT / name).is_file() and not of_a_wing and not of_other_tests:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def write_metadata(folder: Path) -> None:
    """Of the distribution, as a wheel without the wings would have it; the plug-in of pytest is the core's."""
    installed = importlib.metadata.distribution("hand-safety-harness")
    points = configparser.ConfigParser(delimiters=("=",))
    points.optionxform = str  # type: ignore[assignment, method-assign]
    points.read_string(installed.read_text("entry_points.txt") or "")
    for section in points.sections():
        for name, value in points.items(section):
            if value.startswith(WING):
                points.remove_option(section, name)
    info = folder / f"hand_safety_harness-{installed.version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(installed.read_text("METADATA") or installed.read_text("PKG-INFO") or "")
    with (info / "entry_points.txt").open("w") as file:
        points.write(file)
    # An editable installation finds modules of the checkout that the copy lacks.
    (folder / "sitecustomize.py").write_text(
        "import sys\n\n"
        "sys.meta_path[:] = [one for one in sys.meta_path if getattr(one, '__name__', '') != '_EditableFinder']\n"
    )


def main(arguments: list[str]) -> int:
    """The exit code of pytest."""
    with tempfile.TemporaryDirectory(prefix="core-alone-") as name:
        folder = Path(name)
        copy_of_the_core(folder)
        write_metadata(folder)
        environment = os.environ | {"PYTHONPATH": name, "SAFETY_HARNESS_CORE_ALONE": "1"}
        asked = "from importlib.util import find_spec as f; print(f('safety_harness').origin, f('safety_harness.extensions'))"
        found = subprocess.check_output([sys.executable, "-c", asked], cwd=folder, env=environment, text=True)
        if found.split() != [f"{folder / 'safety_harness' / '__init__.py'}", "None"]:
            raise SystemExit(f"expected the core of {name} and no wing; got {found}")
        command = [
            sys.executable,
            "-m",
            "pytest",
            "--assert=plain",
            "-p",
            "no:cacheprovider",
            "tests",
            *arguments,
        ]
        return subprocess.run(command, cwd=folder, env=environment).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
