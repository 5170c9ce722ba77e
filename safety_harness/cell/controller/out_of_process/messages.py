"""Define the messages between the harness and a controller in another process.

The page docs/reference/controller-protocol.md describes the protocol. A program gets JSON, with one object in
each line. The harness's own process for a Python file or an ONNX policy gets frames of MessagePack. In these
frames, views and answers are rows of numbers.
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
    FILTER_SIGHTS,
    REPORTS,
    Answer,
    Decision,
    DrivenArm,
    HandSet,
    Move,
    Predicted,
    Report,
    Seen,
    Start,
    Stop,
)
from safety_harness.seams.isolation.messages import Failed, Make, ProcessMessage, Refused, decoder_of
from safety_harness.seams.rows import PackedSeen, packed_seen
from safety_harness.trace.records import DecisionOutcome, Mode, Trigger

PROTOCOL = "safety-harness controller 1"
MOST_BYTES = 65_536  # of a controller's message
WANTS_ACTION = "it has to say how to move"

Numbers = list[float]
AnEnum = TypeVar("AnEnum", bound=IntEnum)


class Hello(ProcessMessage, tag="hello"):
    """The first message of the harness to a program."""

    protocol: str = PROTOCOL
    sights: tuple[str, ...] = tuple(entry.word for entry in FILTER_SIGHTS)
    reports: tuple[str, ...] = tuple(entry.word for entry in REPORTS)


class Reset(ProcessMessage, tag="reset"):
    """The start of an episode.

    ``seed`` is a text, because many JSON readers keep only 53 bits of a number.
    """

    call: ClassVar[str] = "reset"
    wants: ClassVar[str] = 'after a reset it has to say "ready"'
    settings: Settings
    arm: DrivenArm
    start: Start
    seed: str
    lane: int = 0  # the number of the controller in its process


class Act(ProcessMessage, tag="act"):
    """The view at a tick for a program, with the fields of ``Seen``."""

    call: ClassVar[str] = "act"
    wants: ClassVar[str] = WANTS_ACTION
    tick: int
    seen: dict[str, Any]


class ActOnRows(ProcessMessage, tag="rows"):
    """The views of the controllers in ``lanes`` at a tick, one row each, for the harness's own process.

    If ``together`` is True, the process answers for all lanes at once. Otherwise there is only one lane.
    """

    call: ClassVar[str] = "act"
    wants: ClassVar[str] = WANTS_ACTION
    tick: int
    lanes: list[int]
    seen: PackedSeen
    together: bool = False
    image: tuple[float, bool, int, bytes] | None = None  # time [s], whether new, width [px], pixels if new


class Ready(ProcessMessage, tag="ready", forbid_unknown_fields=True):
    """The controller's message that it is ready to begin the episode."""


class Welcome(ProcessMessage, tag="hello", forbid_unknown_fields=True):
    """A controller's description of itself."""

    protocol: str
    name: str
    sees: tuple[str, ...]
    reports: tuple[str, ...] = ()


class MadeController(Welcome, tag="made", forbid_unknown_fields=True):
    """The description of a controller that the harness's own process sends.

    ``many`` states whether the process can make a controller for each of several lanes. ``together`` states
    whether one call of the file answers for all lanes. ``acts_per_answer`` has the same meaning as in the
    controller's contract.
    """

    many: bool = False
    together: bool = False
    acts_per_answer: int = 1


class SaidDecision(Struct, forbid_unknown_fields=True):
    """A decision that a program reports.

    Positions are (3,) [m], or None if they are absent. ``outcome`` and ``trigger`` are words of the protocol.
    """

    hand_position_in_base_m: Numbers
    proposed_position_in_base_m: Numbers | None = None
    chosen_position_in_base_m: Numbers | None = None
    outcome: str = "proposed"
    trigger: str = "hand entered"
    spread_m: Numbers | None = None
    spread_threshold_m: float | None = None


class SaidReport(Struct, forbid_unknown_fields=True):
    """The report of a controller about a tick."""

    mode: str | None = None
    decision: SaidDecision | None = None


class SaidMove(ProcessMessage, tag="move", forbid_unknown_fields=True):
    """The motion from one tick to the next."""

    tick: int
    tcp_velocity_mps: Numbers | None = None
    tcp_angular_velocity_radps: Numbers | None = None
    joint_velocity_radps: Numbers | None = None
    report: SaidReport | None = None


class SaidStop(ProcessMessage, tag="stop", forbid_unknown_fields=True):
    """A protective stop at a tick."""

    tick: int
    report: SaidReport | None = None


class SaidRow(ProcessMessage, tag="row", forbid_unknown_fields=True):
    """The answer of a single lane, with the fields of ``LaneAnswers``.

    ``wanted`` is a twist or joint velocities.
    """

    tick: int
    wanted: bytes
    by_joints: bool
    stop: bool
    mode: int
    decision: Decision | None


class SaidRows(ProcessMessage, tag="rows", forbid_unknown_fields=True):
    """The answers of all lanes at a tick.

    ``columns`` are the columns of ``LaneAnswers``, with one row for each lane. ``why`` states the reason of
    failure for each lane that cannot continue.
    """

    tick: int
    columns: list[bytes]
    why: dict[int, str]


class SaidSet(Struct, forbid_unknown_fields=True):
    """A predicted hand and its set, with the fields of ``HandSet``."""

    position_in_base_m: Numbers
    number: int
    radius_m: float | None = None
    half_widths_m: Numbers | None = None
    ellipsoid_m2: list[Numbers] | None = None


class SaidPrediction(ProcessMessage, tag="prediction", forbid_unknown_fields=True):
    """The answer of a predictor at a tick."""

    tick: int
    hands: list[SaidSet]


SaidByProgram = Ready | Welcome | SaidMove | SaidStop | SaidPrediction | Failed | Refused
said_by_program: msgspec.json.Decoder[SaidByProgram] = msgspec.json.Decoder(SaidByProgram)
said_by_process = decoder_of(Ready | MadeController | SaidRow | SaidRows | SaidPrediction | Failed | Refused)
to_the_process = decoder_of(Make | Reset | ActOnRows)


def fields_of(seen: Seen, sees: tuple[str, ...]) -> dict[str, Any]:
    """Return the view for a program.

    The view contains the pixels of an image only if the image is new.
    """
    fields: dict[str, Any] = {"time_s": seen.time_s, "period_s": seen.period_s}
    for sight in FILTER_SIGHTS:
        if sight.word in sees:
            fields |= {name: getattr(seen, name) for name in sight.fields}
    image = fields.get("image")
    if image is not None:
        pixels = image.pixels if image.new else None
        fields["image"] = {"time_s": image.time_s, "new": image.new, "pixels": pixels}
    return fields


def seen_at(tick: int, seen: Seen, lane: int) -> ActOnRows:
    """Return the view of a tick for the harness's own process.

    Raise ``ControllerError`` if the harness did not make the view.
    """
    image = seen.__dict__.get("image")
    sent = None
    if image is not None:
        pixels = image.pixels.tobytes() if image.new or tick == 0 else b""
        sent = (image.time_s, image.new, image.pixels.shape[1], pixels)
    return ActOnRows(tick, [lane], packed_seen(seen), image=sent)


def prediction_at(tick: int, predicted: Predicted) -> SaidPrediction:
    """Return the message with a predictor's answer.

    Raise ``ValueError`` if a value is not a number.
    """
    return SaidPrediction(
        tick,
        [
            SaidSet(
                _listed(hand.position_in_base_m),
                hand.number,
                None if hand.radius_m is None else float(hand.radius_m),
                None if hand.half_widths_m is None else _listed(hand.half_widths_m),
                None if hand.ellipsoid_m2 is None else [_listed(row) for row in hand.ellipsoid_m2],
            )
            for hand in predicted.hands
        ],
    )


def _listed(value: Any) -> Numbers:
    """Return the numbers of an array (n,) as a list."""
    return [float(number) for number in value]


def _predicted(message: SaidPrediction) -> Predicted:
    """Return the predictor's answer in a message."""
    hands = (asdict(hand) for hand in message.hands)
    return Predicted(
        hands=tuple(
            HandSet(**{k: _floats(v) if isinstance(v, list) else v for k, v in hand.items()})
            for hand in hands
        )
    )


def action_in(row: SaidRow | SaidPrediction) -> Answer:
    """Return the answer of a single lane.

    Raise ``ValueError`` if the row is invalid.
    """
    if isinstance(row, SaidPrediction):
        return _predicted(row)
    report, wanted = None, np.frombuffer(row.wanted)
    if row.mode != NOT_REPORTED or row.decision is not None:
        mode = None if row.mode == NOT_REPORTED else Mode(row.mode)
        report = Report(mode=mode, decision=row.decision)
    if row.stop:
        return Stop(report=report)
    if row.by_joints:
        return Move(joint_velocity_radps=wanted, report=report)
    return Move(tcp_velocity_mps=wanted[:3], tcp_angular_velocity_radps=wanted[3:], report=report)


def action_of(message: SaidMove | SaidStop | SaidPrediction) -> Answer:
    """Return the answer in a program's message.

    Raise ``ValueError`` if the message contains an unknown word.
    """
    if isinstance(message, SaidPrediction):
        return _predicted(message)
    report = None if message.report is None else _report_of(message.report)
    if isinstance(message, SaidStop):
        return Stop(report=report)
    return Move(
        tcp_velocity_mps=_floats(message.tcp_velocity_mps),
        tcp_angular_velocity_radps=_floats(message.tcp_angular_velocity_radps),
        joint_velocity_radps=_floats(message.joint_velocity_radps),
        report=report,
    )


def _floats(value: Numbers | None) -> Any:
    """Return ``value`` as an array, or None if ``value`` is None."""
    return None if value is None else np.array(value, dtype=np.float64)


def _report_of(report: SaidReport) -> Report:
    """Return the report in a message as a ``Report`` of the contract."""
    mode = None if report.mode is None else _meant(Mode, report.mode, "mode")
    return Report(mode=mode, decision=None if report.decision is None else _decision_of(report.decision))


def _decision_of(decision: SaidDecision) -> Decision:
    """Return the decision in a message as a ``Decision`` of the contract."""
    fields = {
        name: _floats(value) if isinstance(value, list) else value for name, value in asdict(decision).items()
    }
    fields["outcome"] = _meant(DecisionOutcome, decision.outcome, "outcome")
    fields["trigger"] = _meant(Trigger, decision.trigger, "trigger")
    nowhere = dict.fromkeys(("proposed_position_in_base_m", "chosen_position_in_base_m"), np.full(3, np.nan))
    return Decision(**nowhere | {name: value for name, value in fields.items() if value is not None})


def word_of(value: IntEnum) -> str:
    """Return the protocol's word for a value, such as "protective stop" for PROTECTIVE_STOP."""
    return value.name.lower().replace("_", " ")


def _meant(kind: type[AnEnum], text: str, name: str) -> AnEnum:
    """Return the value of ``kind`` for the word ``text``.

    Raise ``ValueError`` if the word is unknown.
    """
    for value in kind:
        if word_of(value) == text:
            return value
    raise ValueError(f"{name} must be one of: {', '.join(map(word_of, kind))}; got {text[:80]!r}")
