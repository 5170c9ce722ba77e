"""How much longer than chance does a search need for what no margin leads to?

Run: python benchmarks/flat_bugs.py [--searcher NAME] [--seeds N] [--budget N].
A hundred boxes by lot, in two to four of the coordinates of tests/search/planted.py, each with a share of at
most 5e-4.  One claim is the same everywhere, so that what is proposed does not depend on the box, and one
sequence of points is looked at for all of them; the other claim has slopes and is never violated.  Chance
needs ln 2 over the share in half of the runs; printed is the median over that, geometric mean over boxes.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.search.cube import Points
from safety_harness.search.search import AskTell
from safety_harness.search.searchers import searcher_named
from tests.search.planted import CUBE, GOALS, SPACE, Encounter

BOXES = range(2001, 2201, 2)
BATCH = 16
Box = tuple[Points, Points, float]  # which coordinates, the middle, half the length


def box(number: int) -> Box:
    """By lot, as tests/search/planted.py draws them."""
    rng = np.random.default_rng(number)
    always_used = np.flatnonzero(CUBE.used(np.zeros((1, CUBE.dimension)))[0])
    free = np.setdiff1d(always_used, CUBE.flat_columns)
    columns = rng.choice(free, size=rng.integers(2, 5), replace=False)
    return columns, rng.random(len(columns)), 0.5 * 5e-4 ** (1.0 / len(columns))


def share(one: Box) -> float:
    """Its volume within the cube."""
    _, middle, half = one
    return float(np.prod(np.minimum(middle + half, 1.0) - np.maximum(middle - half, 0.0)))


def proposed(name: str, seed: int, budget: int) -> Points:
    """(n, 17) canonical points, where the first claim tells nothing."""
    search = AskTell(searcher_named(name)(CUBE, claims=len(GOALS), seed=seed), CUBE.dimension, len(GOALS))
    found: list[Points] = []
    while sum(map(len, found)) < budget:
        points = search.ask(BATCH)
        offset = Encounter(SPACE.values_at(points)).of("tcp start.offset")
        held = (0.05 + 0.1 * offset[:, 0]) / GOALS[1].scale
        search.tell(np.column_stack([np.ones(len(points)), held]))
        found.append(CUBE.canonical(points))
    return np.concatenate(found)


def main() -> None:
    """Print a line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--searcher", default="default")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--budget", type=int, default=8000)
    options = parser.parse_args()
    boxes = [box(number) for number in BOXES]
    needed = np.zeros((len(boxes), options.seeds))
    for seed in range(options.seeds):
        points = proposed(options.searcher, seed, options.budget)
        for k, (columns, middle, half) in enumerate(boxes):
            hits = np.flatnonzero(np.abs(points[:, columns] - middle).max(axis=1) < half)
            needed[k, seed] = hits[0] + 1 if len(hits) else options.budget + 1
    chance = np.log(2.0) / np.array([share(one) for one in boxes])
    ratios = np.median(needed, axis=1) / chance
    print(
        f"{options.searcher}: {np.exp(np.mean(np.log(ratios))):.2f} times as many runs as chance; "
        f"{np.mean(needed > options.budget):.1%} of the runs found nothing within {options.budget:,}"
    )


if __name__ == "__main__":
    main()
