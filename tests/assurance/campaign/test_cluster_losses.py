"""What a Dask cluster loses, told to a crew by a client that is none: who is blamed, and who only waited."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from distributed import KilledWorker

from safety_harness.base.exceptions import CampaignError, LedgerError, Place
from safety_harness.extensions.assurance.campaign import cluster
from safety_harness.extensions.assurance.campaign.cluster import DaskCrew, run_chunk
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.processes import Arrived, Chunk, Event, Limits, Lost
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.summary import tally_of
from tests.assurance.campaign.benches import row_of
from tests.assurance.campaign.plans import ledger_in, plan_in


class Future:
    """As much of a future as a crew looks at."""

    def __init__(self, key: str, chunk: Chunk) -> None:
        self.key, self.chunk, self.status, self.outcome = key, chunk, "pending", None

    def add_done_callback(self, tell: Any) -> None:
        self._tell = tell

    def ends(self, status: str, outcome: object) -> None:
        self.status, self.outcome = status, outcome
        self._tell(self)

    def succeeds(self) -> None:
        self.ends("finished", [row_of(self.chunk.stratum, k) for k in self.chunk.episodes])

    def result(self, timeout_s: float) -> Any:
        return self.outcome

    exception = result


class Client:
    """A scheduler with ``threads`` workers, and what is on each of them."""

    status = "running"

    def __init__(self, threads: int) -> None:
        self.threads = {f"worker {k}": 1 for k in range(threads)}
        self.futures: list[Future] = []
        self.on: dict[str, list[str]] = {}
        self.restarted: list[str] = []

    def nthreads(self) -> dict[str, int]:
        return self.threads

    def processing(self) -> dict[str, list[str]]:
        return self.on

    def submit(
        self, function: object, files: object, identity: object, chunk: Chunk, *, pure: bool
    ) -> Future:
        self.futures.append(Future(f"task {len(self.futures)}", chunk))
        return self.futures[-1]

    def cancel(self, futures: Sequence[Future], *, force: bool) -> None:
        for future in futures:
            future.ends("cancelled", None)

    def restart_workers(self, workers: Sequence[str], **_: object) -> None:
        self.restarted += workers


def killed(failures: int = 3) -> KilledWorker:
    return KilledWorker("task", SimpleNamespace(address="tcp://there"), failures)  # type: ignore[arg-type]


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path)


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Client:
    client = Client(2)
    monkeypatch.setattr(cluster, "connected", lambda *_: client)
    monkeypatch.setattr(cluster, "_LOOK_S", 0.0)
    return client


def losses(events: Sequence[Event]) -> list[tuple[tuple[int, ...], int]]:
    return [(one.chunk.episodes, one.times) for one in events if isinstance(one, Lost)]


def chunk(*episodes: int) -> Chunk:
    return Chunk(0, episodes, False)


def test_what_waited_on_workers_that_died_is_not_blamed(plan: Plan, client: Client) -> None:
    crew = DaskCrew(plan, "tcp://there")
    for one in (chunk(1, 2), chunk(3), chunk(4)):
        crew.give(one)
    for future in client.futures:
        future.ends("error", killed())
    assert losses(crew.take(0.0)) == [((1, 2), 0), ((3,), 0), ((4,), 0)]


def test_a_suspect_comes_with_nothing_beside_it_and_is_then_blamed_as_often_as_it_killed(
    plan: Plan, client: Client
) -> None:
    crew = DaskCrew(plan, "tcp://there")
    crew.give(chunk(3))
    client.futures[0].ends("error", killed())
    crew.take(0.0)
    crew.give(chunk(5))
    crew.give(chunk(3))
    assert crew.free == 0
    crew.take(0.0)
    assert len(client.futures) == 2  # the other is still under way
    client.futures[1].succeeds()
    crew.take(0.0)
    crew.take(0.0)
    assert client.futures[2].chunk == chunk(3)
    assert crew.free == 0
    client.futures[2].ends("error", killed())
    assert losses(crew.take(0.0)) == [((3,), 4)]
    assert crew.free == 4


def test_only_what_a_worker_is_at_hangs_and_is_blamed(plan: Plan, client: Client) -> None:
    crew = DaskCrew(plan, "tcp://there", limits=Limits(silence_s=0.05, first_s=0.0))
    for k in range(3):
        crew.give(chunk(k))
    client.on = {"worker 0": ["task 2", "task 0", "another client's"], "worker 1": []}
    assert crew.take(0.0) == []
    time.sleep(0.06)
    assert sorted(losses(crew.take(0.0))) == [((0,), 1), ((1,), 0), ((2,), 0)]  # two that nobody came to
    assert client.restarted == ["worker 0"]
    assert crew.replaced == 1


def test_while_no_worker_is_there_nothing_hangs(plan: Plan, client: Client) -> None:
    client.threads = {}
    crew = DaskCrew(plan, "tcp://there", limits=Limits(silence_s=0.05, first_s=0.0))
    assert (crew.size, crew.free) == (0, 2)
    crew.give(chunk(0))
    for _ in range(3):
        time.sleep(0.06)
        assert crew.take(0.0) == []
    client.threads = {"worker 0": 1}
    assert crew.take(0.0) == []
    assert crew.size == 1


class Raises:
    """In place of a bench."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def run(self, *_: object, **__: object) -> None:
        raise self.error


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (RecursionError("too deep"), Lost(chunk(0), "RecursionError: too deep", times=0)),
        (MemoryError(), Lost(chunk(0), "its worker had no memory left", times=1)),
    ],
)
def test_a_worker_raises_nothing_that_might_not_be_heard(
    plan: Plan, monkeypatch: pytest.MonkeyPatch, error: Exception, expected: Lost
) -> None:
    monkeypatch.setattr(cluster, "_bench", lambda *_: Raises(error))
    assert run_chunk(plan.files, plan.identity, chunk(0)) == expected


def test_an_episode_that_kills_every_worker_fails_alone_whatever_was_beside_it(
    tmp_path: Path, plan: Plan, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every task that is under way with the culprit is on the workers that it kills."""
    crew = DaskCrew(plan, "tcp://there")
    take = crew.take

    def next_events(timeout_s: float) -> Sequence[Event]:
        found = list(take(0.0))
        under_way = [future for future in client.futures if future.status == "pending"]
        deadly = any(future.chunk.stratum == 0 and 5 in future.chunk.episodes for future in under_way)
        for future in under_way:
            future.ends("error", killed()) if deadly else future.succeeds()
        return found

    monkeypatch.setattr(crew, "take", next_events)
    with ledger_in(tmp_path, plan) as ledger:
        assert CampaignRunner(plan, ledger, crew).run()
        assert [one.failed for one in tally_of(ledger).strata] == [1, 0]
        failed = list(ledger.all("SELECT stratum, episode, failure FROM episode WHERE failure IS NOT NULL"))
    assert failed == [(0, 5, "failed to run, 4 times: its worker died")]


def test_workers_that_cannot_begin_a_task_fail_no_episode_but_the_campaign(
    tmp_path: Path, plan: Plan, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    crew = DaskCrew(plan, "tcp://there")
    whole = client.submit

    def refused(*given: Any, **others: Any) -> Future:
        future = whole(*given, **others)
        monkeypatch.setattr(
            future, "add_done_callback", lambda tell: (setattr(future, "_tell", tell), go(future))
        )
        return future

    def go(future: Future) -> None:
        future.ends("error", ModuleNotFoundError("No module named 'safety_harness'"))

    monkeypatch.setattr(client, "submit", refused)
    with ledger_in(tmp_path, plan) as ledger:
        with pytest.raises(CampaignError, match=r"10 tasks in a row: .* No module named 'safety_harness'"):
            CampaignRunner(plan, ledger, crew).run()
        assert tally_of(ledger).done == 0


def test_a_mistake_in_the_plan_ends_the_campaign_once_all_before_it_was_told(
    plan: Plan, client: Client
) -> None:
    crew = DaskCrew(plan, "tcp://there")
    for k in range(2):
        crew.give(chunk(k))
    client.futures[0].succeeds()
    error = LedgerError(place=Place(file=plan.file), expected="the plan", got="Python changed")
    client.futures[1].ends("finished", error)
    (event,) = crew.take(0.0)
    assert isinstance(event, Arrived)
    with pytest.raises(LedgerError, match="Python changed"):
        crew.take(0.0)


def test_one_worker_that_cannot_begin_a_task_does_not_end_a_campaign(plan: Plan, client: Client) -> None:
    crew = DaskCrew(plan, "tcp://there")
    for k in range(40):
        crew.give(chunk(k))
        future = client.futures[-1]
        future.ends("finished", Lost(chunk(k), "OSError: disk full", times=0)) if k % 2 else future.succeeds()
        (event,) = crew.take(0.0)
        assert isinstance(event, Lost if k % 2 else Arrived)
        assert getattr(event, "times", 0) == 0
