"""What is said between us and a controller elsewhere, one message a turn; docs/controller-protocol.md.

To a program it goes as JSON, an object a line; to a process of ours, which runs a Python file or an ONNX
policy, as MessagePack behind a length, with what is seen as a row of numbers.  Each side decodes what the
other may say and nothing else; no pickle.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, TypeVar

import msgspec
import numpy as np
from msgspec import Struct

from safety_harness.base.settings import Settings
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
from safety_harness.trace.records import DecisionOutcome, Mode, Trigger

PROTOCOL = "safety-harness controller 1"
MOST_BYTES = 65_536  # of what a controller says
MOST_WORDS = 240  # of why it failed: what a trace keeps

Numbers = list[float]
AnEnum = TypeVar("AnEnum", bound=IntEnum)


class Hello(Struct, tag="hello", tag_field="say"):
    """The first message to a program."""

    protocol: str = PROTOCOL
    sights: tuple[str, ...] = tuple(one.word for one in SIGHTS)
    reports: tuple[str, ...] = tuple(one.word for one in REPORTS)


class MakeController(Struct, tag="make", tag_field="say"):
    """The first message to a process of ours: a controller of that file, ``wanted`` says in JSON which."""

    wanted: str
    source: bytes


class Reset(Struct, tag="reset", tag_field="say"):
    """Begin an episode; ``seed`` is digits, since many readers of JSON keep 53 bits of a number."""

    settings: Settings
    arm: Any  # DrivenArm
    start: Any  # Start
    seed: str
    lane: int = 0  # of a process that has a controller for each


class Act(Struct, tag="act", tag_field="say"):
    """What is seen at that tick, to a program: the fields of ``Seen``."""

    tick: int
    seen: dict[str, Any]


class ActOnRow(Struct, tag="row", tag_field="say"):
    """What is seen at that tick, to a process of ours: a row of SEEN, with room for so many hands."""

    tick: int
    hand_slots: int
    row: bytes
    lane: int = 0
    image: tuple[float, bool, int, bytes] | None = None  # time [s], new, width [px], pixels of a new one


class ActOnRows(Struct, tag="rows", tag_field="say"):
    """What the controllers of those lanes see at that tick, a row each, with room for so many hands."""

    tick: int
    lanes: list[int]
    hand_slots: int
    rows: bytes


class Ready(Struct, tag="ready", tag_field="say", forbid_unknown_fields=True):
    """The episode may begin."""


class Welcome(Struct, tag="hello", tag_field="say", forbid_unknown_fields=True):
    """What a controller says of itself."""

    protocol: str
    name: str
    sees: tuple[str, ...]
    reports: tuple[str, ...] = ()


class MadeController(Welcome, tag="made", tag_field="say", forbid_unknown_fields=True):
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


class SaidMove(Struct, tag="move", tag_field="say", forbid_unknown_fields=True):
    """How to move from that tick to the next."""

    tick: int
    tcp_velocity_mps: Numbers | None = None
    tcp_angular_velocity_radps: Numbers | None = None
    joint_velocity_radps: Numbers | None = None
    report: SaidReport | None = None


class SaidStop(Struct, tag="stop", tag_field="say", forbid_unknown_fields=True):
    """A protective stop at that tick."""

    tick: int
    report: SaidReport | None = None


class SaidRows(Struct, tag="rows", tag_field="say", forbid_unknown_fields=True):
    """The answers of all lanes that were asked at that tick: the columns of ``LaneAnswers``, a row each.

    ``why`` has the lanes that cannot go on.
    """

    tick: int
    columns: list[bytes]
    why: dict[int, str]


class Failed(Struct, tag="failed", tag_field="say", forbid_unknown_fields=True):
    """The episode cannot go on, and why."""

    why: str


class NoController(Struct, tag="none", tag_field="say"):
    """The file gives no controller: what was expected, what came, where to read on."""

    expected: str
    got: str
    hint: str


SaidByProgram = Ready | Welcome | SaidMove | SaidStop | Failed | NoController
Said = SaidByProgram | MadeController | SaidRows
Told = MakeController | Reset | ActOnRow | ActOnRows
json_said: msgspec.json.Decoder[SaidByProgram] = msgspec.json.Decoder(SaidByProgram)
binary_said: msgspec.msgpack.Decoder[Said] = msgspec.msgpack.Decoder(Said)
to_the_process: msgspec.msgpack.Decoder[Told] = msgspec.msgpack.Decoder(Told)


def _plain(value: object) -> object:
    """Arrays of numbers as lists, pixels as bytes (base64 in JSON)."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"no numbers, text or array of those: {type(value).__name__}")


as_json = msgspec.json.Encoder(enc_hook=_plain).encode
as_binary = msgspec.msgpack.Encoder(enc_hook=_plain).encode


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


def arm_from(said: Mapping[str, Any]) -> DrivenArm:
    """The arm of a ``Reset``."""
    names = tuple(said["joint_names"])
    rest = {name: _array(value) for name, value in said.items() if name != "joint_names"}
    return DrivenArm(joint_names=names, **rest)


def start_from(said: Mapping[str, Any]) -> Start:
    """The start of a ``Reset``."""
    return Start(**{name: _array(value) for name, value in said.items()})


def _array(value: Any) -> Any:
    """Read-only, as the contract has it."""
    if not isinstance(value, list):
        return value
    array = np.array(value, dtype=np.float64)
    array.flags.writeable = False
    return array


def action_said(action: Action, tick: int) -> SaidMove | SaidStop:
    """An action for the way back; TypeError, ValueError or AttributeError for what is none."""
    report = None if action.report is None else _report_said(action.report)
    if isinstance(action, Stop):
        return SaidStop(tick, report)
    return SaidMove(
        tick,
        _numbers(action.tcp_velocity_mps),
        _numbers(action.tcp_angular_velocity_radps),
        _numbers(action.joint_velocity_radps),
        report,
    )


def as_sent(action: Action) -> Action:
    """What comes out at the other end; as ``action_said`` for what cannot be sent."""
    report = action.report
    plain = report is None or (type(report.mode) is Mode and report.decision is None)
    values: tuple[object, ...] = ()
    if isinstance(action, Move):
        values = action.tcp_velocity_mps, action.tcp_angular_velocity_radps, action.joint_velocity_radps
    if plain and all(value is None or _is_floats(value) for value in values):
        return action
    return action_of(binary_said.decode(as_binary(action_said(action, 0))))  # type: ignore[arg-type]


def _is_floats(value: Any) -> bool:
    return type(value) is np.ndarray and value.dtype == np.float64


def _numbers(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _report_said(report: Report) -> SaidReport:
    decision = report.decision
    return SaidReport(
        None if report.mode is None else word_of(Mode(report.mode)),
        None
        if decision is None
        else SaidDecision(
            _numbers(decision.hand_position_in_base_m),
            _numbers(decision.proposed_position_in_base_m),
            _numbers(decision.chosen_position_in_base_m),
            word_of(DecisionOutcome(decision.outcome)),
            word_of(Trigger(decision.trigger)),
            _numbers(decision.spread_m),
            decision.spread_threshold_m,
        ),
    )


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
    decision = said.decision
    return Report(
        mode=None if said.mode is None else _meant(Mode, said.mode, "mode"),
        decision=None
        if decision is None
        else Decision(
            hand_position_in_base_m=np.array(decision.hand_position_in_base_m),
            proposed_position_in_base_m=_or_nan(decision.proposed_position_in_base_m),
            chosen_position_in_base_m=_or_nan(decision.chosen_position_in_base_m),
            outcome=_meant(DecisionOutcome, decision.outcome, "outcome"),
            trigger=_meant(Trigger, decision.trigger, "trigger"),
            spread_m=_or_nan(decision.spread_m),
            spread_threshold_m=np.nan if decision.spread_threshold_m is None else decision.spread_threshold_m,
        ),
    )


def _or_nan(value: Numbers | None) -> Any:
    return np.full(3, np.nan) if value is None else np.array(value, dtype=np.float64)


def word_of(value: IntEnum) -> str:
    """How the protocol calls a value: PROTECTIVE_STOP is "protective stop"."""
    return value.name.lower().replace("_", " ")


def _meant(kind: type[AnEnum], word: str, name: str) -> AnEnum:
    for value in kind:
        if word_of(value) == word:
            return value
    raise ValueError(f"{name} must be one of: {', '.join(map(word_of, kind))}; got {word[:80]!r}")
