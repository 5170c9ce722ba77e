"""The runner and its processes: every episode once, whatever crashes, hangs, grows or arrives late."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness.base.compiling import Compiled, Pace
from safety_harness.base.exceptions import CampaignError, InadmissibleError, LedgerError, OutputError
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, random_episodes
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.processes import (
    Arrived,
    Chunk,
    Event,
    Limits,
    Lost,
    Processes,
)
from safety_harness.extensions.assurance.campaign.runner import ATTEMPTS, CampaignRunner
from safety_harness.extensions.assurance.campaign.session import plan_of, processes, run_missing
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from safety_harness.extensions.assurance.commands.progress import _head
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from tests.assurance.campaign.benches import Crashes, Grows, Hangs, IsMistaken, NeverReady, Plain, row_of
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

QUICK = Limits(silence_s=3.0, first_s=60.0)


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path)


class Here:
    """A crew in this process: hands chunks back in whatever order, and loses what it is told to lose."""

    replaced = 0

    def __init__(self, size: int = 3, lose: Sequence[tuple[int, int]] = (), backwards: bool = False) -> None:
        self.size, self._lose, self._backwards = size, set(lose), backwards
        self._chunks: list[Chunk] = []
        self.given: list[Chunk] = []

    @property
    def free(self) -> int:
        return self.size - len(self._chunks)

    def give(self, chunk: Chunk) -> None:
        self._chunks.append(chunk)
        self.given.append(chunk)

    def take(self, timeout_s: float) -> Sequence[Event]:
        chunk = self._chunks.pop(-1 if self._backwards else 0)
        rows = []
        for episode in chunk.episodes:
            if (chunk.stratum, episode) in self._lose:
                return [Arrived(chunk, tuple(rows), last=False), Lost(chunk, "it was lost")]
            rows.append(row_of(chunk.stratum, episode, trace=b"t" if chunk.keep_violations else None))
        return [Arrived(chunk, tuple(rows), last=True)]

    def close(self) -> None:
        pass


def fingerprint_after(folder: Path, plan: Plan, crew: Here) -> str:
    with ledger_in(folder, plan) as ledger:
        assert CampaignRunner(plan, ledger, crew).run()
        assert [list(ledger.missing(k)) for k in (0, 1)] == [[], []]
        return fingerprint_of(ledger)


def test_every_planned_episode_is_run_once_whatever_the_number_and_order(tmp_path: Path, plan: Plan) -> None:
    whole = fingerprint_after(tmp_path / "a", plan, Here(1))
    assert whole == fingerprint_after(tmp_path / "b", plan, Here(5, backwards=True))


def test_an_episode_that_is_always_lost_has_failed_to_run_and_costs_no_other(
    tmp_path: Path, plan: Plan
) -> None:
    crew = Here(2, lose=[(0, 5), (1, 0)])
    with ledger_in(tmp_path, plan) as ledger:
        assert CampaignRunner(plan, ledger, crew).run()
        tally = tally_of(ledger)
        assert [one.failed for one in tally.strata] == [1, 1]
        assert ledger.outcomes(0, 0)[1][5] == EpisodeOutcome.FAILED
        assert ledger.sample("near", plan.claims[1].sentence).at_worst == 5 + 1  # counted as a violation
        ((why,),) = ledger.all("SELECT failure FROM episode WHERE stratum = 0 AND episode = 5")
        assert "failed to run" in why
        assert "it was lost" in why
    assert sum(chunk.episodes == (5,) and chunk.stratum == 0 for chunk in crew.given) == ATTEMPTS


def test_an_episode_that_no_worker_came_to_is_not_to_blame(tmp_path: Path, plan: Plan) -> None:
    class NotYet(Here):
        def take(self, timeout_s: float) -> Sequence[Event]:
            found = super().take(timeout_s)
            return [replace(one, times=0) if isinstance(one, Lost) else one for one in found]

    crew = NotYet(2, lose=[(0, 5)])
    looks = 0

    def enough() -> bool:
        nonlocal looks
        looks += 1
        return looks > 200

    with ledger_in(tmp_path, plan) as ledger:
        assert not CampaignRunner(plan, ledger, crew, enough=enough).run()
        assert tally_of(ledger).done == 49
    assert sum(chunk.episodes == (5,) for chunk in crew.given) > ATTEMPTS


def test_the_first_violations_are_kept_by_their_numbers(tmp_path: Path, plan: Plan) -> None:
    for name, crew in (("a", Here(1)), ("b", Here(4, backwards=True))):
        with ledger_in(tmp_path / name, plan) as ledger:
            CampaignRunner(plan, ledger, crew).run()
            for stratum, expected in ((0, [0, 7, 14]), (1, [0, 7, 14])):
                kept = set(ledger.violations_kept(stratum)) - random_episodes(plan, stratum)
                assert kept == set(expected) - random_episodes(plan, stratum)


def test_what_was_asked_to_end_ends_with_what_was_under_way_and_goes_on_later(
    tmp_path: Path, plan: Plan
) -> None:
    calls = 0

    def enough() -> bool:
        nonlocal calls
        calls += 1
        return calls > 3

    with ledger_in(tmp_path / "a", plan) as ledger:
        assert not CampaignRunner(plan, ledger, Here(2), enough=enough).run()
        assert 0 < tally_of(ledger).done < 50
        again = Here(2)
        assert CampaignRunner(plan, ledger, again).run()
        assert sum(len(chunk.episodes) for chunk in again.given) < 50
        assert fingerprint_of(ledger) == fingerprint_after(tmp_path / "b", plan, Here(1))


def test_parts_are_apart_and_together_the_whole(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        first = CampaignRunner(plan, ledger, Here(2), part=(0, 2))
        assert first.standing == (0, 25)
        assert not first.run()
        assert first.standing == (25, 25)
        assert first.left == 0
        assert ledger.outcomes(0, 0)[0].tolist() == list(range(0, 30, 2))
        assert CampaignRunner(plan, ledger, Here(2), part=(1, 2)).standing == (0, 25)
        assert CampaignRunner(plan, ledger, Here(2), part=(1, 2)).run()


def test_a_stratum_that_may_stop_early_does_so_at_the_same_episode_whoever_is_quicker(tmp_path: Path) -> None:
    text = PLAN.replace("seed: 7", "seed: 7\nstop early: yes").replace("runs: 30", "runs: 2000")
    text = text.replace("limits\n", "limits\n    violated in at most: 45 %\n")
    plan = plan_in(tmp_path, text)
    ends = []
    for name, crew in (("a", Here(1)), ("b", Here(9, backwards=True))):
        with ledger_in(tmp_path / name, plan) as ledger:
            assert CampaignRunner(plan, ledger, crew).run()
            ends.append((ledger.stopped_after(0), fingerprint_of(ledger)))
            after = ledger.stopped_after(0)
            assert after is not None
            assert 0 < after < 2000
            sample = ledger.sample("near", plan.claims[0].sentence)
            assert len(sample.outcomes) == after
            assert tally_of(ledger).strata[0].done == after
    assert ends[0] == ends[1]


def test_a_ledger_that_takes_no_more_ends_the_campaign_and_keeps_what_it_has(
    tmp_path: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, calls = Ledger.record, 0

    def full(self: Ledger, rows: object) -> None:
        nonlocal calls
        calls += 1
        if calls > 2:
            raise OutputError.from_os_error(self.path, OSError("no space"))
        record(self, rows)  # type: ignore[arg-type]

    with ledger_in(tmp_path, plan) as ledger:
        monkeypatch.setattr(Ledger, "record", full)
        monkeypatch.setattr("safety_harness.extensions.assurance.campaign.runner._COMMIT_S", 0.0)
        with pytest.raises(OutputError):
            CampaignRunner(plan, ledger, Here(1)).run()
        monkeypatch.undo()
        done = tally_of(ledger).done
        assert 0 < done < 50
        assert CampaignRunner(plan, ledger, Here(1)).run()


def test_a_clock_of_the_day_that_goes_backwards_changes_nothing(
    tmp_path: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch, undisturbed: str
) -> None:
    now = iter(range(10**9, 0, -3600))
    monkeypatch.setattr(time, "time", lambda: float(next(now)))
    monkeypatch.setattr(time, "time_ns", lambda: next(now) * 10**9)
    with crew_of(Plain()) as crew:
        assert run_with(tmp_path / "ledger", plan, crew) == (undisturbed, 0)


def test_progress_says_how_it_stands(tmp_path: Path, plan: Plan) -> None:
    shown: list[CampaignRunner] = []
    with ledger_in(tmp_path, plan) as ledger:
        CampaignRunner(plan, ledger, Here(2), on_progress=shown.append).run()
    assert shown[-1].tally.complete
    assert shown[-1].done_now == 50
    assert shown[-1].left == 0
    assert _head(shown[-1]).startswith("50/50 episodes (100 %)")


def test_a_campaign_names_no_time_left_until_an_episode_came_after_the_compilation(
    tmp_path: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    with ledger_in(tmp_path, plan) as ledger:
        campaign = CampaignRunner(plan, ledger, Here(2))
    campaign.pace = Pace(lambda: clock[0])
    heads = []
    for clock[0], campaign.done_now in ((90.0, 1), (91.0, 11), (150.0, 12), (151.0, 22)):
        if clock[0] == 150.0:
            monkeypatch.setattr(Compiled, "count", Compiled.count + 1)
        heads.append(_head(campaign))
    assert ["left" in head for head in heads] == [False, True, False, True]
    assert heads[1] == heads[3] == "0/50 episodes (0 %), 10.0 a second, 5 s left"


@contextmanager
def crew_of(make: Plain, size: int = 2, limits: Limits = QUICK) -> Iterator[Processes]:
    with closing(Processes(make, size, limits)) as crew:
        yield crew


def run_with(folder: Path, plan: Plan, crew: Processes) -> tuple[str, int]:
    with ledger_in(folder, plan) as ledger:
        assert CampaignRunner(plan, ledger, crew).run()
        tally = tally_of(ledger)
        assert tally.done == 50
        return fingerprint_of(ledger), sum(stratum.failed for stratum in tally.strata)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("undisturbed")
    return fingerprint_after(folder, plan_in(folder), Here(1))


@pytest.mark.parametrize("kind", [Crashes, Hangs, Grows])
def test_a_worker_that_goes_wrong_once_is_replaced_and_nothing_is_lost(
    tmp_path: Path, plan: Plan, undisturbed: str, kind: type[Crashes]
) -> None:
    limits = Limits(silence_s=3.0, first_s=60.0, resident_bytes=400 * 2**20)
    with crew_of(kind(at=5, times=1, folder=tmp_path), limits=limits) as crew:
        assert run_with(tmp_path / "ledger", plan, crew) == (undisturbed, 0)
        assert crew.replaced == 1


def test_an_episode_that_always_crashes_its_worker_is_recorded_as_failed(tmp_path: Path, plan: Plan) -> None:
    with crew_of(Crashes(at=5, folder=tmp_path)) as crew:
        _, failed = run_with(tmp_path / "ledger", plan, crew)
    assert failed == 1
    with Ledger.open(tmp_path / "ledger" / "ledger.sqlite") as ledger:
        ((why,),) = ledger.all("SELECT failure FROM episode WHERE failure IS NOT NULL")
        assert "exit code 3" in why


def test_workers_are_replaced_after_a_number_of_episodes(
    tmp_path: Path, plan: Plan, undisturbed: str
) -> None:
    with crew_of(Plain(), limits=Limits(episodes=5)) as crew:
        assert run_with(tmp_path / "ledger", plan, crew) == (undisturbed, 0)
    with Ledger.open(tmp_path / "ledger" / "ledger.sqlite") as ledger:
        ((workers,),) = ledger.all("SELECT count(DISTINCT worker) FROM episode")
        assert workers > 2


def test_workers_killed_at_any_moment_cost_nothing(tmp_path: Path, plan: Plan, undisturbed: str) -> None:
    with crew_of(Plain(seconds=0.02)) as crew:
        over = threading.Event()

        def kill() -> None:
            for k in range(4):
                if over.wait(0.15):
                    return
                crew.workers[k % 2].process.kill()

        killer = threading.Thread(target=kill)
        killer.start()
        try:
            assert run_with(tmp_path / "ledger", plan, crew) == (undisturbed, 0)
        finally:
            over.set()
            killer.join()


def test_a_mistake_in_the_plan_ends_the_campaign_with_its_place(tmp_path: Path, plan: Plan) -> None:
    with crew_of(IsMistaken(at=5, folder=tmp_path), size=1) as crew, ledger_in(tmp_path, plan) as ledger:
        with pytest.raises(InadmissibleError, match="one that is there"):
            CampaignRunner(plan, ledger, crew).run()
        assert tally_of(ledger).done == 5


def test_workers_that_cannot_be_started_are_said_to_be(tmp_path: Path, plan: Plan) -> None:
    with crew_of(NeverReady(), size=1) as crew, ledger_in(tmp_path, plan) as ledger:
        with pytest.raises(CampaignError, match="exit code 9"):
            CampaignRunner(plan, ledger, crew).run()
        assert tally_of(ledger).done == 0


def test_workers_end_when_nobody_is_there_any_more(plan: Plan) -> None:
    with crew_of(Plain(), size=1) as crew:
        (worker,) = crew.workers
        process = worker.process.pid
        worker.lifeline.close()
        for _ in range(500):
            if not Path(f"/proc/{process}").exists() or "Z" in Path(f"/proc/{process}/stat").read_text():
                break
            time.sleep(0.01)
        else:
            pytest.fail("it goes on")


def test_a_real_plan_in_processes_is_bit_for_bit_the_same_as_in_one(tmp_path: Path) -> None:
    text = PLAN.replace("runs: 30", "runs: 12").replace("runs: 20", "runs: 8")
    plan = plan_in(tmp_path, text.replace("violations: 3", "violations: 100"))
    with ledger_in(tmp_path / "alone", plan) as ledger:
        for stratum, runs in ((0, 12), (1, 8)):
            ledger.record(EpisodeRunner(plan).run(stratum, range(runs)))
        alone = fingerprint_of(ledger)
    path = tmp_path / "together" / "ledger.sqlite"
    looks = iter([False, False, True])
    assert not run_missing(plan, path, processes(2), enough=lambda: next(looks, True))
    assert run_missing(plan, path, processes(2))
    assert run_missing(plan, path, lambda plan: pytest.fail("there is nothing left to run"))
    with Ledger.open(path) as ledger:
        assert fingerprint_of(ledger) == alone


def test_a_plan_whose_file_is_gone_is_taken_from_its_ledger(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path / "ledger", plan) as ledger:
        plan.file.unlink()
        with plan_of(ledger) as found:
            assert found.identity == plan.identity
            assert found.file != plan.file


def test_a_plan_that_has_changed_since_is_named(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path / "ledger", plan) as ledger:
        space = tmp_path / "short.yaml"
        space.write_text(space.read_text().replace("to 2 m/s", "to 1.9 m/s"))
        with pytest.raises(LedgerError, match=r"the file short\.yaml changed"), plan_of(ledger):
            pass
