"""Kill everything at random moments; afterwards every planned episode is there once, with the same result.

Run: python benchmarks/crashes.py [--moments N] [--seed N] [writer] [worker] [runner] [scheduler].

writer     SIGKILL of the process that writes the ledger, which commits as fast as it can
worker     SIGKILL of the runner's workers, one after another, in one campaign
runner     SIGKILL of ``safety-harness campaign run``, which is begun again each time
scheduler  SIGKILL of a Dask scheduler; the campaign goes on with the next one

Writers and workers have episodes that only wait (tests/assurance/campaign/benches.py), runner and scheduler
real ones
of 0.4 s in the kinematic world.  A ledger that is damaged, an episode that is missing or there twice, or
a fingerprint that differs from the undisturbed one ends the benchmark with an error.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.base.exceptions import CampaignError
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.campaign.processes import Arrived, Chunk, Event, Limits, Processes
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.session import carry_on, processes
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from tests.assurance.campaign.benches import Plain, row_of
from tests.assurance.campaign.clusters import scheduler, workers
from tests.assurance.campaign.plans import PLAN, plan_in


class AtOnce:
    """A crew in this process: rows as soon as they are asked for, so that all of the time goes to writing."""

    size = free = 1
    replaced = 0

    def __init__(self, keep: bool = True) -> None:
        self._chunk: Chunk | None = None
        self._trace = bytes(20_000) if keep else None

    def give(self, chunk: Chunk) -> None:
        """Take one."""
        self._chunk, self.free = chunk, 0

    def take(self, timeout_s: float) -> Sequence[Event]:
        """All of it."""
        chunk, self.free = self._chunk, 1
        assert chunk is not None
        return [
            Arrived(chunk, tuple(row_of(chunk.stratum, k, trace=self._trace) for k in chunk.episodes), True)
        ]

    def close(self) -> None:
        """Nothing to close."""


def checked(path: Path, plan: Plan, expected: str) -> None:
    """Every planned episode once, and the results of an undisturbed run."""
    with Ledger.open(path) as ledger:
        assert not [one for k in range(len(plan.strata)) for one in ledger.missing(k)]
        assert next(ledger.all("SELECT count(*) FROM episode"))[0] == plan.runs
        assert not any(stratum.failed for stratum in tally_of(ledger).strata)
        assert fingerprint_of(ledger) == expected, "other results"


def write(path: Path, plan: Plan) -> None:
    """What the process that is killed does."""
    with Ledger.open(path, write=True) as ledger:
        CampaignRunner(plan, ledger, AtOnce()).run()


def kill_writers(moments: int, rng: random.Random, folder: Path) -> str:
    """Fork, kill after a random time, look at the ledger; begin a new one whenever one is complete."""
    plan = plan_in(folder, PLAN.replace("runs: 30", "runs: 4000").replace("runs: 20", "runs: 1000"))
    with Ledger.create(folder / "whole", plan) as ledger:
        CampaignRunner(plan, ledger, AtOnce()).run()
        expected = fingerprint_of(ledger)
    context, killed, ledgers, written, before = multiprocessing.get_context("fork"), 0, 0, 0, 0
    path = folder / "ledger-0"
    Ledger.create(path, plan).close()
    while killed < moments:
        process = context.Process(target=write, args=(path, plan))
        process.start()
        time.sleep(rng.uniform(0.0, 0.8))
        process.kill()
        process.join()
        with Ledger.open(path) as ledger:  # which looks at every page
            tally = tally_of(ledger)
        complete, written, before = tally.complete, written + (tally.done > before), tally.done
        killed += process.exitcode == -signal.SIGKILL
        if complete or killed == moments:
            write(path, plan)
            checked(path, plan, expected)
            ledgers, before = ledgers + 1, 0
            path = folder / f"ledger-{ledgers}"
            Ledger.create(path, plan).close()
    told = f"{killed} writers killed, {written} of them between two commits"
    return f"{told}, over {ledgers} ledgers of {plan.runs} episodes"


def kill_workers(moments: int, rng: random.Random, folder: Path) -> str:
    """In one campaign, each as soon as it has come up again."""
    plan = plan_in(folder, PLAN.replace("runs: 30", f"runs: {40 * moments}"))
    with Ledger.create(folder / "whole", plan) as ledger:
        CampaignRunner(plan, ledger, AtOnce()).run()
        expected = fingerprint_of(ledger)
    killed, over = 0, threading.Event()
    with closing(Processes(Plain(seconds=0.01), 2, Limits())) as crew:

        def kill() -> None:
            nonlocal killed
            while killed < moments and not over.wait(rng.uniform(0.0, 0.4)):
                ready = [worker for worker in crew.workers if worker.ready]
                if ready:  # else all of them were killed while they were coming up
                    with suppress(ProcessLookupError):  # it has been killed a moment ago
                        rng.choice(crew.workers).process.kill()
                        killed += 1

        killer = threading.Thread(target=kill)
        with Ledger.create(folder / "ledger", plan) as ledger:
            killer.start()
            try:
                CampaignRunner(plan, ledger, crew).run()
            finally:
                over.set()
                killer.join()
    checked(folder / "ledger", plan, expected)
    return f"{killed} workers killed in one campaign of {plan.runs} episodes"


def _real(folder: Path) -> tuple[Plan, str]:
    plan = plan_in(folder, PLAN.replace("runs: 30", "runs: 400").replace("runs: 20", "runs: 100"))
    carry_on(plan, folder / "whole", processes(2))
    with Ledger.open(folder / "whole") as ledger:
        return plan, fingerprint_of(ledger)


def kill_runners(moments: int, rng: random.Random, folder: Path) -> str:
    """The command as a user gives it."""
    plan, expected = _real(folder)
    killed, ledgers = 0, 0
    while killed < moments:
        path = folder / f"ledger-{ledgers}"
        command = [sys.executable, "-m", "safety_harness", "campaign", "run", str(plan.file)]
        command += ["--ledger", str(path), "--workers", "2"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, **quiet) as process:
            try:
                process.wait(rng.uniform(1.0, 12.0))
            except subprocess.TimeoutExpired:
                process.kill()
                killed += 1
        if path.exists() and not _is_complete(path) and killed < moments:
            continue
        carry_on(read_plan(plan.file), path, processes(2))
        checked(path, plan, expected)
        ledgers += 1
    return f"{killed} runners killed over {ledgers} ledgers of {plan.runs} episodes"


def _is_complete(path: Path) -> bool:
    with Ledger.open(path) as ledger:
        return tally_of(ledger).complete


def kill_schedulers(moments: int, rng: random.Random, folder: Path) -> str:
    """A scheduler with two workers, killed after some episodes; then another."""
    from safety_harness.extensions.assurance.campaign.cluster import DaskCrew

    plan, expected = _real(folder)
    killed, ledgers = 0, 0
    while killed < moments:
        path = folder / f"ledger-{ledgers}"
        with scheduler(folder) as (process, file), workers(file, folder / "workers"):
            timer = threading.Timer(rng.uniform(1.0, 12.0), process.kill)
            timer.start()
            try:
                carry_on(plan, path, lambda plan, file=file: DaskCrew(plan, file))
            except CampaignError:
                killed += 1
            finally:
                timer.cancel()
        if killed == moments:
            carry_on(plan, path, processes(2))
        if _is_complete(path):
            checked(path, plan, expected)
            ledgers += 1
    return f"{killed} schedulers killed over {ledgers} ledgers of {plan.runs} episodes"


KINDS: dict[str, Callable[[int, random.Random, Path], str]] = {
    "writer": kill_writers,
    "worker": kill_workers,
    "runner": kill_runners,
    "scheduler": kill_schedulers,
}


def main() -> None:
    """Each kind in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=list(KINDS), metavar="KIND")
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    for kind in given.kinds:
        begun_s = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            told = KINDS[kind](given.moments, random.Random(given.seed), Path(folder))
        seconds = time.monotonic() - begun_s
        print(f"{kind}: {told}: every planned episode once, results as undisturbed; {seconds:.0f} s")


if __name__ == "__main__":
    main()
