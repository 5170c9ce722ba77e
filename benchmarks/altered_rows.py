"""Are altered rows seen as often as verify states?  Run: python benchmarks/altered_rows.py.

A forger hides eight violations of a refuted claim in the ledger, so that it is *not shown*, takes care that
none of them has a stored trace, and makes the whole report and every hash anew.  The target is such that
eight rows are also the fewest that verify reckons with: the hardest case.  verify then draws its runs by a
seed that the forger cannot know, as many as its stated chance asks for.  200 forgeries at 1 %, and 200 at
25 %, where misses can be counted.  The page is not drawn: no row is seen there.

Writes benchmarks/ALTERED_ROWS.md; the exit code is 1 if misses are more than the stated chance explains
(one in a thousand), or if anything but the runs made again saw a forgery.  --trials is for a quick look.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import math
import secrets
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.base.compiled import source_hash
from safety_harness.base.proportions import lower_bound
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import LEDGER, carry_on, processes
from safety_harness.extensions.assurance.certification import folder, verify_report
from safety_harness.extensions.assurance.certification.altered import chance_to_miss
from safety_harness.extensions.assurance.certification.verify import verify
from safety_harness.extensions.assurance.certification.verify_runs import drawn
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.assurance.certification.forging import hidden, write

RUNS, HIDDEN = 200, 8
SECOND = "  - stratum: nearer\n    space: short.yaml\n    runs: 20\n"
OUT = Path(__file__).with_name("ALTERED_ROWS.md")


@dataclass(frozen=True)
class Measured:
    """``missed`` of ``trials`` forgeries at a stated chance, which ``again`` of the runs come to exactly."""

    stated: float
    again: int
    trials: int
    missed: int

    @property
    def exact(self) -> float:
        """The chance that so many runs miss all altered rows."""
        return chance_to_miss(RUNS, HIDDEN, self.again)

    @property
    def broken(self) -> bool:
        """Are there more misses than the stated chance explains?"""
        return bool(stats.binomtest(self.missed, self.trials, self.stated, "greater").pvalue < 1e-3)

    def markdown(self) -> str:
        """One row of the table."""
        interval = stats.binomtest(self.missed, self.trials).proportion_ci(0.95)
        return (
            f"| {self.stated:.0%} | {self.again} of {RUNS} | {self.exact:.2%} | "
            f"{self.missed} of {self.trials} | {interval.low:.1%} to {interval.high:.1%} | "
            f"{'NO' if self.broken else 'yes'} |"
        )


def honest(report: Path) -> None:
    """A report of which a claim is refuted by as few violations as possible."""
    text = PLAN.replace("runs: 30", f"runs: {RUNS}").replace(SECOND, "")
    text = text.replace("random traces: 2", "random traces: 0").replace("violations: 3", "violations: 1")
    first = report.with_name("first")
    carry_on(plan_in(first, text), first / LEDGER, processes(1))
    with Ledger.open(first / LEDGER) as ledger:
        margins = np.sort(ledger.outcomes(0, 0)[2])
    limit = round(150.0 + 1e3 * float(margins[int(0.55 * len(margins))]), 2)  # of which 55 % come nearer
    text = text.replace("below 150 mm", f"below {limit} mm")
    violated = int(np.count_nonzero(margins < (limit - 150.0) / 1e3))
    chance = 0.05 / 4
    ends = [lower_bound(count, RUNS, chance) for count in (violated - 1, violated)]
    text = text.replace("50 %", f"{100.0 * math.fsum(ends) / 2.0:.6f} %")
    carry_on(plan_in(report.parent / "second", text), report / LEDGER, processes(1))
    evidence = write(report)
    assert evidence.claims[0].outcomes[0].standing.value == "refuted", evidence.claims[0].why


def measured(report: Path, stated: float, trials: int) -> Measured:
    """Forged, made anew and verified, again and again."""
    missed, again = 0, 0
    for trial in range(trials):
        with tempfile.TemporaryDirectory() as place:
            forged = Path(shutil.copytree(report, Path(place) / "report"))
            altered, seed = hidden(forged, HIDDEN, secrets.randbits(63)), secrets.randbits(63)
            evidence = write(forged)
            assert evidence.claims[0].outcomes[0].standing.value == "not shown"
            checks = {c.name: c for c in verify(forged, miss=stated, seed=seed)}
        seen = [name for name, check in checks.items() if not check.stands]
        if seen not in ([], ["runs"]):
            raise SystemExit(f"{seen} saw it: {[checks[name].faults for name in seen]}")
        again = int(checks["runs"].looked_at.split()[0])
        if bool(seen) == set(altered).isdisjoint(drawn(RUNS, again, seed)):
            raise SystemExit(f"{altered} was made again and not seen, or the other way round: seed {seed}")
        missed += not seen
        print(f"{stated:.0%}: {missed} of {trial + 1} missed", flush=True)
    return Measured(stated, again, trials, missed)


def main() -> int:
    """Measure and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=200)
    trials = parser.parse_args().trials
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=OUT.parent, check=False
    ).stdout.strip()
    with (
        tempfile.TemporaryDirectory() as place,
        patch.object(folder, "write_page", lambda path, *_: path.write_text("the page")),
        patch.object(verify_report, "render", lambda *_: "the page"),
    ):
        report = Path(place) / "report"
        honest(report)
        rows = [measured(report, stated, trials) for stated in (0.01, 0.25)]
    head = "| stated | made again | exactly | missed | 95 % interval | as often as stated, or less |"
    text = "\n".join(
        [
            "# Altered rows that verify misses",
            "",
            f"Written by `make bench-altered_rows` at {revision} (source {source_hash()}): {HIDDEN} of "
            f"{RUNS} rows of a refuted",
            "claim altered by SQL, none with a stored trace, report and hashes made anew each time.",
            "",
            head,
            "|---|---|---|---|---|---|",
            *(row.markdown() for row in rows),
            "",
        ]
    )
    OUT.write_text(text)
    print(text)
    return int(any(row.broken for row in rows))


if __name__ == "__main__":
    sys.exit(main())
