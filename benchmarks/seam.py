"""What does the seam of a controller cost?  Run: python benchmarks/seam.py [--turns N].

A kinematic run of 500 ticks with the paper's servo, with ``examples/stop_and_go.py`` as an object in this
process, in a process of its own, and as a program that speaks JSON (the C++ example, built here).  They take
turns on one core; values are median (least to greatest).
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import read_scenario

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENARIO = Path(__file__).parents[1] / "scenarios" / "hand-visits-and-leaves.yaml"
TICKS, AIM = 500, 150.0


def sides(scenario: Scenario, folder: Path) -> dict[str, Admitted]:
    """The same scenario, by each controller."""
    sys.path.insert(0, str(EXAMPLES))
    from stop_and_go import StopAndGo

    found = {
        "visual servo, opposite pose": admit(replace(scenario, avoider="opposite pose")),
        "StopAndGo, an object in this process": admit(scenario, controller=StopAndGo()),
        "the same class in a process of its own": admit(
            replace(scenario, controller=f"{EXAMPLES / 'stop_and_go.py'}:StopAndGo", avoider="")
        ),
    }
    compiler = shutil.which("c++")
    if compiler:
        program, source = folder / "client", EXAMPLES / "controllers" / "stop_and_go.cpp"
        subprocess.run([compiler, "-O2", "-std=c++17", "-o", str(program), str(source)], check=True)
        found["the C++ program, JSON lines"] = admit(
            replace(scenario, controller=f"exec:{program}", avoider="")
        )
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=15)
    given = parser.parse_args()
    scenario = replace(read_scenario(SCENARIO), duration_s=0.008 * TICKS, claims=())
    with tempfile.TemporaryDirectory() as folder:
        each = sides(scenario, Path(folder))
        seconds: dict[str, list[float]] = {name: [] for name in each}
        for turn in range(given.turns + 1):
            for name, admitted in each.items():
                begun_s = time.perf_counter()
                trace = run_kinematic(admitted)
                took_s = time.perf_counter() - begun_s
                assert len(trace.ticks) == TICKS + 1
                if turn:  # the first is to warm up
                    seconds[name].append(took_s)
    inside = statistics.median(seconds["StopAndGo, an object in this process"])
    print(f"| controller | runs of {TICKS} ticks a second (aim {AIM:g}) | us a tick more than here |")
    print("|---|---|---|")
    for name, took in seconds.items():
        median = statistics.median(took)
        rates = f"{1 / median:.0f} ({1 / max(took):.0f} to {1 / min(took):.0f})"
        print(f"| {name} | {rates} | {(median - inside) / TICKS * 1e6:+.1f} |")


if __name__ == "__main__":
    main()
