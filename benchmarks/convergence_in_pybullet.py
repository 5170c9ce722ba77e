"""Does servoing converge on the PyBullet UR10, too?  200 random TCP starts, judged by pose.

    python benchmarks/convergence_in_pybullet.py [STARTS]

The whole loop: meshes, motors, physics, speed and acceleration limits; exact images; each run lasts 65 s of
simulated time, which is longer than the closed form needs from anywhere in the workspace.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from safety_harness import Scenario, Verdict, admit, run_trial
from safety_harness.claims.properties.servoing import Converged, GainSwitchReached
from safety_harness.claims.signals.poses import pose_errors
from safety_harness.scenario.model import OffsetStart

SEED = 20240612
HALF_BOX_M = (0.060, 0.150, 0.100)
DURATION_S = 65.0


def scenario(offset_m: tuple[float, float, float], tilt_rad: tuple[float, float, float]) -> Scenario:
    """Servoing alone, from an offset and a tilt."""
    return Scenario(
        name="start",
        title="a start",
        about="",
        duration_s=DURATION_S,
        seed=0,
        start=OffsetStart(offset_in_base_m=offset_m, tilt_in_tcp_rad=tilt_rad),
        hands=(),
        avoider="opposite pose",
        claims=(),
    )


def main() -> None:
    """Print one line a tilt: successes, and the largest final errors of those."""
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print(f"{starts} starts a row, seed {SEED}; converged: 1 mm and 0.1 deg after at most {DURATION_S:g} s")
    print("tilt  converged  violated  inconclusive  gain switch  worst mm  worst deg")
    for tilt_deg in (0.0, 3.0):
        rng = np.random.default_rng(SEED)
        counts = dict.fromkeys(Verdict, 0)
        switched, worst_m, worst_rad = 0, 0.0, 0.0
        for _ in range(starts):
            x, y, z = rng.uniform(-1.0, 1.0, 3) * HALF_BOX_M
            axis = rng.normal(size=3)
            a, b, c = np.radians(tilt_deg) * axis / np.linalg.norm(axis)
            trace = run_trial(admit(scenario((x, y, z), (a, b, c))))
            verdict = Converged().evaluate(trace).verdict
            counts[verdict] += 1
            switched += GainSwitchReached().evaluate(trace).verdict is Verdict.HOLDS
            if verdict is Verdict.HOLDS:
                position_m, angle_rad = pose_errors(replace(trace, ticks=trace.ticks[-1:]))
                worst_m, worst_rad = max(worst_m, position_m[-1]), max(worst_rad, angle_rad[-1])
        print(
            f"{tilt_deg:4.0f} {counts[Verdict.HOLDS]:10d} {counts[Verdict.VIOLATED]:9d} "
            f"{counts[Verdict.INCONCLUSIVE]:13d} {switched:12d} {worst_m * 1e3:9.3f} "
            f"{np.degrees(worst_rad):10.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
