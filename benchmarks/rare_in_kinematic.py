"""What splitting costs beside plain sampling on the system itself, and whether they agree: RARE.md.

Run: python benchmarks/rare_in_kinematic.py [--brute N] [--particles N] [--steps N] [--replications N].
The nominal space in the kinematic world with the opposite pose: how often a hand comes nearer than so many
millimetres, of all runs, from independent draws with the exact interval, and by splitting.  Of a distance
below 0 the arm is as deep in the hand.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
import time
from functools import partial
from pathlib import Path

import numpy as np
from scipy import stats

from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space
from safety_harness.statistics.rare import RareEstimate, Splitting, split
from safety_harness.statistics.sample import Floats

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name("RARE.md")
SPACE = ROOT / "scenarios" / "spaces" / "nominal.yaml"
CLAIM, CLAIMED_M = "hand distance never below 50 mm", 0.050
NEARER_M = (0.050, 0.020, -0.010, -0.040, -0.060)
BATCH = 64
COLUMNS = (
    *("nearer than", "share, by splitting", "runs", "processor", "plain sampling"),
    *("as many plain runs say", "plain over splitting"),
)


class Margins:
    """Points (n, d) of the cube -> margins (n,) in the kinematic world, each run with a seed of its own."""

    def __init__(self, seed: int) -> None:
        space = read_space(SPACE)
        self.dimension = space.dimension
        self._trials = Trials(space, in_kinematic, seed, avoider="opposite pose", sentences=(CLAIM,))
        self._count = 0

    def __call__(self, points: Floats, nearer_m: float = CLAIMED_M) -> Floats:
        """Infinite where a point is not admitted: no run, and so no violation."""
        found = []
        for first in range(0, len(points), BATCH):
            outcomes = self._trials(points[first : first + BATCH], self._count)
            refused = np.array([bool(why) for why in outcomes.refused])
            found.append(np.where(refused, np.inf, outcomes.margins[:, 0]))
            self._count += len(outcomes.margins)
        return np.concatenate(found) + CLAIMED_M - nearer_m


def share(p: float) -> str:
    """A probability as people read it."""
    return f"{p:.2%}".replace("%", " %") if p >= 1e-3 else f"{p:.1e}" if p else "0"


def of_splitting(nearer_m: float, how: Splitting, plain: Floats, each_s: float) -> str:
    """A line of the table: what splitting says, what plain sampling does, and what that would have cost."""
    begun_s, margins = time.process_time(), Margins(seed=1)
    found = split(partial(margins, nearer_m=nearer_m), margins.dimension, seed=1, how=how)
    seconds = time.process_time() - begun_s
    violated = int(np.count_nonzero(plain < nearer_m - CLAIMED_M))
    exact = stats.binomtest(violated, len(plain)).proportion_ci(0.95)
    many = as_many(found)
    cells = [
        f"{1e3 * nearer_m:.0f} mm",
        f"{share(found.value)} ({share(found.low)} to {share(found.high)})",
        f"{found.evaluations:,}",
        f"{seconds:.0f} s",
        f"{violated} of {len(plain):,} ({share(exact.low)} to {share(exact.high)})",
        f"{many:,.0f}",
        f"{many * each_s / seconds:.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def as_many(found: RareEstimate) -> float:
    """Independent runs with the standard error of these replications; NaN if all say the same."""
    mean, spread = float(np.mean(found.replicates)), float(np.var(found.replicates, ddof=1))
    return mean * (1.0 - mean) * len(found.replicates) / spread if spread > 0.0 else np.nan


def main() -> None:
    """Write both estimates for each distance."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--brute", type=int, default=100_000)
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--replications", type=int, default=10)
    options = parser.parse_args()
    how = Splitting(particles=options.particles, steps=options.steps, replications=options.replications)
    begun_s, margins = time.process_time(), Margins(seed=2)
    points = np.random.Generator(np.random.PCG64(2)).random((options.brute, margins.dimension))
    plain = margins(points)
    each_s = (time.process_time() - begun_s) / options.brute
    git = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    revision = subprocess.run(git, capture_output=True, text=True).stdout.strip()
    bound = np.log(0.05) / np.log1p(-1e-4)
    text = f"""# Rare violations

Written by `python benchmarks/rare_in_kinematic.py` at {revision}: the opposite pose in the
nominal space, kinematic world. Splitting with {how.replications} replications of
{how.particles} particles and {how.steps} steps; intervals at 95 %. *As many plain runs say*: whose
standard error is that of the replications; the last column is what these would have cost over what
splitting did, at {1e3 * each_s:.1f} ms of one processor a plain run. A bound of 1e-4 with 95 %
confidence, by {bound:,.0f} plain runs without a violation, takes {bound * each_s:.0f} s.

| {" | ".join(COLUMNS)} |
{"|---" * len(COLUMNS)}|
"""
    for nearer_m in NEARER_M:
        text += of_splitting(nearer_m, how, plain, each_s) + "\n"
        PAGE.write_text(text)
        print(text.splitlines()[-1], flush=True)


if __name__ == "__main__":
    main()
