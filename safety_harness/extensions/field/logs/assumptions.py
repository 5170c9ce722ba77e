"""List the assumptions about a cell, and the evidence for each of them in the cell's log.

The verdicts on the log are valid only if these assumptions are true.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.scenario.nodes import Scalar

A_TCP = "a track of the TCP: log: {tcp: FILE#TRACK}"
LIKELY = ("tcp", "tool", "flange", "effector", "eef")  # words in names of columns and topics with a TCP
A_FRAME = "a bag whose headers name it, with frame: {tf: FILE#/tf}; or a marker on the tool, by log align"


@dataclass(frozen=True)
class Assumption:
    """One assumption about a cell, which ``what`` states.

    ``confirmed_by`` describes the evidence in the log; it is empty if the log has no evidence. ``would``
    describes the data that would be evidence.
    """

    what: str
    confirmed_by: str
    would: str


def assumptions_of(log: CellLog) -> tuple[Assumption, ...]:
    """Return the assumptions about the arm and the hands that verdicts on ``log`` require."""
    tcp, evidence = log.tcp, ""
    likely = [item for item in log.unused if any(name in item.partition("#")[2].lower() for name in LIKELY)]
    would = A_TCP + f", perhaps {', '.join(likely[:3])}" * bool(likely)
    if tcp is not None:
        evidence = f"{tcp.samples.source.name}: where the joints have it to {tcp.apart_m * 1e3:.3g} mm"
        evidence += f" in {len(tcp.samples.time_ns)} samples, of {tcp.within_m * 1e3:.3g} mm that may be"
    of_arm = (
        f"the arm, {log.robot.label}",
        "the zero positions and signs of its joints",
        "where its tool ends",
    )
    assumed = [Assumption(text, evidence, would) for text in of_arm]
    angles = log.joints.values[:, : log.joints.values.shape[1] // 2]
    most = np.degrees(np.ptp(angles, axis=0).max())
    text = f"the unit of its angles, in which no joint turns by more than {most:.3g} deg"
    assumed.append(Assumption(text, evidence * (tcp is not None and tcp.unit), would))
    if tcp is not None and tcp.unseen:
        text = f"the zero positions of {', '.join(tcp.unseen)}, to within 5 deg: they hardly move the TCP"
        assumed.append(Assumption(text, "", "a column of the tool's orientation, which is not read yet"))
    assumed.append(Assumption("the shape of its tool", "", "no column: robot: {tool: ...} has to enclose it"))
    assumed.append(Assumption("how its tool is turned", "", "no column: no orientation is read"))
    hands_keys = dict(dict(log.said.entries("a log")).get("hands", log.said).entries("hands"))
    stated = "frame" in hands_keys and (
        isinstance(hands_keys["frame"].node, Scalar) or "at" in dict(hands_keys["frame"].entries(""))
    )
    for body in log.hands:
        source = body.hand.source
        evidence = f"the frames that headers of {source.name} name" * (source.is_bag and not stated)
        for text in ("the direction of the axes", "the origin of the heights"):
            assumed.append(Assumption(f"{text} of {body.name}", evidence, A_FRAME))
        assumed.append(Assumption(f"the unit of length for {body.name}", "", A_FRAME.rpartition("or ")[2]))
    return tuple(assumed)


def unconfirmed_note(log: CellLog) -> str:
    """Return the note about unconfirmed assumptions that reports print beside the verdicts."""
    names = [a.what for a in assumptions_of(log) if not a.confirmed_by]
    return f"the log does not confirm {'; '.join(names)} (safety-harness log check lists missing evidence)"
