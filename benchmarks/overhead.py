"""What does a search cost around its episodes, here, in psy-taliro and in VerifAI?

Run: python benchmarks/overhead.py [--psy-taliro PYTHON] [--verifai PYTHON].
The simulator is trivial (the sum of the inputs), the space a box of 17 coordinates, sampling uniform, one
process: what is left is the tool's own.  Theirs need libraries that exclude ours, so each runs in an
environment of its own, by default .venv-psy-taliro and .venv-verifai (make others); one that is not there
is left out, in words.  All take turns, so that a busy machine slows all of them.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
from ratios import Ratio

from safety_harness.search.cube import Column, Cube
from safety_harness.search.findings import Goal, Outcomes
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import searcher_named

ROOT = Path(__file__).parents[1]
THEIRS = Path(__file__).parent / "overhead_of_others.py"
DIMENSIONS, EPISODES, TURNS = 17, 2_000, 5
BATCH = 64
TOOLS = ("psy-taliro", "verifai")


def ours_us(seed: int) -> float:
    """Microseconds an episode."""
    cube = Cube(tuple(Column() for _ in range(DIMENSIONS)))

    def evaluate(points: np.ndarray, first: int) -> Outcomes:
        return Outcomes.of_margins(points.sum(axis=1, keepdims=True))

    searcher = searcher_named("uniform")(cube, claims=1, seed=seed)
    begun_s = time.perf_counter()
    find_violations(cube, [Goal("sum", scale=1.0)], evaluate, searcher, budget=EPISODES, batch=BATCH)
    return (time.perf_counter() - begun_s) / EPISODES * 1e6


def theirs_us(python: Path, tool: str, seed: int) -> float:
    """The same, in an interpreter that has the tool; its start and imports are not counted."""
    command = [str(python), str(THEIRS), tool, str(DIMENSIONS), str(EPISODES), str(seed + 1)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-1])


def measured(pythons: dict[str, Path]) -> dict[str, list[float]]:
    """Microseconds an episode of each tool that is there, a value a turn."""
    ours_us(0)
    found: dict[str, list[float]] = {"ours": []} | {tool: [] for tool in pythons}
    for turn in range(TURNS):
        found["ours"].append(ours_us(turn))
        for tool, python in pythons.items():
            found[tool].append(theirs_us(python, tool, turn))
    return found


def installed() -> dict[str, Path]:
    """Where the others are, as ``make others`` puts them."""
    pythons = {tool: ROOT / f".venv-{tool}" / "bin" / "python" for tool in TOOLS}
    return {tool: python for tool, python in pythons.items() if python.exists()}


def ratios(pythons: dict[str, Path] | None = None) -> list[Ratio]:
    """Their overhead over ours."""
    pythons = installed() if pythons is None else pythons
    found = measured(pythons)
    rows = []
    for tool in TOOLS:
        what = f"overhead of an episode: {tool} over ours"
        if tool not in found:
            rows.append(Ratio.missing(what, "not installed (make others)"))
            continue
        each = [a / b for a, b in zip(found[tool], found["ours"], strict=True)]
        us = f"{median(found[tool]):.0f} us, ours {median(found['ours']):.1f} us"
        rows.append(Ratio.of(what, each, note=us))
    return rows


def main() -> None:
    """Print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    for tool in TOOLS:
        parser.add_argument(f"--{tool}", type=Path, default=installed().get(tool))
    given = vars(parser.parse_args())
    pythons = {tool: python for tool in TOOLS if (python := given[tool.replace("-", "_")]) is not None}
    for row in ratios(pythons):
        sys.stdout.write(f"{row}\n")


if __name__ == "__main__":
    main()
