"""The table of ratios: run what offers ratios, write RESULTS.md.  Run: python benchmarks/results.py [NAME]...

Each benchmark runs in a process of its own.  Ratios are formed between sides that take turns, so that they
bear a busy machine better than seconds do; the load stands beside them all the same.  With names only those
run, and nothing is written.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ratios import Ratio, shown

HERE = Path(__file__).parent
RESULTS = HERE / "RESULTS.md"
BENCHMARKS = ("loop", "decision", "formulas", "kinematic", "overhead", "training", "dataset")
LIBRARIES = ("numpy", "numba", "pybullet", "torch", "rtamt", "onnxruntime")
HEAD = """\
# Ratios

Written by `make bench`. A ratio is formed within each turn of two sides that take turns on the same work,
and given as median (least to greatest) of the turns; more than one means that ours is quicker, but where the
aim says "at most", or the row names two others. How each is measured is said at the top of its script. Notes
are of a machine as busy as `load` says (processes that wanted to run, before and after); compare ratios, not
seconds.

"""


def measured(name: str) -> list[Ratio]:
    """What a script's ``ratios()`` gives, in a process of its own; why not, as a row, if it gives nothing."""
    command = [sys.executable, __file__, "--json", name]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["it ended without a word"])[-1]
        return [Ratio.missing(name, last)]
    return [Ratio(**row) for row in json.loads(done.stdout.splitlines()[-1])]


def load() -> str:
    """The load averages of one minute, or a dash where there are none."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "-"


def row_of(ratio: Ratio, script: str, loads: str) -> str:
    """A line of the table."""
    value = spread = "-"
    if ratio.verdict != "not measured":
        value, spread = shown(ratio.value), f"{shown(ratio.least)} to {shown(ratio.greatest)}"
    cells = (ratio.what, value, spread, ratio.aimed, ratio.verdict, ratio.note, loads, f"`{script}.py`")
    return "| " + " | ".join(cells) + " |"


def table(rows: list[tuple[Ratio, str, str]]) -> str:
    """RESULTS.md from (ratio, script, load before and after)."""
    versions = []
    for library in LIBRARIES:
        try:
            versions.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            versions.append(f"{library} not installed")
    where = (
        f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}, {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} cores, Python {platform.python_version()}; {', '.join(versions)}.\n\n"
    )
    head = "| what | ratio | turns | aim | | | load | script |\n|---|---|---|---|---|---|---|---|\n"
    return HEAD + where + head + "".join(row_of(*row) + "\n" for row in rows)


def main(arguments: list[str]) -> int:
    """Run, print as it goes, and write the table if all were run; 1 if a script failed."""
    if arguments[:1] == ["--json"]:
        rows = import_module(arguments[1]).ratios()
        print(json.dumps([asdict(row) for row in rows]))
        return 0
    names = arguments or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        print(f"expected names of {', '.join(BENCHMARKS)}; got {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    found: list[tuple[Ratio, str, str]] = []
    for name in names:
        before = load()
        rows = measured(name)
        loads = f"{before} to {load()}"
        found += [(row, name, loads) for row in rows]
        for row in rows:
            print(f"{name}: {row}", flush=True)
        if not arguments:
            RESULTS.write_text(table(found), encoding="utf-8")
    return int(any(ratio.verdict == "not measured" and ratio.what == name for ratio, name, _ in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
