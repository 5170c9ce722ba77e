"""The same plan on a Dask cluster: the same results, through workers and schedulers that are killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from safety_harness.campaign.cluster import DaskCrew, Shipment, run_chunk
from safety_harness.campaign.crew import Chunk
from safety_harness.campaign.identity import Identity
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.campaign.session import carry_on, processes
from safety_harness.campaign.summary import fingerprint_of, tally_of
from safety_harness.campaign.worker import Mistake
from safety_harness.exceptions import CampaignError, ScenarioError
from tests.campaign.plans import PLAN, plan_in


@contextmanager
def scheduler(folder: Path, port: int = 0) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler in a process of its own, and its address."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1"]
    command += ["--port", str(port), "--no-dashboard", "--scheduler-file", str(file)]
    with started(command) as process:
        wait_until(lambda: file.exists() and file.stat().st_size > 0)
        yield process, str(file)


@contextmanager
def workers(file: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    command = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        "--scheduler-file",
        file,
        "--no-dashboard",
    ]
    command += ["--nthreads", "1", "--nworkers", "2", "--local-directory", str(folder)]
    with started(command) as process:
        yield process


@contextmanager
def started(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_until(is_so: object, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not is_so():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture(autouse=True)
def _comes_to_an_end() -> Iterator[None]:
    """What waits for a cluster that is gone may wait for ever: then the test fails."""

    def fail(number: int, frame: object) -> None:
        raise TimeoutError("three minutes are over")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(180)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan_in(tmp_path_factory.mktemp("plan"), PLAN.replace("violations: 3", "violations: 100"))


@pytest.fixture(scope="module")
def alone(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("alone") / "ledger.sqlite"
    assert carry_on(plan, path, processes(1))
    with Ledger.open(path) as ledger:
        return fingerprint_of(ledger)


def test_a_cluster_gives_the_bits_of_one_process_and_outlives_its_scheduler(
    tmp_path: Path, plan: Plan, alone: str
) -> None:
    path = tmp_path / "ledger.sqlite"
    with scheduler(tmp_path) as (process, file), workers(file, tmp_path / "first"):
        done: list[int] = []

        def watch(progress: object) -> None:
            done.append(progress.tally.done)  # type: ignore[attr-defined]
            if done[-1] >= 3:
                process.send_signal(signal.SIGKILL)

        with pytest.raises(CampaignError, match="the scheduler"):
            carry_on(plan, path, lambda plan: DaskCrew(plan, file), on_progress=watch)
    with Ledger.open(path) as ledger:
        assert 3 <= tally_of(ledger).done < 50
        assert tally_of(ledger).strata[0].failed == 0
    with scheduler(tmp_path) as (_, file), workers(file, tmp_path / "second"):
        assert carry_on(plan, path, lambda plan: DaskCrew(plan, file))
    with Ledger.open(path) as ledger:
        assert fingerprint_of(ledger) == alone


def test_a_worker_with_another_version_refuses(plan: Plan) -> None:
    parts = tuple((name, "1.0" if name == "Python" else value) for name, value in plan.identity.parts)
    found = run_chunk(Shipment(plan.files, Identity(parts)), Chunk(0, (0,), False))
    assert isinstance(found, Mistake)
    assert "Python changed" in str(found.error)


def test_a_cluster_that_does_not_answer_is_bad_input(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("safety_harness.campaign.cluster._ANSWER_S", 0.2)
    for address in ("tcp://127.0.0.1:1", "no-such-file.json"):
        with (
            pytest.raises(ScenarioError, match="a Dask scheduler that answers"),
            closing(DaskCrew(plan, address)),
        ):
            pass
