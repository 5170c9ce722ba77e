"""A stream that repeats itself to the last bit is lost for the monitor, as it is for ``judge`` of its log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cells import MIDDLE_RAD, Floats, tcp_m

from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import StreamError
from safety_harness.extensions.field.logs.judging import recorded
from safety_harness.extensions.field.monitoring.cell import read_cell
from safety_harness.extensions.field.monitoring.journal import Journal
from safety_harness.extensions.field.monitoring.monitor import Monitor
from safety_harness.scenario.model import Verdict

FAR_M = tcp_m(MIDDLE_RAD[None])[0] + [0.45, 0.0, 0.0]
DISTANCE, HEIGHT = "always hand distance > 150 mm", "always TCP height > 100 mm"
SAID = """\
log: {{joints: joints.csv, hands: hands.csv#hand, period: 8 ms}}
clock: {{hands are ahead by: 0 ms, known to: 0 ms}}
joints: {{known to: 0.02 deg, accelerate at most: 2 rad/s2{joints}}}
hands: {{forearm: none, frame: base, longest gap: 200 ms, moves at most: 2 m/s, known to: 8 mm,
  left out: [hands.csv#marker], speeds: {{known to: 1 m/s}}{hands}}}
settings: {{hand: {{forearm radius: 40 mm, radius: 60 mm}}}}
claims: ["{distance}", "{height}"]
tcp: {{known to: 2 mm, frame: base}}
mode: {{words: {{RUN: servoing}}, known to: 0 ms, longest gap: 40 ms}}
"""
AT_REST = ", repeats: at rest"


def still(count: int, at: Floats, noise: float) -> Floats:
    return np.asarray(at + np.random.default_rng(4).normal(0.0, noise, (count, len(at))))


def watched(
    folder: Path, joints_rad: Floats, hands_m: Floats, **said: str
) -> tuple[list[Verdict], list[Verdict], list[str]]:
    """Verdicts by the monitor, by ``judge`` of its log, and what the monitor refused."""
    file, own_log = folder / "CELL.yaml", folder / "log"
    file.write_text(SAID.format(**{"joints": "", "hands": ""} | said, distance=DISTANCE, height=HEIGHT))
    own, refused = Monitor(cell=read_cell(file, [])), []
    own.journal = Journal(cell=own.cell, claims=[DISTANCE, HEIGHT], folder=own_log, most_bytes=10**8, keep=2)
    come = [(k * 0.008, {"joint_position_rad": row}) for k, row in enumerate(joints_rad.tolist())]
    places = [{"hand": {"hand_position_in_base_m": row}} for row in hands_m.tolist()]
    come += [(k * 0.024, {"hands": place}) for k, place in enumerate(places)]
    for at, told in sorted(come, key=lambda one: (one[0], "hands" not in one[1])):
        try:
            list(own.take(json.dumps({"time_s": round(100.0 + at, 6)} | told).encode()))
        except StreamError as error:
            refused.append(str(error))
    list(own.end())
    own.journal.close()
    offline = judge(recorded(own.journal.latest).trace)
    return [one.verdict for one in own.verdicts()], [one.verdict for one in offline], refused


HOLDS, OPEN = Verdict.HOLDS, Verdict.INCONCLUSIVE


@pytest.mark.parametrize("first", [0, 40])
def test_a_hand_that_hangs_is_lost_and_told_with_since_when(tmp_path: Path, first: int) -> None:
    joints_rad, hands_m = still(301, MIDDLE_RAD, 2e-5), still(100, FAR_M, 2e-3)
    hands_m[first : first + 12] = hands_m[first]
    online, offline, refused = watched(tmp_path, joints_rad, hands_m)
    assert online == offline == [OPEN, HOLDS]
    since_s = 100.0 + first * 0.024
    told = f"the same numbers to the last bit from {since_s:.3f} s on, though the stream has noise elsewhere"
    assert told in refused[0]
    assert len(refused) == (1 if first == 0 else 8)


@pytest.mark.parametrize("joint", [0, 5])
def test_a_joint_that_hangs_is_lost(tmp_path: Path, joint: int) -> None:
    joints_rad, hands_m = still(301, MIDDLE_RAD, 2e-5), still(100, FAR_M, 2e-3)
    joints_rad[150:190, joint] = joints_rad[150, joint]
    online, offline, refused = watched(tmp_path, joints_rad, hands_m)
    assert online == offline == [OPEN, OPEN]
    assert "joint_position_rad" in refused[0]
    assert "from 101.200 s on" in refused[0]


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_stream_without_noise_or_declared_at_rest_may_repeat_itself(tmp_path: Path, noise: float) -> None:
    joints_rad, hands_m = still(301, MIDDLE_RAD, noise * 2e-5), still(100, FAR_M, noise * 2e-3)
    joints_rad[150:190], hands_m[40:52] = joints_rad[150], hands_m[40]
    said = {"joints": AT_REST, "hands": AT_REST} if noise else {}
    online, offline, refused = watched(tmp_path, joints_rad, hands_m, **said)
    assert online == offline == [HOLDS, HOLDS]
    assert not refused
