"""Does any of 1e8 random questions, or of 1e6 to which the gradient points, contradict a proven box?

Run: python benchmarks/proof_questions.py [FOLDER] [--table] (an hour of processor time).

FOLDER, or reports/proof-questions, keeps the certificate of the first start, and counts.json after each
batch: started again, it goes on.
``--table`` only writes PROOF_QUESTIONS.md from the counts so far, which the end does as well.  A question is
random within a box that is random among the proven ones of its claim, by volume; the guided ones are the
corner of its box to which the gradient of the claim's margin points, and from there the next, four times.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.whole_file import write_text
from safety_harness.extensions.lab.proof.box_kernel import PROVEN
from safety_harness.extensions.lab.proof.certificate import Proof, taken_up, write_certificate
from safety_harness.extensions.lab.proof.plan import ProofPlan, read_proof_plan
from safety_harness.extensions.lab.proof.session import fresh
from safety_harness.extensions.lab.proof.tree import work

ROOT = Path(__file__).parents[1]
PLAN, PAGE = ROOT / "plans" / "student-proofs.yaml", Path(__file__).with_name("PROOF_QUESTIONS.md")
RANDOM, GUIDED = 100_000_000, 1_000_000  # of all claims together
AT_ONCE, STARTS, STEPS, SECONDS, DELTA_M = 500_000, 20_000, 4, 21.0, 1e-7
Floats = NDArray[np.float64]


def asked(plan: ProofPlan, proof: Proof, x: Floats) -> Floats:
    """Margins (n,) of questions (n, 6)."""
    hands, tcps = x[:, :3], x[:, 3:]
    answers, _ = plan.asked.propose_many(hands, tcps, np.zeros(len(x), np.uint64))
    return proof.planned.claim.margins(hands, tcps, answers)


def counted(proof: Proof, x: Floats) -> NDArray[np.bool_]:
    """Which of the questions (n, 6) are apart as the claim says."""
    apart_m, (near_m, far_m) = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1), proof.planned.region.apart_m
    counts: NDArray[np.bool_] = (apart_m >= near_m) & (apart_m <= far_m)
    return counts


def guided(plan: ProofPlan, proof: Proof, x: Floats, low: Floats, high: Floats) -> tuple[Floats, int]:
    """Margins of counted questions, from (n, 6) on in corners of boxes ``low`` to ``high``; how many."""
    found = []
    for _ in range(STEPS):
        margins = asked(plan, proof, x)
        slope = np.empty_like(x)
        for axis in range(6):
            moved = x.copy()
            moved[:, axis] += DELTA_M
            slope[:, axis] = asked(plan, proof, moved) - margins
        x = np.where(slope > 0.0, low, high)
        found.append(asked(plan, proof, x[counted(proof, x)]))
    return np.concatenate(found), sum(map(len, found))


def proven(folder: Path, plan: ProofPlan) -> list[Proof]:
    """Those of the folder, or made now."""
    path = folder / "certificate.json"
    if path.exists():
        return taken_up(path, plan)
    first, proofs = fresh(plan)[0], fresh(plan)  # the first compiles, which is no part of the time
    work(first.tree, plan.network, first.planned.claim, first.planned.region, halvings=1, until_s=np.inf)
    for proof in proofs:
        end_s = time.process_time() + SECONDS
        out_of_time = partial(lambda end_s: time.process_time() > end_s, end_s)
        claim, region = proof.planned.claim, proof.planned.region
        work(proof.tree, plan.network, claim, region, halvings=40, until_s=np.inf, stopped=out_of_time)
        print(f"{time.process_time():.0f} s: {proof.planned.sentence}: proven as far as it came", flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_certificate(path, plan, proofs)
    return proofs


def ask(folder: Path, plan: ProofPlan, counts: dict[str, Any]) -> None:
    """All that is still to be asked; ``counts`` are written after each batch."""
    proofs = proven(folder, plan)
    for number, proof in enumerate(proofs):
        count = counts.setdefault(
            proof.planned.sentence, {"batches": 0, "random": 0, "guided": 0, "contradict": 0, "least": None}
        )
        leaves = list(proof.tree.leaves(proof.planned.region, PROVEN))
        low, high = (np.concatenate(side) for side in zip(*leaves, strict=True))
        if not len(low):
            raise RuntimeError(f"nothing is proven of {proof.planned.sentence}: more seconds")
        volumes = np.concatenate([np.full(len(one[0]), 2.0**-level) for level, one in enumerate(leaves)])
        ends = np.cumsum(volumes)
        while count["random"] < RANDOM / len(proofs) or count["guided"] < GUIDED / len(proofs):
            rng = np.random.default_rng([number, count["batches"]])
            rows = np.searchsorted(ends, rng.random(AT_ONCE) * ends[-1], side="right").clip(max=len(ends) - 1)
            x = low[rows] + rng.random((AT_ONCE, 6)) * (high[rows] - low[rows])
            inside = counted(proof, x)
            x, rows = x[inside], rows[inside]
            parts, more = [asked(plan, proof, x)], 0
            if count["guided"] < GUIDED / len(proofs):
                start = rows[:STARTS]
                corners, more = guided(plan, proof, x[:STARTS], low[start], high[start])
                parts.append(corners)
            both = np.concatenate(parts)
            if not len(both):
                raise RuntimeError(f"no question of {proof.planned.sentence} counts")
            count["batches"] += 1
            count["random"] += len(x)
            count["guided"] += more
            count["contradict"] += int((~(both >= 0.0)).sum())
            count["least"] = min(float(both.min()), np.inf if count["least"] is None else count["least"])
            write_text(folder / "counts.json", json.dumps(counts, indent=1))
            print(f"{time.process_time():.0f} s: {proof.planned.sentence}: {count}", flush=True)


def page(counts: dict[str, Any]) -> str:
    """The table."""
    git = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    revision = subprocess.run(git, capture_output=True, text=True, check=True, cwd=ROOT).stdout.strip()
    rows = [
        (*(f"{one[key]:,}" for key in ("random", "guided", "contradict")), f"{one['least']:.1e}")
        for one in counts.values()
    ]
    totals = (f"{sum(one[key] for one in counts.values()):,}" for key in ("random", "guided", "contradict"))
    lines = [
        "# Questions to proven boxes of the student\n",
        f"Written by `python benchmarks/proof_questions.py` at {revision}: `plans/student-proofs.yaml`,",
        f"at most {SECONDS:.0f} s of processor time a claim; then random questions within proven boxes and",
        "those in the corners to which its gradient points. Margins are in m (*leads away*: m2); below 0",
        "one contradicts.\n",
        "| claim | random | guided | contradict | least margin |\n|---|---|---|---|---|",
        *(f"| {name} | {' | '.join(row)} |" for name, row in zip(counts, rows, strict=True)),
        f"| all | {' | '.join(totals)} | |",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Ask, and write the page."""
    named = [Path(one) for one in sys.argv[1:] if one != "--table"]
    folder = named[0] if named else ROOT / "reports" / "proof-questions"
    kept = folder / "counts.json"
    counts: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    if "--table" not in sys.argv:
        ask(folder, read_proof_plan(PLAN), counts)
    PAGE.write_text(page(counts))
    print(PAGE.read_text())


if __name__ == "__main__":
    main()
