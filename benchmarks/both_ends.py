"""What judging distances by both ends costs: microseconds of the processor, the least of several turns.

Run it in two checkouts by turns (``python benchmarks/both_ends.py``) and compare: benchmarks/BOTH_ENDS.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from safety_harness import admit, read_scenario, run_trial
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import always, hand_distance, mm
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.clear_ways import ClearWays
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.touching import NoMovingPartTouches

SCENARIOS = ("hand-visits-and-leaves", "hesitating-reach", "another-object-elsewhere")


def least_s(work: Callable[[], object], turns: int) -> float:
    """The least time of the processor [s] that ``work`` took in so many turns, after one more."""
    work()
    found = []
    for _ in range(turns):
        begun = time.process_time()
        work()
        found.append(time.process_time() - begun)
    return min(found)


def main() -> None:
    """Print a line for each of what is timed."""
    folder = Path(__file__).parents[1] / "scenarios"
    admitted = [admit(read_scenario(folder / f"{name}.yaml")) for name in SCENARIOS]
    traces = [run_trial(one, world=KINEMATIC) for one in admitted]
    claims: dict[str, Property] = {
        "hand distance": HandDistance(minimum_m=0.05, near_m=0.4),
        "no moving part touches": NoMovingPartTouches(near_m=0.4),
        "repulsive ways": ClearWays(),
        "always hand distance > 50 mm": FormulaClaim(always(hand_distance() > mm(50))),
    }
    for name, claim in claims.items():

        def judge(claim: Property = claim) -> None:
            for trace in traces:
                claim.evaluate(replace(trace))  # a copy: nothing of it is known yet

        print(f"{name}: {1e6 * least_s(judge, 20) / len(traces):.0f} us a trace")

    def beside() -> None:
        for trace in traces:
            limit_m = float(trace.ticks["hand_distance_m"].min()) - 2e-4
            HandDistance(minimum_m=limit_m, near_m=1.0).evaluate(replace(trace))

    print(f"hand distance, 0.2 mm above its limit: {1e6 * least_s(beside, 20) / len(traces):.0f} us a trace")
    for world in (PYBULLET, KINEMATIC):

        def run(world: WorldEntry = world) -> None:
            run_trial(admitted[1], world=world)

        print(f"{world}: {1e6 * least_s(run, 3) / admitted[1].scenario.ticks:.1f} us a tick")


if __name__ == "__main__":
    main()
