"""What ``prove`` proves of the student, and whether questions of the real network contradict it.

Run: python benchmarks/proof.py [MINUTES] (a quarter of an hour, with 1 a claim); it writes PROOF.md.

Each claim is worked on alone, in one process.  Then the network is asked random questions of proven boxes,
and those in the corners to which its own gradient points: is any box proven wrongly?
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.learned import LearnedAvoider
from safety_harness.avoidance.perceptron_kernel import fold_perceptron
from safety_harness.proof.box_kernel import PROVEN
from safety_harness.proof.certificate import Proof, write_certificate
from safety_harness.proof.check import check
from safety_harness.proof.plan import ProofPlan, read_proof_plan
from safety_harness.proof.session import fresh
from safety_harness.proof.tree import halves, work

ROOT = Path(__file__).parents[1]
PLAN, PAGE = ROOT / "plans" / "student-proofs.yaml", Path(__file__).with_name("PROOF.md")
RANDOM, GUIDED, STEPS, AT_ONCE = 20_000_000, 250_000, 4, 500_000  # questions a claim; 4 steps each
COLUMNS = (
    *("claim", "region", "proven", "refuted", "undecided"),
    *("took", "boxes", "check", "asked", "contradict", "margin"),
)
Floats = NDArray[np.float64]


def codes_of(proof: Proof, asked: Floats) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """The leaves (low, high, code) that hold the questions (n, 6)."""
    low, high = proof.planned.region.corners()
    box = np.zeros(len(asked), np.int64)
    lows, highs, found = asked.copy(), asked.copy(), np.zeros(len(asked), np.uint8)
    open_ = np.arange(len(asked))
    for codes in proof.tree.levels:
        here = codes[box[open_]]
        done = here >= PROVEN
        rows = open_[done]
        lows[rows], highs[rows], found[rows] = low[box[rows]], high[box[rows]], here[done]
        open_, axes = open_[~done], here[~done]
        middle = (low[box[open_], axes] + high[box[open_], axes]) / 2.0
        place = (np.cumsum(codes < PROVEN) - 1)[box[open_]]
        box[open_] = 2 * place + (asked[open_, axes] > middle)
        low, high = halves(low, high, codes)
    return lows, highs, found


def wrong(proof: Proof, avoider: LearnedAvoider, asked: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Margins (n,) of questions (n, 6), and which are apart as the claim says."""
    hands, tcps = asked[:, :3], asked[:, 3:]
    answers, _ = avoider.propose_many(hands, tcps, np.zeros(len(asked), np.uint64))
    apart_m, (near_m, far_m) = np.linalg.norm(hands - tcps, axis=1), proof.planned.region.apart_m
    return proof.planned.claim.margins(hands, tcps, answers), (apart_m >= near_m) & (apart_m <= far_m)


def tried(proof: Proof, avoider: LearnedAvoider, rng: np.random.Generator) -> tuple[int, int, float, int]:
    """Random questions in proven boxes, guided ones, the least margin of both, and how many contradict."""
    low, high = proof.planned.region.corners()
    asked = guided = against = 0
    least = np.inf
    for _ in range(RANDOM // AT_ONCE):
        x = rng.uniform(low, high, (AT_ONCE, 6))
        lows, highs, codes = codes_of(proof, x)
        margins, counted = wrong(proof, avoider, x)
        proven = (codes == PROVEN) & counted
        asked += int(proven.sum())
        against += int((margins[proven] < 0.0).sum())
        least = min(least, float(margins[proven].min(initial=np.inf)))
        if guided >= GUIDED * STEPS:
            continue
        x, lows, highs = x[codes == PROVEN], lows[codes == PROVEN], highs[codes == PROVEN]
        for _ in range(STEPS):  # to the corner that the gradient points to, then from there
            slope = np.empty_like(x)
            margins, _ = wrong(proof, avoider, x)
            for axis in range(6):
                moved = x.copy()
                moved[:, axis] += 1e-7
                slope[:, axis] = wrong(proof, avoider, moved)[0] - margins
            x = np.where(slope > 0.0, lows, highs)
            margins, counted = wrong(proof, avoider, x)
            guided += len(x)
            against += int((margins[counted] < 0.0).sum())
            least = min(least, float(margins[counted].min(initial=np.inf)))
    return asked, guided, least, against


def rows(plan: ProofPlan, seconds: float) -> Iterator[str]:
    """A line of the table for each claim."""
    network, avoider = fold_perceptron(plan.model), LearnedAvoider.of(plan.model)
    rng, first = np.random.default_rng(0), fresh(plan)[0]
    work(first.tree, network, first.planned.claim, first.planned.region, halvings=1, until_s=np.inf)
    for proof in fresh(plan):
        claim, region = proof.planned.claim, proof.planned.region
        start_s = time.monotonic()
        work(proof.tree, network, claim, region, halvings=32, until_s=start_s + seconds)
        took_s = time.monotonic() - start_s
        proven, refuted, undecided = proof.least_shares
        path = Path("/tmp") / "benchmark-certificate.json"
        write_certificate(path, plan, [proof])
        start_s = time.monotonic()
        check(path.read_bytes(), plan.model_file.read_bytes())
        check_s = time.monotonic() - start_s
        asked, guided, least, against = tried(proof, avoider, rng)
        unit = "m2" if claim.sentence == "leads away" else "m"
        cells = (
            *(claim.sentence, region.name, f"{proven:.4%}", f"{refuted:.4%}", f"{undecided:.4%}"),
            *(f"{took_s:.1f} s", f"{sum(map(len, proof.tree.levels)):,}", f"{check_s:.0f} s"),
            *(f"{asked:,} + {guided:,}", str(against), f"{least:.1e} {unit}"),
        )
        yield f"| {' | '.join(cells)} |"


def main() -> None:
    """Write the page."""
    seconds = 60.0 * float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.strip()
    lines = [
        "# What is proven of the student\n",
        f"Written by `python benchmarks/proof.py` at {revision}: `plans/student-proofs.yaml`, one process,",
        f"at most {seconds:.0f} s a claim, on a machine with two cores that others used too. Proven is",
        "at least, undecided at most, of the pairs that the claim is about. Asked are random questions",
        "within proven boxes, and those in the corners to which its gradient points; none may contradict.\n",
        f"| {' | '.join(COLUMNS)} |",
        "|---" * len(COLUMNS) + "|",
    ]
    for row in rows(read_proof_plan(PLAN), seconds):
        print(row, flush=True)
        lines.append(row)
    PAGE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
