"""What ``prove`` proves of the students, and whether the checker refuses altered certificates.

Run: python benchmarks/proof.py [MINUTES a claim] (a quarter of an hour of processor time): PROOF.md.

Each claim is worked on alone, in one process.  Where ``leads away`` is false is told by the angle from the
optimum's way to that of the hand, of random pairs at 100 to 400 mm.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.candidates import continuous_optimum
from safety_harness.extensions.lab.proof.certificate import write_certificate
from safety_harness.extensions.lab.proof.check import check
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim
from safety_harness.extensions.lab.proof.plan import ProofPlan, ProofRegion, read_proof_plan
from safety_harness.extensions.lab.proof.session import fresh
from safety_harness.extensions.lab.proof.tree import work

ROOT = Path(__file__).parents[1]
PLANS, PAGE = ("student-proofs", "student-ensemble-proofs"), Path(__file__).with_name("PROOF.md")
AT_ONCE = 500_000
PAIRS, ANGLES = 1_000_000, (0.0, 60.0, 75.0, 90.0, 120.0, 180.0)
COLUMNS = (
    *("claim", "region", "proven", "refuted", "undecided"),
    *("took", "boxes", "check"),
)
Floats = NDArray[np.float64]


def time_is_up(end_s: float) -> bool:
    """Of the processor's time, since others use the machine too."""
    return time.process_time() > end_s


def rows(plan: ProofPlan, seconds: float) -> Iterator[str]:
    """A table with a line for each claim."""
    network, doubt_m, first = plan.network, plan.doubt_m, fresh(plan)[0]
    work(first.tree, network, first.planned.claim, first.planned.region, halvings=1, until_s=np.inf)
    yield from ("", f"## {plan.avoider}\n", f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|")
    for proof in fresh(plan):
        claim, region = proof.planned.claim, proof.planned.region
        start_s = time.process_time()
        out_of_time = partial(time_is_up, start_s + seconds)
        work(
            *(proof.tree, network, claim, region),
            halvings=40,
            doubt_m=doubt_m,
            until_s=np.inf,
            stopped=out_of_time,
        )
        took_s = time.process_time() - start_s
        proven, refuted, undecided = proof.least_shares
        path = Path("/tmp") / "benchmark-certificate.json"
        write_certificate(path, plan, [proof])
        start_s = time.process_time()
        check(path.read_bytes(), plan.model_file.read_bytes())
        check_s = time.process_time() - start_s
        cells = (
            *(claim.sentence, region.name, f"{proven:.4%}", f"{refuted:.4%}", f"{undecided:.4%}"),
            *(f"{took_s:.1f} s", f"{sum(map(len, proof.tree.levels)):,}", f"{check_s:.0f} s"),
        )
        yield f"| {' | '.join(cells)} |"


def where(plan: ProofPlan, near: ProofRegion) -> Iterator[str]:
    """A line of the table of angles, and the shares of regions, of PAIRS near hands."""
    rng, avoider = np.random.default_rng(1), plan.asked
    low, high = near.corners()
    x, (near_m, far_m) = np.empty((0, 6)), near.apart_m
    while len(x) < PAIRS:
        more = rng.uniform(low, high, (AT_ONCE, 6))
        apart_m = np.linalg.norm(more[:, :3] - more[:, 3:], axis=1)
        x = np.concatenate([x, more[(apart_m >= near_m) & (apart_m <= far_m)]])
    hands, tcps = x[:PAIRS, :3], x[:PAIRS, 3:]
    answers, _ = avoider.propose_many(hands, tcps, np.zeros(PAIRS, np.uint64))
    away = DecisionClaim(ClaimKind.AWAY, 0.0)
    best = continuous_optimum(DEFAULTS, tcps)
    pulled = best + DEFAULTS.avoidance.hand_pull * (tcps - hands)
    wrong_of = {"student": away.margins(hands, tcps, answers), "optimum": away.margins(hands, tcps, pulled)}
    false = {name: margins < 0.0 for name, margins in wrong_of.items()}
    way, hand = best - tcps, hands - tcps
    cosine = (way * hand).sum(axis=1) / np.linalg.norm(way, axis=1) / np.linalg.norm(hand, axis=1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    yield from ("", f"## Where `leads away` is false\n\nOf {PAIRS:,} random pairs at 100 to 400 mm from each")
    yield "other, by the angle between the optimum's way and that to the hand.\n"
    yield "| angle | of the pairs | the student's answer is false | and the optimum's |\n|---|---|---|---|"
    for start, end in (*pairwise(ANGLES), (0.0, 180.0)):
        inside = (angle >= start) & (angle <= end)
        shares = (f"{false[name][inside].mean():.3%}" for name in ("student", "optimum"))
        yield f"| {start:.0f} to {end:.0f} degrees | {inside.mean():.2%} | {' | '.join(shares)} |"
    yield ""
    for region in {one.planned.region.name: one.planned.region for one in fresh(plan)}.values():
        low, high = region.corners()
        inside = ((x[:PAIRS] >= low) & (x[:PAIRS] <= high)).all(axis=1)
        if region.apart_m == near.apart_m:
            yield f"- *{region.name}* has {inside.mean():.2%} of them."


def refused() -> str:
    """Of how many altered certificates the checker refuses each: its own test, the long one."""
    test = "tests/lab/proof/test_certificate.py::test_a_thousand_altered_certificates_are_refused"
    start_s = time.monotonic()
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-m", "long", test], cwd=ROOT, capture_output=True, text=True
    )
    if ran.returncode not in (0, 1):
        raise RuntimeError(ran.stdout)
    came = "all" if ran.returncode == 0 else "NOT ALL"
    took_s = time.monotonic() - start_s
    return f"The checker refused {came} of 1,000 certificates that claim something false ({took_s:.0f} s)."


def main() -> None:
    """Write the page."""
    seconds = 60.0 * float(sys.argv[1]) if len(sys.argv) > 1 else 21.0
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.strip()
    lines = [
        "# What is proven of the students\n",
        f"Written by `python benchmarks/proof.py` at {revision}: the plans `student-proofs` and",
        f"`student-ensemble-proofs`, one process, at most {seconds:.0f} s of processor time a claim.",
        "Proven is at least, undecided at most, of the pairs that the claim is about.",
    ]
    plans = [read_proof_plan(ROOT / "plans" / f"{name}.yaml") for name in PLANS]
    near = next(one.region for one in plans[0].proofs if one.region.name == "near hands")
    for row in chain(*(rows(plan, seconds) for plan in plans), where(plans[0], near)):
        print(row, flush=True)
        lines.append(row)
    PAGE.write_text("\n".join(lines) + "\n")
    lines += ["", "## Altered certificates", "", refused()]
    PAGE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
