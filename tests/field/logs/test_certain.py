"""A verdict on a log is that of whatever happened within what is said of it, or there is none."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from cells import cell, recorded, said, write_csv
from truths import Judged, judged_logs, truth_at

from safety_harness.admission.trial import judge
from safety_harness.extensions.field.logs.certain import trace_from_log
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import Verdict
from safety_harness.trace.known import Source
from safety_harness.trace.store import load_trace, save_trace

LOGS = 200


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> list[Judged]:
    folder = tmp_path_factory.mktemp("logs")
    return [one for seed in range(LOGS) for one in judged_logs(seed, folder)]


def test_no_verdict_is_false(judged: list[Judged]) -> None:
    assert [one for one in judged if one.false] == []
    verdicts = Counter(one.found.verdict for one in judged)
    assert min(verdicts[Verdict.HOLDS], verdicts[Verdict.VIOLATED]) > LOGS // 4  # both are given


def test_a_margin_that_is_certain_is_no_better_than_the_true_one(judged: list[Judged]) -> None:
    of_distance = [one for one in judged if "hand distance" in one.sentence]
    holds = [
        one for one in of_distance if one.found.verdict is Verdict.HOLDS and one.found.margin is not None
    ]
    assert holds
    assert all(one.found.margin <= one.true_m for one in holds)


def test_nine_in_ten_are_decided_whose_margin_is_twice_the_uncertainty(judged: list[Judged]) -> None:
    clear = [one for one in judged if one.clear]
    assert len(clear) > LOGS // 4
    assert sum(one.decided for one in clear) >= 0.9 * len(clear)


def _log(folder: Path, seed: int = 3, text: str = "", **how: object) -> Path:
    rng = np.random.default_rng(seed)
    write_csv(recorded(cell(rng), rng, seconds=1.6, **how), folder)  # type: ignore[arg-type]
    file = folder / "LOG.yaml"
    file.write_text(text or said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))
    return file


def test_every_column_is_within_what_is_known_of_it(tmp_path: Path) -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        true_cell = cell(rng)
        write_csv(recorded(true_cell, rng, seconds=1.6, lost=((0.5, 0.6),)), tmp_path)
        (tmp_path / "LOG.yaml").write_text(said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))
        trace = trace_from_log(read_log(tmp_path / "LOG.yaml")).trace
        true, count = truth_at(trace, true_cell, trace.time_s).ticks, len(trace.ticks)
        for name in ("joint_position_rad", "joint_velocity_radps", "tcp_speed_mps"):
            off = np.abs(trace.ticks[name] - true[name]).reshape(count, -1).max(axis=1)
            assert (off <= trace.known.uncertainty_of(name, count) + 1e-9).all(), name
        for name in ("hand_position_in_base_m", "elbow_position_in_base_m"):
            off = np.linalg.norm(trace.ticks[name][:, 0] - true[name][:, 0], axis=1)
            assert (off <= trace.known.uncertainty_of(name, count) + 1e-9).all(), name
        off = np.abs(trace.ticks["hand_distance_m"][:, 0] - true["hand_distance_m"][:, 0])
        assert (off <= trace.known.uncertainty_of("hand_distance_m", count) + 1e-9).all()


def test_beyond_the_longest_gap_nothing_is_known(tmp_path: Path) -> None:
    trace = trace_from_log(read_log(_log(tmp_path, lost=((0.6, 0.9),)))).trace
    (gap,) = trace.known.column("hand_distance_m").gaps
    assert gap.hand == 0
    assert 0.5 < trace.time_s[gap.first] < 0.65
    assert 0.85 < trace.time_s[gap.after] < 1.0
    never = judge(trace)[0]
    assert never.verdict is Verdict.INCONCLUSIVE
    assert "hand from 0." in never.reason


def test_the_clock_that_is_said_wrongly_known_widens_what_is_certain(tmp_path: Path) -> None:
    text = said("joints.csv", "hands.csv#hand", "hands.csv#elbow")
    close = trace_from_log(read_log(_log(tmp_path, text=text))).trace
    loose = trace_from_log(
        read_log(_log(tmp_path, text=text.replace("known to: 5 ms", "known to: 55 ms")))
    ).trace
    wider = loose.known.uncertainty_of("hand_distance_m", 100) - close.known.uncertainty_of(
        "hand_distance_m", 100
    )
    assert wider == pytest.approx(0.05, abs=0.015)  # 1 m/s for 50 ms more


def test_what_nobody_recorded_is_inconclusive_and_the_rest_is_the_logs(tmp_path: Path) -> None:
    found = trace_from_log(read_log(_log(tmp_path)))
    verdicts = {one.sentence: one for one in judge(found.trace)}
    away = verdicts["never retreats without a hand"]
    assert away.verdict is Verdict.INCONCLUSIVE
    assert "mode" in away.unmeasured
    assert found.trace.known.recorded
    assert found.trace.known.column("joint_position_rad").source is Source.LOG
    assert found.trace.known.column("hand_distance_m").source is Source.DERIVED
    assert "recorded, not simulated" in found.notes[0]


def test_its_trace_is_stored_and_judged_alike(tmp_path: Path) -> None:
    found = trace_from_log(read_log(_log(tmp_path, lost=((0.6, 0.7),))))
    save_trace(found.trace, tmp_path / "log.trace", recordings=found.recordings)
    again = load_trace(tmp_path / "log.trace")
    assert again.known == found.trace.known
    assert judge(again) == judge(found.trace)


def test_without_a_forearm_only_hands_alone_are_judged(tmp_path: Path) -> None:
    text = said("joints.csv", "hands.csv#hand", "not measured")
    trace = trace_from_log(read_log(_log(tmp_path, text=text))).trace
    (never, *_) = judge(trace)
    assert never.verdict is Verdict.INCONCLUSIVE
    assert "hands without their forearms" in never.reason
    assert "elbow_position_in_base_m" in never.unmeasured
    none = trace_from_log(read_log(_log(tmp_path, text=said("joints.csv", "hands.csv#hand", "none")))).trace
    assert not none.known.missing(["elbow_position_in_base_m", "hand_distance_m"])
    assert "not bounded" not in judge(none)[0].reason
