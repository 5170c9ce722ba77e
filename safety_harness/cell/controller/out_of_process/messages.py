"""Messages between the harness and a controller elsewhere, one a turn; docs/controller-protocol.md.

To a program they are JSON, an object a line.  To a process of ours, which runs a Python file or an ONNX
policy, they are MessagePack in frames, with what is seen and what is answered as rows of numbers.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, ClassVar, TypeVar

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from safety_harness.base.settings import Settings
from safety_harness.cell.controller.answers import NOT_REPORTED
from safety_harness.seams.contract import (
    REPORTS,
    SIGHTS,
    Action,
    Decision,
    DrivenArm,
    Move,
    Report,
    Seen,
    Start,
    Stop,
)
from safety_harness.seams.isolation.messages import Failed, Make, ProcessMessage, Refused, decoder_of
from safety_harness.seams.rows import PackedSeen, packed_seen
from safety_harness.trace.records import DecisionOutcome, Mode, Trigger

PROTOCOL = "safety-harness controller 1"
MOST_BYTES = 65_536  # of what a controller says
WANTS_ACTION = "it has to say how to move"

Numbers = list[float]
AnEnum = TypeVar("AnEnum", bound=IntEnum)


class Hello(ProcessMessage, tag="hello"):
    """The first message to a program."""

    protocol: str = PROTOCOL
    sights: tuple[str, ...] = tuple(one.word for one in SIGHTS)
    reports: tuple[str, ...] = tuple(one.word for one in REPORTS)


class Reset(ProcessMessage, tag="reset"):
    """Begin an episode; ``seed`` is digits, since many readers of JSON keep 53 bits of a number."""

    call: ClassVar[str] = "reset"
    wants: ClassVar[str] = 'after a reset it has to say "ready"'
    settings: Settings
    arm: DrivenArm
    start: Start
    seed: str
    lane: int = 0  # of a process that has a controller for each


class Act(ProcessMessage, tag="act"):
    """What is seen at that tick, to a program: the fields of ``Seen``."""

    call: ClassVar[str] = "act"
    wants: ClassVar[str] = WANTS_ACTION
    tick: int
    seen: dict[str, Any]


class ActOnRows(ProcessMessage, tag="rows"):
    """What the controllers of those lanes see at that tick, to a process of ours: a row each.

    ``together``: in one call, if they take many; else there is one lane.
    """

    call: ClassVar[str] = "act"
    wants: ClassVar[str] = WANTS_ACTION
    tick: int
    lanes: list[int]
    seen: PackedSeen
    together: bool = False
    image: tuple[float, bool, int, bytes] | None = None  # time [s], new, width [px], pixels of a new one


class Ready(ProcessMessage, tag="ready", forbid_unknown_fields=True):
    """The episode may begin."""


class Welcome(ProcessMessage, tag="hello", forbid_unknown_fields=True):
    """What a controller says of itself."""

    protocol: str
    name: str
    sees: tuple[str, ...]
    reports: tuple[str, ...] = ()


class MadeController(Welcome, tag="made", forbid_unknown_fields=True):
    """That of a process of ours.

    ``many``: it can make a controller for each of many lanes; ``together``: one call answers for them all.
    """

    many: bool = False
    together: bool = False


class SaidDecision(Struct, forbid_unknown_fields=True):
    """A decision to give way: positions (3,) [m], None for none, and words of two vocabularies."""

    hand_position_in_base_m: Numbers
    proposed_position_in_base_m: Numbers | None = None
    chosen_position_in_base_m: Numbers | None = None
    outcome: str = "proposed"
    trigger: str = "hand entered"
    spread_m: Numbers | None = None
    spread_threshold_m: float | None = None


class SaidReport(Struct, forbid_unknown_fields=True):
    """What a controller says of itself at a tick."""

    mode: str | None = None
    decision: SaidDecision | None = None


class SaidMove(ProcessMessage, tag="move", forbid_unknown_fields=True):
    """How to move from that tick to the next."""

    tick: int
    tcp_velocity_mps: Numbers | None = None
    tcp_angular_velocity_radps: Numbers | None = None
    joint_velocity_radps: Numbers | None = None
    report: SaidReport | None = None


class SaidStop(ProcessMessage, tag="stop", forbid_unknown_fields=True):
    """A protective stop at that tick."""

    tick: int
    report: SaidReport | None = None


class SaidRow(ProcessMessage, tag="row", forbid_unknown_fields=True):
    """The answer of a single lane: ``wanted`` (6,) of the TCP, or (n,) of the joints, as ``LaneAnswers``."""

    tick: int
    wanted: bytes
    by_joints: bool
    stop: bool
    mode: int
    decision: Decision | None


class SaidRows(ProcessMessage, tag="rows", forbid_unknown_fields=True):
    """The answers of all lanes that were asked at that tick: the columns of ``LaneAnswers``, a row each.

    ``why`` has the lanes that cannot go on.
    """

    tick: int
    columns: list[bytes]
    why: dict[int, str]


SaidByProgram = Ready | Welcome | SaidMove | SaidStop | Failed | Refused
said_by_program: msgspec.json.Decoder[SaidByProgram] = msgspec.json.Decoder(SaidByProgram)
said_by_process = decoder_of(Ready | MadeController | SaidRow | SaidRows | Failed | Refused)
to_the_process = decoder_of(Make | Reset | ActOnRows)


def fields_of(seen: Seen, sees: tuple[str, ...]) -> dict[str, Any]:
    """All that is seen, as a program is told it: the pixels of an image once, when it is new."""
    found: dict[str, Any] = {"time_s": seen.time_s, "period_s": seen.period_s}
    for sight in SIGHTS:
        if sight.word in sees:
            found |= {name: getattr(seen, name) for name in sight.fields}
    image = found.get("image")
    if image is not None:
        pixels = image.pixels if image.new else None
        found["image"] = {"time_s": image.time_s, "new": image.new, "pixels": pixels}
    return found


def seen_at(tick: int, seen: Seen, lane: int) -> ActOnRows:
    """What is seen at that tick, to a process of ours; ControllerError if the harness did not make it."""
    image = seen.__dict__.get("image")
    told = None
    if image is not None:
        pixels = image.pixels.tobytes() if image.new or tick == 0 else b""
        told = (image.time_s, image.new, image.pixels.shape[1], pixels)
    return ActOnRows(tick, [lane], packed_seen(seen), image=told)


def action_in(said: SaidRow) -> Action:
    """The action of a single lane; ValueError for what is none."""
    report, wanted = None, np.frombuffer(said.wanted)
    if said.mode != NOT_REPORTED or said.decision is not None:
        mode = None if said.mode == NOT_REPORTED else Mode(said.mode)
        report = Report(mode=mode, decision=said.decision)
    if said.stop:
        return Stop(report=report)
    if said.by_joints:
        return Move(joint_velocity_radps=wanted, report=report)
    return Move(tcp_velocity_mps=wanted[:3], tcp_angular_velocity_radps=wanted[3:], report=report)


def action_of(said: SaidMove | SaidStop) -> Action:
    """What a controller said, as its action; ValueError for a word that is in no vocabulary."""
    report = None if said.report is None else _report_of(said.report)
    if isinstance(said, SaidStop):
        return Stop(report=report)
    return Move(
        tcp_velocity_mps=_floats(said.tcp_velocity_mps),
        tcp_angular_velocity_radps=_floats(said.tcp_angular_velocity_radps),
        joint_velocity_radps=_floats(said.joint_velocity_radps),
        report=report,
    )


def _floats(value: Numbers | None) -> Any:
    return None if value is None else np.array(value, dtype=np.float64)


def _report_of(said: SaidReport) -> Report:
    mode = None if said.mode is None else _meant(Mode, said.mode, "mode")
    return Report(mode=mode, decision=None if said.decision is None else _decision_of(said.decision))


def _decision_of(said: SaidDecision) -> Decision:
    told = {
        name: _floats(value) if isinstance(value, list) else value for name, value in asdict(said).items()
    }
    told["outcome"] = _meant(DecisionOutcome, said.outcome, "outcome")
    told["trigger"] = _meant(Trigger, said.trigger, "trigger")
    nowhere = dict.fromkeys(("proposed_position_in_base_m", "chosen_position_in_base_m"), np.full(3, np.nan))
    return Decision(**nowhere | {name: value for name, value in told.items() if value is not None})


def word_of(value: IntEnum) -> str:
    """How the protocol calls a value: PROTECTIVE_STOP is "protective stop"."""
    return value.name.lower().replace("_", " ")


def _meant(kind: type[AnEnum], word: str, name: str) -> AnEnum:
    for value in kind:
        if word_of(value) == word:
            return value
    raise ValueError(f"{name} must be one of: {', '.join(map(word_of, kind))}; got {word[:80]!r}")
