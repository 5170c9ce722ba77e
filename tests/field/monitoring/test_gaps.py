"""What a gap longer than said leaves open, for ``judge`` and the monitor alike, wherever the ticks fall."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cells import MIDDLE_RAD, NAMES, Floats, tcp_m

from safety_harness.admission.trial import judge
from safety_harness.extensions.field.logs.judging import recorded
from safety_harness.extensions.field.logs.reach import over_ticks
from safety_harness.extensions.field.monitoring.cell import read_cell
from safety_harness.extensions.field.monitoring.monitor import Monitor
from safety_harness.extensions.field.monitoring.tracks import WithinByTick
from safety_harness.scenario.model import Verdict

BEGIN_S, END_S = 1.0002, 1.0498  # between two ticks
PERIODIC_S = np.arange(0.0, 2.0001, 0.05)  # at the ticks
OFTEN_S = np.round(np.arange(-0.2, 2.0301, 0.01), 4)  # no joints for longer at the end: they are lost
FAR_M = tcp_m(MIDDLE_RAD[None])[0] + [0.45, 0.0, 0.0]
SAID = """\
log: {{joints: joints.csv, hands: hands.csv#hand, period: 50 ms}}
clock: {{hands are ahead by: 0 ms, known to: 0 ms}}
joints: {{known to: 0.0001 deg, accelerate at most: 0.001 rad/s2, longest gap: {joints}}}
hands: {{forearm: none, frame: base, longest gap: {hands}, moves at most: 2 m/s, known to: 1 mm}}
settings: {{hand: {{forearm radius: 40 mm, radius: 60 mm}}}}
claims: ["{claim}"]
"""
DISTANCE, HEIGHT = "always hand distance > 250 mm", "always TCP height > 100 mm"


def without(time_s: Floats, begin_s: float, end_s: float) -> Floats:
    """Samples at both ends and none between."""
    kept = time_s[(time_s < begin_s) | (time_s > end_s)]
    return np.sort(np.concatenate([kept, [begin_s, end_s]]))


def verdicts(
    folder: Path,
    claim: str,
    joint_s: Floats,
    hand_s: Floats,
    *,
    joints: str = "100 ms",
    hands: str = "100 ms",
) -> tuple[Verdict, Verdict]:
    """By ``judge`` and by the monitor, of an arm and a hand that stand still whenever they are seen."""
    tables = {"joints": (joint_s, MIDDLE_RAD, [f"{name}_rad" for name in NAMES])}
    tables["hands"] = hand_s, FAR_M, ["hand_x_m", "hand_y_m", "hand_z_m"]
    for name, (time_s, row, names) in tables.items():
        rows = [",".join([f"{at:.9f}", *map(str, row.tolist())]) for at in time_s]
        (folder / f"{name}.csv").write_text("\n".join([",".join(["time_s", *names]), *rows]) + "\n")
    file = folder / "LOG.yaml"
    file.write_text(SAID.format(joints=joints, hands=hands, claim=claim))
    (offline,) = judge(recorded(file).trace)
    own = Monitor(cell=read_cell(file, []))
    come = [(at, {"joint_position_rad": MIDDLE_RAD.tolist()}) for at in joint_s]
    come += [(at, {"hands": {"hand": {"hand_position_in_base_m": FAR_M.tolist()}}}) for at in hand_s]
    for at, told in sorted(come, key=lambda one: (one[0], "hands" not in one[1])):
        list(own.take(json.dumps({"time_s": round(100.0 + at, 6)} | told).encode()))
    list(own.end())
    return offline.verdict, own.verdicts()[0].verdict


BOTH_HOLD, BOTH_OPEN = (Verdict.HOLDS,) * 2, (Verdict.INCONCLUSIVE,) * 2


def test_a_gap_of_a_hand_between_two_ticks_is_a_gap(tmp_path: Path) -> None:
    hand_s = without(OFTEN_S, BEGIN_S, END_S)
    assert verdicts(tmp_path, DISTANCE, PERIODIC_S, OFTEN_S, hands="49 ms") == BOTH_HOLD
    for longest in ("49 ms", "60 ms"):  # 60 ms: it may have come 50 mm nearer
        assert verdicts(tmp_path, DISTANCE, PERIODIC_S, hand_s, hands=longest) == BOTH_OPEN


@pytest.mark.parametrize("claim", [DISTANCE, HEIGHT])
@pytest.mark.parametrize("ends_s", [(BEGIN_S, END_S), (1.0, 1.05), (1.0, 1.0498), (1.0002, 1.05)])
def test_a_gap_of_the_joints_between_two_ticks_is_a_gap(
    tmp_path: Path, claim: str, ends_s: tuple[float, float]
) -> None:
    whole_s, joint_s = OFTEN_S[OFTEN_S >= 0.0], without(OFTEN_S[OFTEN_S >= 0.0], *ends_s)
    assert verdicts(tmp_path, claim, whole_s, OFTEN_S, joints="45 ms") == BOTH_HOLD
    assert verdicts(tmp_path, claim, joint_s, OFTEN_S, joints="45 ms") == BOTH_OPEN


def test_a_first_sample_before_a_gap_tells_no_speed(tmp_path: Path) -> None:
    """What is derived there is the mean of the gap."""
    joint_s = OFTEN_S[(OFTEN_S >= 0.12) | (OFTEN_S == 0.0)]
    assert verdicts(tmp_path, "initially joint speed > 1 deg/s", joint_s, OFTEN_S) == BOTH_OPEN


def test_the_monitor_has_the_gaps_and_bounds_of_judge() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        time_ns = np.unique(np.append(rng.integers(1, 80, 14), [0, 80])) * 25  # many of them at ticks
        off = rng.uniform(0.1, 1.0, len(time_ns) - 1)
        offline = over_ticks(time_ns, off, longest_ns=180, period_ns=100, count=21)
        online = WithinByTick(180, 100)
        for (begin, end), one in zip(pairwise(time_ns.tolist()), off, strict=True):
            online.add(begin, end, one)
        lost = np.zeros(21, bool)
        for first, after in offline.gaps:
            lost[first:after] = True
        assert [online.at(tick) is None for tick in range(21)] == lost.tolist()
        assert [online.at(tick) or 0.0 for tick in range(21)] == offline.within.tolist()
        cells = lost[:-1] | lost[1:]  # a way is lost with either of its ticks
        for begin, end in pairwise(time_ns.tolist()):
            assert end - begin <= 180 or cells[begin // 100 : -(-end // 100)].all()
        (bounded,) = np.nonzero(~lost)
        assert (offline.within[bounded] > 0.0).all()
