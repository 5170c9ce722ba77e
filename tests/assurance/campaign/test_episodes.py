"""Episode k: the same wherever it runs, refusals drawn again, outcomes that never flatter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from partly_measured import partly_measured

from safety_harness.admission import trial
from safety_harness.admission.admit import Admitter
from safety_harness.admission.spaces import MAX_REJECTION_RATIO
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.extensions.assurance.campaign import episodes
from safety_harness.extensions.assurance.campaign.episodes import (
    EpisodeRunner,
    judgement_of,
    random_episodes,
    root_seed,
    why_broken,
)
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.model import Verdict
from safety_harness.trace.store import load_trace
from safety_harness.trace.trace import Trace
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT


def without_place(row: Row) -> Row:
    return replace(row, seconds=0.0, worker="", trace=None)


@pytest.mark.parametrize("world", ["kinematic", "PyBullet"])
def test_an_episode_is_the_same_in_whatever_order_and_company(tmp_path: Path, world: str) -> None:
    plan = plan_in(tmp_path, PLAN.replace("world: kinematic", f"world: {world}"))
    together = list(EpisodeRunner(plan).run(0, range(6)))
    backwards = [next(EpisodeRunner(plan).run(0, [k])) for k in (5, 3, 0)]
    assert [without_place(together[k]) for k in (5, 3, 0)] == [without_place(row) for row in backwards]
    assert len({row.seed for row in together}) == 6
    other = next(EpisodeRunner(plan).run(1, [0]))
    assert other.seed != together[0].seed


def test_an_episode_does_not_hang_on_its_stratum_s_position(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    text = PLAN.replace("near\n", "X\n").replace("nearer", "near").replace("X", "nearer")
    swapped = plan_in(tmp_path / "b", text)
    assert swapped.strata[1].name == "near"
    assert root_seed(plan, 0, 4) == root_seed(swapped, 1, 4)


def test_the_row_says_what_the_run_was(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    rows = list(EpisodeRunner(plan, worker="me").run(0, range(30)))
    violating = [row for row in rows if row.violates]
    assert violating
    row = violating[0]
    assert row.judgements[0].outcome is EpisodeOutcome.VIOLATED
    assert row.judgements[0].margin < 0.0
    assert row.judgements[1].outcome is EpisodeOutcome.HOLDS
    assert row.draws == 1
    assert row.worker == "me"
    assert row.decisions == row.proposed + row.opposite + row.stopped
    assert row.trace is not None
    (tmp_path / "t.trace").write_bytes(row.trace)
    trace = load_trace(tmp_path / "t.trace")
    assert trace.scenario.name == f"short#{row.episode}"
    assert [claim.sentence for claim in trace.scenario.claims] == [claim.sentence for claim in plan.claims]
    kept = {row.episode for row in rows if row.trace is not None}
    assert kept == {row.episode for row in violating} | random_episodes(plan, 0)
    assert not any(row.trace for row in EpisodeRunner(plan).run(0, [row.episode], keep_violations=False)) or (
        row.episode in random_episodes(plan, 0)
    )


def test_the_random_sample_is_declared_before_and_within_the_stratum(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    drawn = random_episodes(plan, 0)
    assert len(drawn) == 2
    assert drawn <= set(range(30))
    assert drawn == random_episodes(plan_in(tmp_path / "again"), 0)


def test_what_admission_refuses_is_drawn_again_and_counted(tmp_path: Path) -> None:
    space = TEXT.replace("[0 mm, from -40 mm", "[from 0 mm to 3 m, from -40 mm")
    rows = list(EpisodeRunner(plan_in(tmp_path, PLAN, space)).run(0, range(6)))
    assert max(row.draws for row in rows) > 1
    assert not any(row.failure for row in rows)


def test_an_episode_of_which_every_draw_is_refused_has_failed_and_is_not_left_out(tmp_path: Path) -> None:
    space = TEXT.replace("[0 mm, from -40 mm", "[from 2 m to 3 m, from -40 mm")
    row = next(EpisodeRunner(plan_in(tmp_path, PLAN, space)).run(0, [0]))
    assert [one.outcome for one in row.judgements] == [EpisodeOutcome.FAILED] * 2
    assert row.draws == MAX_REJECTION_RATIO
    assert "tcp start" in row.failure


def test_a_mistake_in_the_plan_is_raised_and_not_counted(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.replace("opposite pose", "nobody"))
    with pytest.raises(InadmissibleError, match="nobody") as caught:
        next(EpisodeRunner(plan).run(0, [0]))
    assert caught.value.place.line == 3


def test_a_run_that_cannot_be_carried_on_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> Trace:
        raise RuntimeError("the physics gave up")

    monkeypatch.setattr("safety_harness.admission.trial.run_trial", broken)
    row = next(EpisodeRunner(plan_in(tmp_path, PLAN.replace("world: kinematic\n", ""))).run(0, [0]))
    assert [one.outcome for one in row.judgements] == [EpisodeOutcome.FAILED] * 2
    assert "the physics gave up" in row.failure


@pytest.mark.parametrize("world", ["kinematic", "PyBullet"])
@pytest.mark.parametrize(("home", "where"), [(episodes, "property_of"), (Admitter, "admit")])
def test_an_error_of_the_harness_fails_its_episode_at_the_second_time_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, world: str, home: object, where: str
) -> None:
    plan = plan_in(tmp_path, PLAN.replace("world: kinematic", f"world: {world}"))
    undisturbed = list(EpisodeRunner(plan).run(0, range(3)))
    whole, raised = getattr(home, where), 0

    def odd(first: object, *rest: object, **others: object) -> object:
        nonlocal raised
        if "short#1" in {getattr(one, "name", "") for one in (first, *rest)}:
            raised += 1
            raise ZeroDivisionError("division of a margin by zero")
        return whole(first, *rest, **others)

    monkeypatch.setattr(home, where, odd)
    before, broken, after = EpisodeRunner(plan).run(0, range(3))
    assert [without_place(row) for row in (before, after)] == [
        without_place(row) for row in (undisturbed[0], undisturbed[2])
    ]
    assert [one.outcome for one in broken.judgements] == [EpisodeOutcome.FAILED] * 2
    assert "the harness itself: ZeroDivisionError: division of a margin by zero (test_epi" in broken.failure
    assert broken.seed == undisturbed[1].seed
    assert raised == 2


def test_an_error_of_the_harness_that_does_not_come_again_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_in(tmp_path)
    undisturbed = next(EpisodeRunner(plan).run(0, [0]))
    whole, calls = episodes.fault_of, 0

    def odd(trace: Trace) -> str:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise OSError("no file can be opened for a moment")
        return whole(trace)

    monkeypatch.setattr(episodes, "fault_of", odd)
    assert without_place(next(EpisodeRunner(plan).run(0, [0]))) == without_place(undisturbed)
    assert calls == 2


def test_a_worker_without_memory_is_replaced_and_its_episode_not_blamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def short(*_: object) -> str:
        raise MemoryError

    monkeypatch.setattr(episodes, "fault_of", short)
    with pytest.raises(MemoryError):
        next(EpisodeRunner(plan_in(tmp_path)).run(0, [0]))


def test_a_run_in_company_that_breaks_costs_the_others_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = trial._runs
    plan = plan_in(tmp_path)
    expected = list(EpisodeRunner(plan).run(0, range(3)))

    def breaks(admitted: list[object], *options: object) -> object:
        if any(one.scenario.name == "short#1" for one in admitted):  # type: ignore[attr-defined]
            raise RuntimeError("a bad one")
        return whole(admitted, *options)  # type: ignore[arg-type]

    monkeypatch.setattr(trial, "_runs", breaks)
    rows = list(EpisodeRunner(plan).run(0, range(3)))
    assert [bool(row.failure) for row in rows] == [False, True, False]
    assert without_place(rows[2]) == without_place(expected[2])


def evaluation(verdict: Verdict, exercised: int, margin: float | None = 1.0) -> Evaluation:
    return Evaluation(
        sentence="", verdict=verdict, unit=Unit.LENGTH, margin=margin, worst_time_s=0.0, reason="",
        exercised=exercised,
    )  # fmt: skip


def test_only_a_whole_run_that_never_tested_the_claim_says_nothing_of_it(visit: Trace) -> None:
    cut = replace(visit, ended="stopped", ticks=visit.ticks[:-5])
    ticks = visit.ticks.copy()
    ticks["sse"][3], ticks["object_visible"][3] = np.nan, True
    spoilt = replace(visit, ticks=ticks)
    assert why_broken(visit) == ""
    assert "cut short" in why_broken(cut)
    assert "none" in why_broken(spoilt)
    never, seen = evaluation(Verdict.INCONCLUSIVE, 0), evaluation(Verdict.INCONCLUSIVE, 3)
    held, violated = evaluation(Verdict.HOLDS, 3), evaluation(Verdict.VIOLATED, 3, -1.0)

    def outcome(of: Evaluation, trace: Trace) -> EpisodeOutcome:
        return judgement_of(of, trace, why_broken(trace)).outcome

    assert [outcome(one, visit) for one in (never, seen, held, violated)] == [
        EpisodeOutcome.UNTESTED,
        EpisodeOutcome.INCONCLUSIVE,
        EpisodeOutcome.HOLDS,
        EpisodeOutcome.VIOLATED,
    ]
    assert [outcome(one, cut) for one in (never, seen, violated)] == [
        EpisodeOutcome.FAILED,
        EpisodeOutcome.FAILED,
        EpisodeOutcome.VIOLATED,
    ]
    assert [outcome(one, spoilt) for one in (never, seen, held)] == [EpisodeOutcome.INCONCLUSIVE] * 3


def test_a_claim_that_reads_what_was_not_measured_is_untested_on_whatever_occasions(visit: Trace) -> None:
    trace = partly_measured(visit)
    assert why_broken(trace) == ""
    seen = evaluation(Verdict.INCONCLUSIVE, 3, None)
    assert judgement_of(seen, trace, "").outcome is EpisodeOutcome.INCONCLUSIVE
    found = judgement_of(replace(seen, unmeasured=("mode",)), trace, "")
    assert (found.outcome, found.exercised) == (EpisodeOutcome.UNTESTED, 0)


MINE = """\
from safety_harness import Proposal


class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.1, 0.0])


class Many(Mine):
    def propose_many(self, hands_in_base_m, tcps_in_base_m, seeds):
        return tcps_in_base_m + [0.0, 0.1, 0.0], 0.0 * tcps_in_base_m
"""


SLEEPY = MINE.replace(
    "return",
    "import time; from pathlib import Path; "
    "time.sleep(float(Path(__file__).with_suffix('.s').read_text())); return",
    1,
)


@pytest.mark.parametrize("world", ["kinematic", "PyBullet"])
def test_an_episode_does_not_depend_on_how_long_its_answers_take(tmp_path: Path, world: str) -> None:
    (tmp_path / "mine.py").write_text(SLEEPY)
    text = PLAN.replace("opposite pose", "mine.py:Mine").replace("world: kinematic", f"world: {world}")
    bench = EpisodeRunner(plan_in(tmp_path, text))
    rows = []
    for seconds in ("0", "0.12"):
        (tmp_path / "mine.s").write_text(seconds)
        rows.append([without_place(row) for row in bench.run(0, range(3))])
    assert rows[0] == rows[1]
    assert sum(row.decisions for row in rows[0]) > 0
    assert sum(row.late for row in rows[0]) == 0


@pytest.mark.parametrize("world", ["kinematic", "PyBullet"])
def test_an_episode_whose_avoider_hangs_has_failed_and_the_others_go_on(tmp_path: Path, world: str) -> None:
    hangs = MINE.replace("return", "time.sleep(600.0 if seed % 3 == 1 else 0.0); return", 1)
    (tmp_path / "mine.py").write_text("import time\n" + hangs)
    text = PLAN.replace("opposite pose", "mine.py:Mine").replace("world: kinematic", f"world: {world}")
    plan = plan_in(tmp_path, text, TEXT + "settings: {clock: {wall limit: 500 ms}}\n")
    rows = list(EpisodeRunner(plan).run(0, range(6)))
    failed = [row for row in rows if row.failure]
    assert 0 < len(failed) < 6
    for row in failed:
        assert "the run failed: NoAnswerError" in row.failure
        assert {one.outcome for one in row.judgements} == {EpisodeOutcome.FAILED}
