"""What a campaign costs beside its episodes, and how it grows.

Run: python benchmarks/campaign.py [--real N] [--waiting N] [--episodes N].

1. Real episodes (``--real`` of them, 10 s each, in the kinematic world) with 1 and 2 workers: episodes a
   second, and what the runner's own processor time is beside the workers' time.
2. 64 workers that wait in place of working (``--waiting`` episodes of 0.3 s, what PyBullet takes): the part
   of the ideal rate that is reached, scheduling and committing included.
3. A ledger of ``--episodes`` episodes really run (0.4 s each, kinematic): rows and bytes, how long questions
   take, and how many episodes a second can be written at most; from these, 1e9 on paper.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from ratios import Ratio

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.processes import Processes
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.session import processes
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from tests.assurance.campaign.benches import Plain, row_of
from tests.assurance.campaign.plans import PLAN, plan_in

WORKERS, WAIT_S = 64, 0.3
IDEAL = WORKERS / WAIT_S  # episodes a second
TURNS = 3
SPACES = Path(__file__).parents[1] / "scenarios" / "spaces"


def planned(folder: Path, runs: int, space: str | None = None) -> Plan:
    """One stratum of so many episodes, no traces."""
    text = PLAN.replace("runs: 30", f"runs: {max(runs - 1, 1)}").replace("runs: 20", "runs: 1")
    text = text.replace("random traces: 2", "random traces: 0").replace("violations: 3", "violations: 0")
    if space is not None:
        text = text.replace("short.yaml", os.path.relpath(SPACES / space, folder))
        text = text.replace("opposite pose", "mc-dropout")
    return plan_in(folder, text)


def run(plan: Plan, path: Path, crew: Processes) -> tuple[float, float, float]:
    """Episodes a second from the first to the last that arrives, the runner's and the workers' seconds."""
    arrived: list[tuple[float, int]] = []

    def watch(progress: CampaignRunner) -> None:
        arrived.append((time.monotonic(), progress.tally.done))

    with Ledger.create(path, plan) as ledger, closing(crew):
        while not all(worker.ready for worker in crew.workers):
            crew.take(0.1)  # what starting costs is no matter of length
        own_s = time.process_time()
        assert CampaignRunner(plan, ledger, crew, on_progress=watch).run()
        own_s = time.process_time() - own_s
        work_s = next(ledger.all("SELECT sum(seconds) FROM episode"))[0]
    first = next(k for k, (_, done) in enumerate(arrived) if done)
    seconds = arrived[-1][0] - arrived[first][0]
    return (arrived[-1][1] - arrived[first][1]) / seconds, own_s, work_s


def real(runs: int, workers: int) -> tuple[float, float]:
    """Real episodes: how many a second, and the runner's own processor time over the workers' time."""
    with tempfile.TemporaryDirectory() as folder:
        plan = planned(Path(folder), runs, "nominal.yaml")
        rate, own_s, work_s = run(plan, Path(folder) / "ledger", processes(workers)(plan))
    return rate, own_s / work_s


def print_real(runs: int) -> None:
    """One worker, then two."""
    rates = []
    for workers in (1, 2):
        rate, own = real(runs, workers)
        rates.append(rate)
        print(
            f"{runs} real episodes, {workers} workers: {rate:.1f} a second; the runner's own time {own:.2%}"
        )
    print(f"two workers do {rates[1] / rates[0]:.2f} times what one does")


def waiting(runs: int) -> tuple[float, float]:
    """Episodes a second of 64 workers, and the part of the time that the runner is busy.

    Only scheduling, pipes and commits are real.
    """
    with tempfile.TemporaryDirectory() as folder:
        plan = planned(Path(folder), runs)
        rate, own_s, _ = run(plan, Path(folder) / "ledger", Processes(Plain(seconds=WAIT_S), WORKERS))
    return rate, own_s / (runs / rate)


def print_waiting(runs: int) -> None:
    """Beside the ideal rate."""
    rate, busy = waiting(runs)
    print(
        f"{WORKERS} workers that wait {WAIT_S} s an episode: {rate:.1f} a second of {IDEAL:.1f} possible "
        f"({rate / IDEAL:.1%}); the runner is busy {busy:.1%} of the time"
    )


def ratios() -> list[Ratio]:
    """What a campaign costs beside its episodes, what a second worker brings, what 64 lose to one runner."""
    own, gain, ideal = [], [], []
    for _ in range(TURNS):
        (one, _), (two, cost) = real(300, 1), real(300, 2)
        own.append(cost)
        gain.append(two / one)
        ideal.append(IDEAL / waiting(6400)[0])
    return [
        Ratio.of("the runner's own time over the work of real episodes", own, aim=0.05, at_most=True),
        Ratio.of("real episodes a second, two workers over one", gain),
        Ratio.of(f"{WORKERS} waiting workers, the ideal rate over ours", ideal, aim=1.05, at_most=True),
    ]


def timed(what: str, question: Callable[[], object]) -> None:
    """How long an answer takes."""
    begun_s = time.monotonic()
    question()
    print(f"  {what}: {time.monotonic() - begun_s:.2f} s")


def ledger_of(runs: int) -> None:
    """Really run, looked at, and multiplied."""
    with tempfile.TemporaryDirectory() as folder:
        plan = planned(Path(folder), runs)
        path = Path(folder) / "ledger"
        begun_s = time.monotonic()
        run(plan, path, processes(None)(plan))
        seconds = time.monotonic() - begun_s
        print(f"{runs} episodes with {len(plan.claims)} claims really run in {seconds:.0f} s:")
        size = path.stat().st_size
        each = size / runs
        print(f"  {runs * (1 + len(plan.claims))} rows, {size:,} bytes, {each:.0f} an episode")
        timed("opening, every page looked at", lambda: Ledger.open(path).close())
        with Ledger.open(path, check=False) as ledger:
            timed("counts and worst margins", lambda: tally_of(ledger))
            timed("one sample for an estimate", lambda: ledger.sample("near", plan.claims[0].sentence))
            timed("fingerprint", lambda: fingerprint_of(ledger))
        most = written(Path(folder), runs, plan)
        print(f"  {most:,.0f} episodes a second can be written at most")
        paper(each, most)


def written(folder: Path, runs: int, plan: Plan) -> float:
    """Rows that cost nothing to make, a thousand in a transaction."""
    with Ledger.create(folder / "at once", plan) as ledger:
        begun_s = time.monotonic()
        for first in range(0, runs - 1, 1000):
            ledger.record(row_of(0, k) for k in range(first, min(first + 1000, runs - 1)))
        return (runs - 1) / (time.monotonic() - begun_s)


def paper(each: float, most: float, episodes: float = 1e9) -> None:
    """What a thousand million would take."""
    print(
        f"1e9 on paper: {each * episodes / 1e9:.0f} GB, {episodes / most / 3600.0:.0f} h of writing at best"
    )
    print(f"  the one writer is the limit above {most * 0.3:,.0f} workers of 0.3 s an episode")


def main(arguments: Sequence[str] | None = None) -> None:
    """All three."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--real", type=int, default=400)
    parser.add_argument("--waiting", type=int, default=6400)
    parser.add_argument("--episodes", type=int, default=10_000)
    given = parser.parse_args(arguments)
    print_real(given.real)
    print_waiting(given.waiting)
    ledger_of(given.episodes)


if __name__ == "__main__":
    main()
