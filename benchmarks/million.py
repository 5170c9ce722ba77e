"""A million episodes of 500 control ticks in the unseen spaces, really run: how long, and in what memory?

Run: python benchmarks/million.py FOLDER [--episodes N] [--workers N].

A campaign in the kinematic world over the three unseen spaces of the paper's Table 3, 4 s an episode: drawn,
admitted, run with the shipped network, looked at for contradictions, judged by the spaces' own claims and
committed to a ledger.  Ctrl-C and the same command again go on.  At the end: minutes of this session, the
rate, the most memory of a process, rows and bytes, and how long questions to the ledger take.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import os
import resource
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from campaign import timed

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.campaign.processes import resident_bytes
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.session import carry_on, processes
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome

SPACES = Path(__file__).parents[1] / "scenarios" / "spaces"
STRATA = ("unseen-both", "unseen-hand", "unseen-tcp")
CLAIMS = ("repulsive poses reachable", "joint speeds within limits", "TCP speed never above 250 mm/s")
LONGER, SHORTER = "duration: 10 s", "duration: 4 s"  # 500 control ticks


def plan_in(folder: Path, episodes: int) -> Plan:
    """The plan, and the shipped spaces with a shorter duration beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        "plan: the unseen spaces",
        "about: how long a million episodes take",
        "world: kinematic",
        "seed: 1",
    ]
    lines.append("strata:")
    for number, name in enumerate(STRATA):
        text = (SPACES / f"{name}.yaml").read_text()
        assert LONGER in text
        (folder / f"{name}.yaml").write_text(text.replace(LONGER, SHORTER))
        runs = episodes // len(STRATA) + (number < episodes % len(STRATA))
        lines += [f"  - stratum: {name.replace('-', ' ')}", f"    space: {name}.yaml", f"    runs: {runs}"]
    lines += ["claims:", *(f"  - claim: {claim}" for claim in CLAIMS)]
    lines += ["keep: {random traces: 10, violations: 10}"]
    file = folder / "plan.yaml"
    file.write_text("\n".join(lines) + "\n")
    return read_plan(file)


@dataclass
class Watch:
    """Prints a line every half a minute, and notes the most memory that another process of this group has."""

    begun_s: float
    last_s: float = 0.0
    most_bytes: int = 0

    def __call__(self, progress: CampaignRunner) -> None:
        """Told of every batch that was committed."""
        since_s = time.monotonic() - self.begun_s
        if since_s - self.last_s >= 30.0:
            self.last_s = since_s
            self.most_bytes = max(self.most_bytes, *map(resident_bytes, others_of_this_group()), 0)
            print(f"  {progress.tally.done:,} after {since_s / 60.0:.1f} min", flush=True)


def others_of_this_group() -> list[int]:
    """The processes that were started from this one, and from those, as long as they stay in its group."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(ProcessLookupError):
            if os.getpgid(int(folder.name)) == os.getpgid(0) and int(folder.name) != os.getpid():
                found.append(int(folder.name))
    return found


def told(path: Path, plan: Plan) -> None:
    """What the ledger says of the episodes, and how large it is."""
    with Ledger.open(path, check=False) as ledger:
        done, seconds, decisions = next(
            ledger.all("SELECT count(*), sum(seconds), sum(proposed + opposite + stopped) FROM episode")
        )
        (judged,) = next(ledger.all("SELECT count(*) FROM judgement"))
        print(f"  {1e3 * seconds / done:.2f} ms an episode in its worker, {decisions / done:.3f} decisions")
        bytes_ = sum(file.stat().st_size for file in path.parent.glob(f"{path.name}*"))
        print(f"  {done + judged:,} rows, {bytes_:,} bytes, {bytes_ / done:.0f} an episode")
        for number, claim in enumerate(CLAIMS):
            rows = ledger.all("SELECT outcome, count(*) FROM judgement WHERE claim = ? GROUP BY 1", number)
            counts = ", ".join(f"{count:,} {EpisodeOutcome(outcome).name.lower()}" for outcome, count in rows)
            print(f"  {claim}: {counts}")
        timed("counts and worst margins", lambda: tally_of(ledger))
        timed("one sample for an estimate", lambda: ledger.sample("unseen both", plan.claims[0].sentence))
        timed("fingerprint", lambda: print(f"  {fingerprint_of(ledger)}"))
    timed("opening, every page looked at", lambda: Ledger.open(path).close())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, or go on, and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--episodes", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    given = parser.parse_args(arguments)
    plan, path = plan_in(given.folder, given.episodes), given.folder / "ledger.sqlite"
    begun_s, load, before = time.monotonic(), os.getloadavg()[0], 0
    watch = Watch(begun_s)
    if path.exists():
        with Ledger.open(path, check=False) as ledger:
            before = tally_of(ledger).done
    try:
        carry_on(plan, path, processes(given.workers), on_progress=watch)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on")
    seconds = time.monotonic() - begun_s
    with Ledger.open(path, check=False) as ledger:
        done = tally_of(ledger).done
    print(f"{done - before:,} episodes in {seconds / 60.0:.1f} min, {(done - before) / seconds:.0f} a second")
    print(f"  {given.workers} workers; load before and after {load:.1f}, {os.getloadavg()[0]:.1f}")
    own_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    worker_mb = watch.most_bytes / 2**20
    print(f"  at most {own_mb:.0f} MB in the runner, {worker_mb:.0f} MB in a worker when looked at")
    told(path, plan)


if __name__ == "__main__":
    main()
