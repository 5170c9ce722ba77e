"""Of the same data the monitor says what ``judge`` says of its log, and neither contradicts what was true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from cells import Cell, cell, endless_arm, recorded, said, wrapped
from hypothesis import given, settings
from hypothesis import strategies as st
from stream_lines import lines
from truths import FINE_M, FINE_S, truth_at

from safety_harness.admission.trial import judge
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.field.logs.judging import recorded as recorded_log
from safety_harness.extensions.field.monitoring.cell import read_cell
from safety_harness.extensions.field.monitoring.journal import Journal
from safety_harness.extensions.field.monitoring.monitor import Monitor, VerdictLine
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

LIMITS_MM = (50, 120, 200, 260)
CLAIMS = [
    *(f"always hand distance > {limit} mm" for limit in LIMITS_MM),
    "always nearest hand to TCP > 300 mm",
    "always TCP speed < 700 mm/s",
    "(always TCP height > 200 mm) and (eventually hand distance < 300 mm)",
    "always (within 300 ms hand distance > 250 mm)",
    "whenever hand distance < 300 mm then within 200 ms TCP speed < 400 mm/s",
    "hand distance > 200 mm until nearest hand to TCP < 500 mm",
    "not (eventually joint speed > 70 deg/s)",
    "initially hand distance > 400 mm",
    "hand distance never below 150 mm",
    "TCP speed never above 600 mm/s",
]


def watched_and_judged(
    seed: int, folder: Path, seconds: float, *, ends: bool = False
) -> tuple[list[VerdictLine], list[Evaluation], Trace, Cell]:
    """A cell's stream through the monitor, and the monitor's log through ``judge``.

    With ``ends`` the hands begin and end up to 90 ms after or before the joints, and the stream is cut off.
    """
    rng = np.random.default_rng(seed)
    one = cell(rng)
    begin = float(rng.uniform(0.2, 0.6))
    lost = ((begin, begin + float(rng.uniform(0.05, 0.3))),) if rng.random() < 0.4 else ()
    streams = recorded(one, rng, seconds=seconds, lost=lost, start_ns=1_000_000_000)
    (folder / "CELL.yaml").write_text(said("joints.csv", "hand.csv", "elbow"))
    own = Monitor(cell=read_cell(folder / "CELL.yaml", CLAIMS), wait_s=float(rng.choice([0.0, 0.05])))
    out = folder / "log"
    own.journal = Journal(cell=own.cell, claims=CLAIMS, folder=out, most_bytes=10**9, keep=2)
    if ends:
        hand_s = (streams.hand_ns - streams.joint_ns[0]) / 1e9 - 0.137
        there = (hand_s > rng.uniform(-0.03, 0.09)) & (hand_s < seconds + rng.uniform(-0.09, 0.03))
        kept = {name: getattr(streams, name)[there] for name in ("hand_ns", "hand_m", "elbow_m")}
        streams = replace(streams, **kept)
    come = lines(streams, latency_s=float(rng.uniform(0.0, 0.08)))
    for line in come[: int(rng.integers(100, len(come) + 1)) if ends else None]:
        list(own.take(line))
    list(own.end())
    own.journal.close()
    trace = recorded_log(own.journal.latest).trace
    offline = list(judge(trace))
    assert [one.sentence for one in trace.scenario.claims] == CLAIMS
    assert own.counts.ticks == len(trace.ticks)
    return own.verdicts(), offline, trace, one


def disagreements(seed: int, seconds: float = 0.9, *, ends: bool = False) -> tuple[list[str], int, int]:
    """What contradicts ``judge`` or the truth; how many claims ``judge`` and the monitor decide."""
    with TemporaryDirectory() as folder:
        online, offline, trace, one = watched_and_judged(seed, Path(folder), seconds, ends=ends)
    found = []
    for now, judged in zip(online, offline, strict=True):
        same = now.verdict is judged.verdict
        # what judge leaves open, as it takes the largest uncertainty of the run, the monitor may decide
        if not same and judged.verdict is not Verdict.INCONCLUSIVE:
            found.append(f"{seed}: {now} is {judged.verdict} by judge: {judged.reason}")
    seconds = float(len(trace.ticks) - 1) * trace.scenario.settings.clock.control_period_s
    fine = truth_at(trace, one, np.arange(0.0, seconds, FINE_S))
    true_mm = float(fine.ticks["hand_distance_m"][:, 0].min()) * 1e3
    for now, limit in zip(online, LIMITS_MM, strict=False):
        true = true_mm - limit
        if now.verdict is Verdict.VIOLATED:
            wrong = now.margin is None or now.margin < true - FINE_M * 1e3
        else:
            wrong = now.margin is not None and now.margin > true
        if wrong:
            found.append(f"{seed}: {now} but the true margin is {true:.2f} mm")
    decided = [sum(one.verdict is not Verdict.INCONCLUSIVE for one in side) for side in (offline, online)]
    return found, *decided


@settings(max_examples=4, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_what_judge_decides_the_monitor_says_too(seed: int) -> None:
    found, judged, watched = disagreements(seed)
    assert not found
    assert watched >= judged > 0


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_monitor_and_judge_agree_where_a_stream_begins_and_wherever_it_is_cut_off(seed: int) -> None:
    """The joints may begin before the hands: both know a hand from half of its longest gap before it."""
    found, judged, watched = disagreements(seed, ends=True)
    assert not found
    assert watched >= judged


@pytest.mark.parametrize("wraps", [False, True])
def test_a_joint_without_ends_that_wraps_goes_the_short_way_here_as_for_judge(
    tmp_path: Path, wraps: bool
) -> None:
    streams = wrapped(recorded(cell(rng := np.random.default_rng(3)), rng, seconds=0.8), 5)
    if not wraps:
        streams = replace(streams, joints_rad=np.unwrap(streams.joints_rad, axis=0))
    text = said("joints.csv", "hand.csv", "elbow").replace("UR10", f"{{arm: {endless_arm(tmp_path)}}}")
    (tmp_path / "CELL.yaml").write_text(text)
    claims = ["always joint speed < 60 deg/s", "always TCP height > 50 mm"]
    own = Monitor(cell=read_cell(tmp_path / "CELL.yaml", claims))
    own.journal = Journal(cell=own.cell, claims=claims, folder=tmp_path / "log", most_bytes=10**9, keep=2)
    for line in [*lines(streams)]:
        list(own.take(line))
    list(own.end())
    own.journal.close()
    assert own.counts.refused == 0
    offline = judge(recorded_log(own.journal.latest).trace)
    assert [one.verdict for one in own.verdicts()] == [one.verdict for one in offline] == [Verdict.HOLDS] * 2


@pytest.mark.long
def test_what_judge_decides_the_monitor_says_too_in_many_cells() -> None:
    all_found = [disagreements(seed, 1.6) for seed in range(400)]
    all_found += [disagreements(seed, ends=True) for seed in range(400)]
    assert not [text for found, _, _ in all_found for text in found]
    judged, watched = (sum(one[side] for one in all_found) for side in (1, 2))
    assert watched >= judged > 0.4 * len(CLAIMS) * len(all_found)
