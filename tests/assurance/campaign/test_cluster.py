"""The same plan on a Dask cluster: the same results, through workers and schedulers that are killed."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from socket import socket
from socketserver import BaseRequestHandler, TCPServer
from threading import Thread

import pytest

from safety_harness.base.exceptions import CampaignError, InputError, ScenarioError
from safety_harness.cli.console import DIFFERS
from safety_harness.extensions.assurance.campaign import cluster
from safety_harness.extensions.assurance.campaign.cluster import DaskCrew, run_chunk
from safety_harness.extensions.assurance.campaign.identity import Identity
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.processes import Chunk, Limits
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.session import processes, run_missing
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from safety_harness.extensions.assurance.commands.campaign import run
from tests.assurance.campaign.benches import CrashesAndHangs, done_by
from tests.assurance.campaign.clusters import scheduler, workers
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.assurance.campaign.test_runner import Here, fingerprint_after
from tests.search.short_space import TEXT


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
    assert run_missing(plan, path, processes(1))
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
            run_missing(plan, path, lambda plan: DaskCrew(plan, file), on_progress=watch)
    with Ledger.open(path) as ledger:
        assert 3 <= tally_of(ledger).done < 50
        assert tally_of(ledger).strata[0].failed == 0
    with scheduler(tmp_path) as (_, file), workers(file, tmp_path / "second"):
        assert run_missing(plan, path, lambda plan: DaskCrew(plan, file))
    with Ledger.open(path) as ledger:
        assert fingerprint_of(ledger) == alone


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The file of a scheduler that gives a task up when one worker has died of it."""
    folder = tmp_path_factory.mktemp("shared")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
        with scheduler(folder) as (_, file), workers(file, folder / "workers"):
            yield file


@pytest.mark.long  # test_runner.py has the same of processes
def test_workers_of_a_cluster_that_crash_hang_and_are_killed_cost_nothing(
    tmp_path: Path, plan: Plan, shared: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = CrashesAndHangs(seconds=0.02, at=5, hangs_at=28, folder=tmp_path)
    monkeypatch.setattr(cluster, "run_chunk", partial(done_by, bench))
    path, killed = tmp_path / "ledger.sqlite", []
    crew = DaskCrew(plan, shared, Limits(silence_s=2.0, first_s=1.0))

    def watch(progress: CampaignRunner) -> None:
        if progress.done_now >= 6 and not killed:
            killed.extend(crew._client.run(os.getpid).values())
            os.kill(killed[0], signal.SIGKILL)

    assert run_missing(plan, path, lambda plan: crew, on_progress=watch)
    assert killed
    assert crew.replaced >= 1
    assert len(list(tmp_path.glob("*/crash-*"))) == 2
    with Ledger.open(path) as ledger:
        assert fingerprint_of(ledger) == fingerprint_after(tmp_path / "here", plan, Here(1))


HANGING = """\
import time

from safety_harness import Proposal


class Hanging:
    name = "hanging"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        time.sleep(600.0 if seed % 3 == 1 else 0.0)  # the rehearsal has seed 0
        return Proposal(tcp_position_in_base_m + [0.0, 0.1, 0.0])
"""


@pytest.mark.long  # test_episodes.py has the same without a cluster
def test_a_user_s_avoider_that_hangs_does_the_same_by_the_command_line_on_a_cluster(
    tmp_path: Path, shared: str
) -> None:
    (tmp_path / "hanging.py").write_text(HANGING)
    text = PLAN.replace("opposite pose", "hanging.py:Hanging").replace("runs: 30", "runs: 4")
    space = TEXT + "settings: {clock: {wall limit: 500 ms}}\n"
    plan_in(tmp_path, text.replace("runs: 20", "runs: 2"), space)
    paths = [tmp_path / "here.sqlite", tmp_path / "there.sqlite"]
    for path, where in zip(paths, (None, shared), strict=True):
        assert run(tmp_path / "plan.yaml", ledger=path, workers=2, cluster=where) == DIFFERS
    with Ledger.open(paths[0]) as here, Ledger.open(paths[1]) as there:
        ((failed, runs),) = there.all("SELECT sum(failure != ''), count(*) FROM episode")
        assert 0 < failed < runs
        assert fingerprint_of(here) == fingerprint_of(there)


def test_a_worker_with_another_version_refuses(plan: Plan) -> None:
    parts = tuple((name, "1.0" if name == "Python" else value) for name, value in plan.identity.parts)
    found = run_chunk(plan.files, Identity(parts), Chunk(0, (0,), False))
    assert isinstance(found, InputError)
    assert f"Python changed (the worker {os.uname().nodename}:{os.getpid()})" in str(
        pickle.loads(pickle.dumps(found))
    )


class Web(BaseRequestHandler):
    """Takes a connection, says something that is not Dask's, and waits."""

    def handle(self) -> None:
        self.request.sendall(b"HTTP/1.0 400 Bad Request\r\n\r\n")
        self.request.recv(1 << 16)


@pytest.mark.parametrize(
    ("where", "why"),
    [
        ("tcp://127.0.0.1:1", "Timed out"),
        ("tcp://127.0.0.1", "missing port"),
        ("http://127.0.0.1:1", "unknown address scheme"),
        ("127.0.0.1:8786", "no such file"),
        ("no-such-file.json", "no such file"),
        ("odd.json", "a file of another program"),
        ("of-no-scheduler.json", "a file of another program"),
        ("of-a-dead-one.json", "Timed out"),
        ("silent", "no answer within 0.2 s"),
        ("web", "."),
    ],
)
def test_a_cluster_that_does_not_answer_is_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plan: Plan, where: str, why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("safety_harness.extensions.assurance.campaign.cluster._ANSWER_S", 0.2)
    (tmp_path / "odd.json").write_text("[")
    (tmp_path / "of-no-scheduler.json").write_text("{}")
    (tmp_path / "of-a-dead-one.json").write_text('{"address": "tcp://127.0.0.1:1"}')
    with closing(socket()) as silent, TCPServer(("127.0.0.1", 0), Web) as web:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        Thread(target=web.handle_request, daemon=True).start()
        port = {"silent": silent.getsockname()[1], "web": web.server_address[1]}.get(where)
        where = f"tcp://127.0.0.1:{port}" if port else where
        with (
            pytest.raises(ScenarioError, match=f"a Dask scheduler that answers; got {where}: .*{why}"),
            closing(DaskCrew(plan, where)),
        ):
            pass
