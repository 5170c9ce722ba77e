"""Scenarios of logs: do they show again what happened?  Run: python benchmarks/from_logs.py: two tables.

The six recorded hands beside a simulated arm, as their scenarios place them, logged as a cell would: joints
at 125 Hz, off by up to 0.2 mrad, hands at 31 Hz, off by up to 2 mm, on a clock 137 ms ahead.  The claim is
that the hand comes no nearer than 60 mm more than it did, so that what happened is an incident.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "field" / "recorded"), str(ROOT / "benchmarks")]

from cells_made import write_log  # noqa: E402
from logs import RECORDINGS  # noqa: E402

from safety_harness.admission.admit import admit  # noqa: E402
from safety_harness.admission.trial import run_kinematic  # noqa: E402
from safety_harness.extensions.field.recorded.compare import compare_worlds  # noqa: E402
from safety_harness.extensions.field.recorded.scenario import Around, read_part, scenario_from, space_text  # noqa: E402
from safety_harness.extensions.field.recorded.words import estimate, shown  # noqa: E402
from safety_harness.scenario.read import read_scenario  # noqa: E402
from safety_harness.search.cube import Cube  # noqa: E402
from safety_harness.search.default import Default  # noqa: E402
from safety_harness.search.search import find_violations  # noqa: E402
from safety_harness.search.trials import Trials, in_kinematic  # noqa: E402
from safety_harness.space.read import parse_space  # noqa: E402

NEARER_M = 0.06
AROUND = Around(shift_m=0.1, speeds=(0.8, 1.25))


def main(budget: int, folder: Path) -> None:
    """Both tables."""
    rows: list[str] = []
    heads = "scenario | world | joints, largest | TCP, largest | delay | least distance | of the log"
    print(f"| {heads} | recorded | here |\n{'|---' * 9}|")
    for seed, name in enumerate(RECORDINGS):
        cell = read_scenario(ROOT / "scenarios" / f"{name}.yaml")
        trace = run_kinematic(admit(cell))
        least_m = float(trace.ticks["hand_distance_m"][:, : len(cell.hands)].min())
        claim = f"hand distance never below {(least_m + NEARER_M) * 1e3:.0f} mm: violated"
        rng = np.random.default_rng(seed)
        log = write_log(
            trace, folder / name, claim, every=4, noise=rng, joints_mrad=0.2, hands_mm=2.0, gap_ms=100
        )
        made = scenario_from(read_part(log), cell)
        for world in compare_worlds(made).worlds:
            assert world.tcp is not None
            late = world.fit and world.fit.late
            (one,) = world.claims
            near = min(world.closest, key=lambda one: one.simulated_m)
            bounds = f"{shown(near.recorded_least_m or 0.0, 'm')} to {shown(near.recorded_most_m, 'm')}"
            joint = max(world.joints, key=lambda one: one.largest)
            cells = (
                *(name, world.world, f"{shown(joint.largest, 'rad')} at {joint.at_s:.2f} s"),
                *(shown(world.tcp.largest, "m"), estimate(late, "s") if late else "not shown"),
                *(shown(near.simulated_m, "m"), bounds),
                *(one.recorded.value, one.simulated.value),
            )
            print(f"| {' | '.join(cells)} |", flush=True)
        space = parse_space(
            space_text(made, AROUND, named=name), None, {h.hand.motion.sha256: h.data for h in made.hands}
        )
        trials, cube = Trials(space, in_kinematic, seed=0), Cube.of(space)
        searcher = Default(cube, claims=len(trials.goals), seed=0)
        found = find_violations(cube, trials.goals, trials, searcher, budget=budget)
        margins = [group.worst_margin() for group in found.groups]
        worst = shown(min(margins), "m") if margins else "-"
        refused = sum(found.refused.values())
        rows.append(f"| {name} | {found.tried} | {refused} | {int(found.violated[0])} | {worst} |")
    print("\n| space around | tried | refused | violated | worst margin |\n|---|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=60)
    with tempfile.TemporaryDirectory() as folder:
        main(parser.parse_args().budget, Path(folder))
