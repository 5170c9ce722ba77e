"""What the verdicts on a log take for granted of its cell, what confirms each, and which column would."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.logs.model import CellLog
from safety_harness.scenario.nodes import Mapping

A_TCP = "a track of the TCP: log: {tcp: FILE#TRACK}"
LIKELY = ("tcp", "tool", "flange", "effector", "eef")  # in the name of a column or topic that has the TCP
A_FRAME = (
    "headers of a bag that name their frame, with frame: {tf: FILE#/tf}; or a marker on the tool, of which "
    "safety-harness log align says whether the arm's motion explains its places"
)


@dataclass(frozen=True, kw_only=True)
class Assumption:
    """One of them: ``confirmed_by`` is empty where nothing in the log does, ``would`` names what would."""

    what: str
    confirmed_by: str = ""
    would: str


def assumptions_of(log: CellLog) -> tuple[Assumption, ...]:
    """All that the verdicts on ``log`` assume of the arm, and of the frame of the hands."""
    tcp, by, zeros = log.tcp, "", "the zero positions and signs of its joints"
    likely = [one for one in log.unused if any(name in one.partition("#")[2].lower() for name in LIKELY)]
    would = A_TCP + f", perhaps {', '.join(likely[:3])}" * bool(likely)
    if tcp is not None:
        by = f"{tcp.samples.source.name}, {len(tcp.samples.time_ns)} samples at most {tcp.apart_m * 1e3:.3g} mm"
        by += f" from where the joints have it, of {tcp.within_m * 1e3:.3g} mm that may be"
    found = [Assumption(what=f"the arm, {log.robot.label}", confirmed_by=by, would=would)]
    found.append(Assumption(what=zeros, confirmed_by=by, would=would))
    if tcp is not None and tcp.unseen:
        what = f"the zero positions of {', '.join(tcp.unseen)}, to within 5 deg: they hardly move the TCP"
        found.append(Assumption(what=what, would="one of the tool's orientation, which is not read"))
    found.append(Assumption(what="where its tool ends, the TCP", confirmed_by=by, would=would))
    found.append(Assumption(what="the shape of its tool", would="none: robot: {tool: ...} has to enclose it"))
    for body in log.hands:
        source, headers = body.hand.source, ""
        if source.is_bag and _by_headers(log):
            headers = f"the frames that the headers of {source.name} name"
        for what in ("the direction of the axes", "the origin of the heights"):
            found.append(Assumption(what=f"{what} of {body.name}", confirmed_by=headers, would=A_FRAME))
    return tuple(found)


def _by_headers(log: CellLog) -> bool:
    """Are positions placed by the frame that each message names, which has to be there then?"""
    hands = dict(dict(log.said.entries("a log"))["hands"].entries("hands"))
    frame = hands["frame"].node if "frame" in hands else None
    return frame is None or (
        isinstance(frame, Mapping) and "at" not in {key.text for key, _ in frame.entries}
    )


def unconfirmed_note(log: CellLog) -> str:
    """Return the line on what nothing in the log confirms, which stands beside the verdicts."""
    names = [one.what for one in assumptions_of(log) if not one.confirmed_by]
    return f"nothing in the log confirms {'; '.join(names)} (safety-harness log check says what would)"
