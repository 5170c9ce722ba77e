#!/usr/bin/env python3
"""A recorded cell as if it ran: the streams of a LOG.yaml as JSON lines, at their own pace.

python replay.py ../logs/LOG.yaml | safety-harness monitor ../logs/LOG.yaml
python replay.py ../logs/LOG.yaml --fast | safety-harness monitor ../logs/LOG.yaml
"""

from __future__ import annotations

import heapq
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from safety_harness.extensions.field.logs.model import Body, CellLog
from safety_harness.extensions.field.logs.read import read_log


def joints(log: CellLog) -> Iterator[tuple[int, str]]:
    """(time on the joints' clock [ns], line) of each sample."""
    count = log.joints.values.shape[1] // 2
    for time_ns, row in zip(log.joints.time_ns.tolist(), log.joints.values.tolist(), strict=True):
        yield time_ns, json.dumps({"time_s": time_ns / 1e9, "joint_position_rad": row[:count]})


def hand(log: CellLog, body: Body) -> Iterator[tuple[int, str]]:
    """The same of a hand, with its elbow where that was seen at the same time."""
    elbows = {}
    if body.elbow is not None:
        elbows = dict(zip(body.elbow.time_ns.tolist(), body.elbow.values.tolist(), strict=True))
    for time_ns, at in zip(body.hand.time_ns.tolist(), body.hand.values.tolist(), strict=True):
        place = {"hand_position_in_base_m": at}
        if time_ns in elbows:
            place["elbow_position_in_base_m"] = elbows[time_ns]
        told = {"time_s": time_ns / 1e9, "hands": {body.name: place}}
        yield time_ns - log.hands_ahead_ns, json.dumps(told)


def main() -> None:
    """Every line, in the order of time."""
    log, fast = read_log(Path(sys.argv[1])), "--fast" in sys.argv
    begin_ns, begin_s = log.origin_ns, time.monotonic()
    for time_ns, line in heapq.merge(joints(log), *(hand(log, body) for body in log.hands)):
        if not fast:
            time.sleep(max((time_ns - begin_ns) / 1e9 - (time.monotonic() - begin_s), 0.0))
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
