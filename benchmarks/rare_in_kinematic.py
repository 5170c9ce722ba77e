"""What rare violations cost by importance sampling, splitting and plain sampling, and do they agree: RARE.md.

Run: python benchmarks/rare_in_kinematic.py [--brute N] [--particles N] [--steps N] [--replications N].
The nominal space in the kinematic world with the opposite pose: how often a hand comes nearer than so many
millimetres, of all runs, from independent draws with the exact interval, and by the two ways of
``campaign rare``.  Of a distance below 0 the arm is as deep in the hand.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from scipy import stats

from safety_harness.extensions.assurance.statistics.importance import weigh
from safety_harness.extensions.assurance.statistics.rare import Splitting, split
from safety_harness.extensions.assurance.statistics.sample import Floats
from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name("RARE.md")
SPACE = ROOT / "scenarios" / "spaces" / "nominal.yaml"
CLAIM, CLAIMED_M = "hand distance never below 50 mm", 0.050
NEARER_M = (0.050, 0.020, -0.010, -0.040, -0.060)
BATCH = 64
COLUMNS = (
    *("nearer than", "by", "share", "runs", "processor"),
    *("as many plain runs say", "plain sampling over it"),
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


def rows(nearer_m: float, how: Splitting, plain: Floats, each_s: float) -> Iterator[str]:
    """Lines of the table: what each way says, and what plain sampling that says as much would have cost."""
    violated = int(np.count_nonzero(plain < nearer_m - CLAIMED_M))
    exact = stats.binomtest(violated, len(plain)).proportion_ci(0.95)
    words = f"{share(violated / len(plain))} ({share(exact.low)} to {share(exact.high)})"
    yield row(nearer_m, "plain draws", words, len(plain), len(plain) * each_s, len(plain), 1.0)
    for name, estimated in (("importance", weigh), ("splitting", partial(split, how=how))):
        begun_s, margins = time.process_time(), Margins(seed=1)
        found = estimated(partial(margins, nearer_m=nearer_m), margins.dimension, seed=1)
        seconds, many = time.process_time() - begun_s, found.as_many_draws
        words = f"{share(found.value)} ({share(found.low)} to {share(found.high)})"
        yield row(nearer_m, name, words, found.evaluations, seconds, many, many * each_s / seconds)


def row(nearer_m: float, by: str, found: str, runs: int, seconds: float, many: float, over: float) -> str:
    """One line."""
    cells = (
        f"{1e3 * nearer_m:.0f} mm",
        by,
        found,
        f"{runs:,}",
        f"{seconds:.0f} s",
        f"{many:,.0f}",
        f"{over:.1f}",
    )
    return f"| {' | '.join(cells)} |"


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
nominal space, kinematic world, with 95 % intervals. Importance sampling as `campaign rare` has it,
splitting with {how.replications} replications of {how.particles} particles and {how.steps} steps.
*As many plain runs say*: whose standard error is that of the replications; the last column is what
these would have cost over what it did, at {1e3 * each_s:.1f} ms of one processor a plain run. A bound of
1e-4 with 95 % confidence, by {bound:,.0f} plain runs without a violation, takes {bound * each_s:.0f} s.

| {" | ".join(COLUMNS)} |
{"|---" * len(COLUMNS)}|
"""
    for nearer_m in NEARER_M:
        for line in rows(nearer_m, how, plain, each_s):
            text += line + "\n"
            PAGE.write_text(text)
            print(line, flush=True)


if __name__ == "__main__":
    main()
