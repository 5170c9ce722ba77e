"""The synthetic cell of the logs as a stream of lines, in the order in which they come."""

from __future__ import annotations

import json

from cells import Streams


def lines(
    streams: Streams, *, latency_s: float = 0.0, ahead_ns: int = 137_000_000, hand: str = "hand"
) -> list[bytes]:
    """Joints and hands in lines of their own; hands come ``latency_s`` after their time on the joints' clock.

    Times have microseconds, as clocks of robots do.
    """
    come = []
    for time_ns, row in zip(streams.joint_ns.tolist(), streams.joints_rad, strict=True):
        come.append((time_ns, {"time_s": round(time_ns / 1e9, 6), "joint_position_rad": row.tolist()}))
    for time_ns, at, elbow in zip(streams.hand_ns.tolist(), streams.hand_m, streams.elbow_m, strict=True):
        places = {"hand_position_in_base_m": at.tolist(), "elbow_position_in_base_m": elbow.tolist()}
        told = {"time_s": round(time_ns / 1e9, 6), "hands": {hand: places}}
        come.append((time_ns - ahead_ns + round(latency_s * 1e9), told))
    return [json.dumps(told).encode() for _, told in sorted(come, key=lambda one: one[0])]
