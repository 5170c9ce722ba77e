"""Is a bound an hour above the true rate as often as it says?  Run: python benchmarks/rates.py [--times N].

Whole shifts with a known rate of violations (``tests/assurance/statistics/whole_shifts.py``), a thousand
simulations
of each kind, with the formula of the evidence report and with two wrong ones.  Writes benchmarks/RATES.md;
the exit code is 1 if ours covers less often than it says, or if no kind of shift shows a wrong one.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "assurance" / "statistics"))
sys.path.insert(0, str(Path(__file__).parents[1]))

from whole_shifts import BURSTS, CONFIDENCE, EVERY, ours, point_by_point, rate_as_counted

OUT = Path(__file__).with_name("RATES.md")
FORMULAS = (ours, point_by_point, rate_as_counted)


def main() -> int:
    """Measure, write, judge."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--times", type=int, default=1000)
    times = parser.parse_args().times
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True, cwd=OUT.parent
    ).stdout.strip()
    lines = [
        "# Bounds an hour in whole shifts",
        "",
        f"Written by `make bench-rates` at {revision}: {times} simulations of each kind of shift, and how",
        f"often the bound is not below the true rate, with {CONFIDENCE:.0%} confidence stated.",
        "",
        "| shifts | true rate, an hour | met in 1,000 other shifts | the report's bound | point by point "
        "| rate without its uncertainty |",
        "|---|---|---|---|---|---|",
    ]
    found = []
    for kind in (*EVERY, BURSTS):
        shares = [kind.coverage(formula, times, seed=5) for formula in FORMULAS]
        met = kind.met(1000, np.random.default_rng(6))
        covered = " | ".join(f"{share:.1%}" for share in shares)
        lines.append(f"| {kind.name} | {kind.truth:.4g} | {met:.4g} | {covered} |")
        print(lines[-1], flush=True)
        found.append(shares)
    lines += [
        "",
        "The last line is what the report takes for granted that there is not: approaches in bursts.",
        "",
    ]
    OUT.write_text("\n".join(lines))
    kept = all(shares[0] >= CONFIDENCE for shares in found[: len(EVERY)])
    seen = all(min(shares[k] for shares in found) < CONFIDENCE for k in (1, 2))
    return 0 if kept and seen else 1


if __name__ == "__main__":
    sys.exit(main())
