"""How many single decisions of the shipped networks are the same for every hand in a box: PROOF_DECISIONS.md.

Run: python benchmarks/proof_decisions.py (some minutes).  Questions are random, of what each network has
seen, with hands at 100 to 400 mm from the TCP.
"""

from __future__ import annotations

import subprocess
import time
from collections import Counter
from pathlib import Path

import numpy as np

from safety_harness.cell.avoidance.asking import Question
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import load_model
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.extensions.lab.proof.decisions import certified
from safety_harness.extensions.lab.proof.plan import seen_region
from safety_harness.trace.certified import Sameness

PAGE = Path(__file__).with_name("PROOF_DECISIONS.md")
ASKED, HALVES_M, NEAR_M, FAR_M = 200, (0.01, 0.03), 0.1, 0.4
KINDS = (Sameness.SAME, Sameness.OTHER, Sameness.UNDECIDED)
COLUMNS = ("network", "hand", *(kind.value for kind in KINDS), "median", "slowest")


def row(name: str, half_m: float) -> str:
    """A line of the table."""
    model, rng, found, took_ms = load_model(shipped_model(name)), np.random.default_rng(0), Counter(), []
    avoider, (low, high) = LearnedAvoider.from_model(model), seen_region(model.seen).corners()
    while len(took_ms) < ASKED:
        x = rng.uniform(low[0], high[0])
        if not NEAR_M <= np.linalg.norm(x[:3] - x[3:]) <= FAR_M:
            continue
        start_s = time.process_time()
        found[certified(avoider, Question(x[:3], x[3:], len(took_ms)), half_m).whole] += 1
        took_ms.append(1e3 * (time.process_time() - start_s))
    shares = (f"{found[kind] / ASKED:.1%}" for kind in KINDS)
    times = (f"{value:.0f} ms" for value in (np.median(took_ms), max(took_ms)))
    return f"| {' | '.join([name, f'+- {half_m * 1e3:g} mm', *shares, *times])} |"


def main() -> None:
    """Write the page."""
    git = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    root = PAGE.parents[1]
    revision = subprocess.run(git, capture_output=True, text=True, check=True, cwd=root).stdout.strip()
    for name in ("student", "mc-dropout"):
        row(name, HALVES_M[0])  # compiles before anything is timed
    lines = [
        "# Is a decision the same for every hand in a box?\n",
        f"Written by `python benchmarks/proof_decisions.py` at {revision}: {ASKED} random questions of what",
        "each network has seen, hands at 100 to 400 mm from the TCP, each with its own seed. The same is one",
        "that is certain for every hand or for none, and leads away from each or from none. Times are of one",
        "processor.\n",
        f"| {' | '.join(COLUMNS)} |",
        "|---" * len(COLUMNS) + "|",
    ]
    for name in SHIPPED:
        for half_m in HALVES_M:
            lines.append(row(name, half_m))
            print(lines[-1], flush=True)
    PAGE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
