"""What the verdicts on a log take for granted of its cell, what confirms each, and which column would."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.scenario.nodes import Scalar

A_TCP = "a track of the TCP: log: {tcp: FILE#TRACK}"
LIKELY = ("tcp", "tool", "flange", "effector", "eef")  # in the name of a column or topic that has the TCP
A_FRAME = "a bag whose headers name it, with frame: {tf: FILE#/tf}; or a marker on the tool, by log align"


@dataclass(frozen=True)
class Assumption:
    """One of them: ``confirmed_by`` is empty where nothing in the log does, ``would`` names what would."""

    what: str
    confirmed_by: str
    would: str


def assumptions_of(log: CellLog) -> tuple[Assumption, ...]:
    """All that the verdicts on ``log`` assume of the arm, and of the frame of the hands."""
    tcp, by = log.tcp, ""
    likely = [one for one in log.unused if any(name in one.partition("#")[2].lower() for name in LIKELY)]
    would = A_TCP + f", perhaps {', '.join(likely[:3])}" * bool(likely)
    if tcp is not None:
        by = f"{tcp.samples.source.name}: where the joints have it to {tcp.apart_m * 1e3:.3g} mm"
        by += f" in {len(tcp.samples.time_ns)} samples, of {tcp.within_m * 1e3:.3g} mm that may be"
    of_arm = (
        f"the arm, {log.robot.label}",
        "the zero positions and signs of its joints",
        "where its tool ends",
    )
    found = [Assumption(what, by, would) for what in of_arm]
    angles = log.joints.values[:, : log.joints.values.shape[1] // 2]
    most = np.degrees(np.ptp(angles, axis=0).max())
    what = f"the unit of its angles, in which no joint turns by more than {most:.3g} deg"
    found.append(Assumption(what, by * (tcp is not None and tcp.unit), would))
    if tcp is not None and tcp.unseen:
        what = f"the zero positions of {', '.join(tcp.unseen)}, to within 5 deg: they hardly move the TCP"
        found.append(Assumption(what, "", "a column of the tool's orientation, which is not read yet"))
    found.append(Assumption("the shape of its tool", "", "no column: robot: {tool: ...} has to enclose it"))
    found.append(Assumption("how its tool is turned", "", "no column: no orientation is read"))
    said = dict(dict(log.said.entries("a log")).get("hands", log.said).entries("hands"))
    stated = "frame" in said and (
        isinstance(said["frame"].node, Scalar) or "at" in dict(said["frame"].entries(""))
    )
    for body in log.hands:
        source = body.hand.source
        by = f"the frames that headers of {source.name} name" * (source.is_bag and not stated)
        for what in ("the direction of the axes", "the origin of the heights"):
            found.append(Assumption(f"{what} of {body.name}", by, A_FRAME))
        found.append(Assumption(f"the unit of length for {body.name}", "", A_FRAME.rpartition("or ")[2]))
    return tuple(found)


def unconfirmed_note(log: CellLog) -> str:
    """Return the line on what nothing in the log confirms, which stands beside the verdicts."""
    names = [one.what for one in assumptions_of(log) if not one.confirmed_by]
    return f"nothing in the log confirms {'; '.join(names)} (safety-harness log check says what would)"
