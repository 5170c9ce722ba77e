"""Does multilevel splitting agree with brute force on the system itself?

Run: python benchmarks/rare_in_kinematic.py [--brute N] [--particles N] [--steps N] [--replications N].
The nominal space in the kinematic world with the opposite pose: how often a hand comes nearer than 50 mm, of
all runs, estimated from independent draws with the exact interval, and by splitting.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import time
from pathlib import Path

import numpy as np
from scipy import stats

from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space
from safety_harness.statistics.rare import Splitting, split
from safety_harness.statistics.sample import Floats

SPACE = Path(__file__).parents[1] / "scenarios" / "spaces" / "nominal.yaml"
CLAIM = "hand distance never below 50 mm"
BATCH = 64


class Margins:
    """Points (n, d) of the cube -> margins (n,) in the kinematic world, each run with a seed of its own."""

    def __init__(self, seed: int) -> None:
        space = read_space(SPACE)
        self.dimension = space.dimension
        self._trials = Trials(space, in_kinematic, seed, avoider="opposite pose", sentences=(CLAIM,))
        self._count = 0

    def __call__(self, points: Floats) -> Floats:
        """Infinite where a point is not admitted: no run, and so no violation."""
        found = []
        for first in range(0, len(points), BATCH):
            outcomes = self._trials(points[first : first + BATCH], self._count)
            refused = np.array([bool(why) for why in outcomes.refused])
            found.append(np.where(refused, np.inf, outcomes.margins[:, 0]))
            self._count += len(outcomes.margins)
        return np.concatenate(found)


def main() -> None:
    """Print both estimates."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--brute", type=int, default=4000)
    parser.add_argument("--particles", type=int, default=60)
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--replications", type=int, default=8)
    options = parser.parse_args()
    how = Splitting(particles=options.particles, steps=options.steps, replications=options.replications)
    start, margins = time.perf_counter(), Margins(seed=1)
    found = split(margins, margins.dimension, seed=1, how=how)
    print(
        f"splitting:   {found.value:.3%}, {found.low:.3%} to {found.high:.3%}, {found.evaluations:,} runs, "
        f"{found.reached} of {how.replications} replications found one, {time.perf_counter() - start:.0f} s"
    )
    print("  levels in mm: " + ", ".join(f"{1e3 * level:.0f}" for level in found.levels))
    start = time.perf_counter()
    drawn = np.random.Generator(np.random.PCG64(2)).random((options.brute, margins.dimension))
    violated = int(np.count_nonzero(Margins(seed=2)(drawn) < 0.0))
    exact = stats.binomtest(violated, options.brute).proportion_ci(0.95)
    print(
        f"brute force: {violated / options.brute:.3%}, {exact.low:.3%} to {exact.high:.3%}, "
        f"{options.brute:,} runs, {time.perf_counter() - start:.0f} s"
    )


if __name__ == "__main__":
    main()
