"""How many episodes does each searcher need to find a planted bug, beside uniform sampling?

Run: python benchmarks/search_power.py [--budget N] [--seeds N] [--batch N] [--searcher NAME]...
[--out FILE.json].
Every searcher has the same budget, the same bugs (tests/search/planted.py) and seeds 0 to N - 1.  A run
that finds nothing counts: the median is over all runs, and said to be above the budget where half of them
or more find nothing.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.search.search import find_violations
from safety_harness.search.searchers import SEARCHERS, MakesSearcher
from tests.search.planted import BUGS, BY_LOT, CUBE, FRESH, GOALS, SPACE, Bug, share_violated, world


def episodes_needed(make: MakesSearcher, bug: Bug, seed: int, budget: int, batch: int) -> int:
    """Episodes up to the first violation of the spoilt claim; budget + 1 for a run without one."""
    searcher = make(CUBE, claims=len(GOALS), seed=seed)
    findings = find_violations(
        CUBE,
        GOALS,
        world(bug),
        searcher,
        budget=budget,
        batch=batch,
        enough=lambda findings: bool(findings.violated[0]),
    )
    return int(findings.first_violation[0]) or budget + 1


def main() -> None:
    """Print a row for each bug and a column for each searcher."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--budget", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--searcher", action="append", choices=[make.name for make in SEARCHERS])
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    makers = [make for make in SEARCHERS if not options.searcher or make.name in options.searcher]
    print(f"episodes to the first violation, median of {options.seeds} seeds (runs that found nothing)")
    print(f"budget {options.budget:,}, batches of {options.batch}, {SPACE.dimension} coordinates")
    print(f"{'bug':<19} {'share':>8}" + "".join(f" {make.name:>16}" for make in makers))
    needed: dict[str, dict[str, list[int]]] = {}
    spent_s = dict.fromkeys((make.name for make in makers), 0.0)
    for bug in BUGS + BY_LOT + FRESH:
        row = needed.setdefault(bug.__name__, {})
        cells = []
        for make in makers:
            begin_s = time.perf_counter()
            row[make.name] = [
                episodes_needed(make, bug, seed, options.budget, options.batch)
                for seed in range(options.seeds)
            ]
            spent_s[make.name] += time.perf_counter() - begin_s
            median, missed = np.median(row[make.name]), sum(n > options.budget for n in row[make.name])
            shown = f"{median:,.0f}" if median <= options.budget else f"> {options.budget:,}"
            cells.append(f" {shown:>11} ({missed:>2})")
        print(f"{bug.__name__:<19} {share_violated(bug):>8.1e}" + "".join(cells), flush=True)
    total = {make.name: sum(map(sum, (row[make.name] for row in needed.values()))) for make in makers}
    print(f"{'us an episode':<28}" + "".join(f" {spent_s[n] / total[n] * 1e6:>16.0f}" for n in total))
    if options.out is not None:
        options.out.write_text(json.dumps(needed, indent=1))


if __name__ == "__main__":
    main()
