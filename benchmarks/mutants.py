"""Small faults put into the control stack by lot: which does the test folder of the faulty file notice?

Run: python benchmarks/mutants.py [--count 100] [--seed 17] [--workers 2] [--scratch FOLDER].

The files of ``FILES`` take turns; each draws one of the ``OPERATORS`` that fit it, then one of the places
where it fits.  The fault is put into a copy of the package, and the tests of its folder run there up to the
first that fails, those of the file itself first.  A mutant that does not compile is passed over for the
next one drawn.  The result goes to docs/mutants.json; those found there as killed are not tried
again while their file is the same, so that a run goes on where it was stopped, and a new test is
tried on the survivors alone.  The table in docs/results/self-test.md is made from it by docs/tables.py.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mutation import PACKAGE, Mutant, by_lot

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "mutants.json"
FILES = [
    *sorted((PACKAGE / "cell" / "controller").glob("[!_]*.py")),
    PACKAGE / "cell" / "avoidance" / "gate.py",
    PACKAGE / "cell" / "robot" / "drive.py",
    PACKAGE / "cell" / "simulation" / "steps.py",
    *sorted((PACKAGE / "cell" / "perception").glob("[!_]*.py")),
]
COPIED = ("safety_harness", "tests", "scenarios", "examples", "benchmarks", "docs", "pyproject.toml")
FIRST = {  # which tests look at a file first, where they are not called after it
    "cell/controller": ("test_stack", "test_state_table"),
    "cell/simulation": ("test_kinematic_world", "test_sensing", "test_faults"),
}
OWN_TIMEOUT_S, REST_TIMEOUT_S = 600.0, 1800.0
STILLBORN = re.compile(
    r"TypingError|UnboundLocalError|NameError|SyntaxError|LoweringError|Unsupported|NRT required"
)

Result = dict[str, Any]  # outcome, by, sources, mutant


def tests_for(file: str) -> tuple[list[str], list[str]]:
    """The test files of a file's folder: its own, and the others."""
    room, _, stem = file.removesuffix(".py").rpartition("/")
    mine = [f"tests/{room}/{name}.py" for name in FIRST.get(room, (f"test_{stem}",))]
    rest = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "tests" / room).glob("test_*.py"))
    own = [path for path in mine if path in rest]
    return own, [path for path in rest if path not in own]


def outcome(folder: Path, mutant: Mutant) -> tuple[str, str]:
    """(killed, survived, timeout or stillborn; by which test) of a mutant in a copy of everything."""
    target = folder / "safety_harness" / mutant.file
    original, status = target.read_bytes(), target.stat()
    target.write_bytes(mutant.applied(original))
    try:
        for tests, timeout_s in zip(tests_for(mutant.file), (OWN_TIMEOUT_S, REST_TIMEOUT_S), strict=True):
            found = _tested(folder, tests, timeout_s) if tests else ("survived", "")
            if found[0] != "survived":
                return found
        return "survived", ""
    finally:
        target.write_bytes(original)
        os.utime(target, ns=(status.st_atime_ns, status.st_mtime_ns))  # its machine code stays valid


def _tested(folder: Path, tests: list[str], timeout_s: float) -> tuple[str, str]:
    environment = os.environ | {
        "PYTHONPATH": str(folder),
        "SAFETY_HARNESS_CACHE": str(folder / "cache"),
        "NUMBA_OPT": "1",  # compiles in a third of the time; a strict float is the same at any level
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-rfE", "--tb=line"]
    try:
        process = subprocess.run(
            [*command, *tests], cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s
        )
    except subprocess.TimeoutExpired:
        return "timeout", ""
    output = process.stdout
    if process.returncode == 0:
        return "survived", ""
    if STILLBORN.search(output):
        return "stillborn", ""
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return "killed", failed[1] if failed else f"the test process ended with {process.returncode}"


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def main() -> None:
    """Draw, try, write down."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=17)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scratch", type=Path, help="keep the copies and their machine code in this folder")
    wanted = parser.parse_args()
    known: dict[tuple[str, Mutant], Result] = {}
    if RESULTS.exists():
        for one in json.loads(RESULTS.read_text())["mutants"]:
            known[one["sources"], Mutant(**one["mutant"])] = one
    draws = {path: by_lot(path, wanted.seed) for path in FILES}
    tried: list[Result] = []
    with tempfile.TemporaryDirectory() as temporary:
        scratch = wanted.scratch or Path(temporary)
        folders: queue.Queue[Path] = queue.Queue()
        for k in range(wanted.workers):
            folders.put(_copy(scratch / str(k)))

        def attempt(path: Path) -> list[Result]:
            """Mutants of a file up to the next that compiles; empty if there is none left."""
            results: list[Result] = []
            for mutant in draws[path]:
                key = _hash(path), mutant
                if key not in known or known[key]["outcome"] in ("survived", "timeout"):
                    folder = folders.get()
                    what, by = outcome(folder, mutant)
                    folders.put(folder)
                    said = {"note": known.get(key, {}).get("note", "")}  # what a person said of it stays
                    known[key] = {
                        "outcome": what,
                        "by": by,
                        "sources": key[0],
                        "mutant": asdict(mutant),
                    } | said
                    print(
                        f"{what} {mutant.file}:{mutant.line} {mutant.operator}: {mutant.after!r} {by}",
                        flush=True,
                    )
                    _write(wanted.seed, list(known.values()))
                results.append(known[key])
                if known[key]["outcome"] != "stillborn":
                    break
            return results

        with ThreadPoolExecutor(wanted.workers) as pool:
            paths, done = FILES, 0
            while paths and done < wanted.count:
                turn = paths[: wanted.count - done]
                for path, results in zip(turn, pool.map(attempt, turn), strict=True):
                    tried += results
                    if not results or results[-1]["outcome"] == "stillborn":
                        paths = [one for one in paths if one != path]
                    else:
                        done += 1
        _write(wanted.seed, tried)
        what, by = _tested(
            folders.get(),
            sorted({f"tests/{path.parent.relative_to(PACKAGE)}" for path in FILES}),
            REST_TIMEOUT_S,
        )
        if what != "survived":
            raise SystemExit(f"the tests fail without any fault: {what} {by}")


def _copy(folder: Path) -> Path:
    """A folder with everything that the tests need."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, dirs_exist_ok=True)
        else:
            shutil.copy2(ROOT / name, folder / name)
    return folder


def _write(seed: int, tried: list[Result]) -> None:
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True
    )
    head = {"revision": revision.stdout.strip(), "seed": seed}
    RESULTS.write_text(json.dumps(head | {"mutants": tried}, indent=1) + "\n")


if __name__ == "__main__":
    main()
