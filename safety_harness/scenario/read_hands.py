"""Reading the hands of a scenario: one function for each kind of hand and each move."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from safety_harness.exceptions import RecordingError
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, Field, Fields
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.model import (
    MAX_HANDS,
    HandTrajectory,
    JoinedHand,
    MovingHand,
    RecordedHand,
    RecordedMotion,
)
from safety_harness.scenario.moves import REACHING_MPS, REACHING_MPS2, Tremor, shifted
from safety_harness.scenario.read_moves import FASTEST_MPS, LONGEST_S, read_move, read_position
from safety_harness.scenario.recording import load_recording
from safety_harness.scenario.recording_table import MAX_BYTES, Recording, parse_recording
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    NUMBER,
    RATE,
    SPEED,
    TIME,
    shown,
)
from safety_harness.settings import Settings, Vector3

LARGEST_FACTOR = 10.0
LONGEST_GAP_S = 10.0
_SHA256 = re.compile(r"[0-9a-f]{64}")

DEFAULT_LONGEST_GAP_S = 0.2
DEFAULT_FASTEST_JUMP_MPS = 5.0

# Of a hand: what is slower or larger than these is a slip of the unit.
ACCELERATIONS_MPS2 = (0.1, 100.0)
TREMORS_M = (1e-5, 0.02)
TREMORS_HZ = (0.1, 20.0)

_MOVING_KEYS = (
    "hand",
    "starts at",
    "elbow towards",
    "moves",
    "shifted by",
    "delayed by",
    "speed at most",
    "acceleration at most",
    "tremor",
)
_TREMOR_KEYS = ("amplitude", "rate")
_JOINED_KEYS = ("hand", "together with", "apart", "elbow towards")
_RECORDED_KEYS = (
    "recording",
    "sha256",
    "hand",
    "track",
    "elbow track",
    "elbow towards",
    "starts at",
    "turned",
    "shifted by",
    "delayed by",
    "speed factor",
    "speed at most",
    "from",
    "to",
    "longest gap",
    "fastest jump",
)


def read_hands(
    field: Field | None, *, settings: Settings, carried: Mapping[str, bytes]
) -> tuple[HandTrajectory, ...]:
    """The hands, at most MAX_HANDS, each with a name of its own.

    ``carried`` are recordings by the SHA-256 of their bytes; they come before files.
    """
    if field is None:
        return ()
    hands: list[HandTrajectory] = []
    for item in field.items(f"a list of at most {MAX_HANDS} hands", most=MAX_HANDS):
        given = dict(item.entries("a hand: a mapping with the key hand or recording"))
        if "recording" in given:
            hand: HandTrajectory = _recorded_hand(item.fields(_RECORDED_KEYS), settings, carried)
        elif "together with" in given:
            hand = _joined_hand(item.fields(_JOINED_KEYS), hands)
        else:
            hand = _moving_hand(item.fields(_MOVING_KEYS))
        if any(hand.name == other.name for other in hands):
            raise item.error("another name for each hand", got=f'"{hand.name}" twice', hint="the key hand")
        hands.append(hand)
    return tuple(hands)


def _moving_hand(hand: Fields) -> MovingHand:
    starts_at_in_base_m = read_position(hand.required("starts at"))
    elbow = hand.required("elbow towards")
    elbow_towards_in_base_m = read_position(elbow)
    if elbow_towards_in_base_m == shifted(starts_at_in_base_m, _shift(hand)):
        raise elbow.error("a point other than where the hand starts")
    least, most = ACCELERATIONS_MPS2
    max_speed_mps = hand.quantity("speed at most", SPEED, REACHING_MPS, above=0.0, most=FASTEST_MPS)
    without_moves = MovingHand(
        name=hand.required("hand").sentence("a name for the hand"),
        starts_at_in_base_m=starts_at_in_base_m,
        elbow_towards_in_base_m=elbow_towards_in_base_m,
        moves=(),
        shift_in_base_m=_shift(hand),
        delay_s=_delay(hand),
        max_speed_mps=max_speed_mps,
        max_acceleration_mps2=hand.quantity(
            "acceleration at most", ACCELERATION, REACHING_MPS2, least=least, most=most
        ),
        tremor=_tremor(hand.optional("tremor"), max_speed_mps),
    )
    moves = hand.required("moves").items("a list of moves")
    return replace(without_moves, moves=tuple(read_move(move, without_moves) for move in moves))


def _shift(hand: Fields) -> Vector3:
    field = hand.optional("shifted by")
    return read_position(field) if field else (0.0, 0.0, 0.0)


def _delay(hand: Fields) -> float:
    return hand.quantity("delayed by", TIME, 0.0, least=0.0, most=LONGEST_S)


def _tremor(field: Field | None, max_speed_mps: float) -> Tremor | None:
    if field is None:
        return None
    given = field.fields(_TREMOR_KEYS)
    amplitude_m = given.required("amplitude").quantity(LENGTH, least=TREMORS_M[0], most=TREMORS_M[1])
    rate_hz = given.required("rate").quantity(RATE, least=TREMORS_HZ[0], most=TREMORS_HZ[1])
    tremor = Tremor(amplitude_m=amplitude_m, rate_hz=rate_hz)
    if tremor.max_speed_mps >= max_speed_mps:
        raise field.error(
            f"a tremor slower than the hand's bound of {max_speed_mps:g} m/s",
            got=f"one of up to {tremor.max_speed_mps:.3g} m/s",
            hint='2 pi times amplitude times rate; the bound is the hand\'s key "speed at most"',
        )
    return tremor


def _joined_hand(hand: Fields, before: list[HandTrajectory]) -> JoinedHand:
    """A hand that goes with one that is written before it."""
    leading = hand.required("together with")
    joined_to = leading.sentence("the name of a hand")
    names = [other.name for other in before if not isinstance(other, JoinedHand)]
    if joined_to not in names:
        known = ", ".join(f'"{name}"' for name in names) or "(there is none)"
        raise leading.error(f"the name of a hand that is written before: {known}")
    return JoinedHand(
        name=hand.required("hand").sentence("a name for the hand"),
        joined_to=joined_to,
        apart_in_base_m=read_position(hand.required("apart")),
        elbow_towards_in_base_m=read_position(hand.required("elbow towards")),
    )


def _recorded_hand(hand: Fields, settings: Settings, carried: Mapping[str, bytes]) -> RecordedHand:
    path = Path(hand.required("recording").sentence("the path of a recording"))
    recording = _recording(hand, path, carried)
    track = _track(hand.required("track"))
    elbow_track, elbow_towards_in_base_m = _elbow(hand, recording, track)
    name = hand.optional("hand")
    starts_at_in_base_m = read_position(hand.required("starts at"))
    turn_rad = hand.quantity("turned", ANGLE, 0.0, least=-LARGEST_ANGLE_RAD, most=LARGEST_ANGLE_RAD)
    speed_factor = hand.quantity("speed factor", NUMBER, 1.0, least=0.01, most=LARGEST_FACTOR)
    from_s = hand.quantity("from", TIME, None)
    to_s = hand.quantity("to", TIME, None)
    longest_gap_s = hand.quantity("longest gap", TIME, DEFAULT_LONGEST_GAP_S, above=0.0, most=LONGEST_GAP_S)
    fastest_jump_mps = hand.quantity(
        "fastest jump", SPEED, DEFAULT_FASTEST_JUMP_MPS, above=0.0, most=FASTEST_MPS
    )
    max_speed_mps = hand.quantity("speed at most", SPEED, None, above=0.0, most=FASTEST_MPS)
    shift_in_base_m, delay_s = _shift(hand), _delay(hand)
    motion = load_recording(
        recording,
        track=track,
        elbow_track=elbow_track,
        elbow_towards_in_base_m=elbow_towards_in_base_m,
        forearm_length_m=settings.hand.forearm_length_m,
        starts_at_in_base_m=shifted(starts_at_in_base_m, shift_in_base_m),
        turn_rad=turn_rad,
        delay_s=delay_s,
        speed_factor=speed_factor,
        from_s=from_s,
        to_s=to_s,
        longest_gap_s=longest_gap_s,
        fastest_jump_mps=fastest_jump_mps,
        places={key: hand.required(key).place for key in hand},
    )
    _refuse_too_fast(hand, motion, speed_factor, max_speed_mps)
    return RecordedHand(
        name=name.sentence("a name for the hand") if name else track.replace("_", " "),
        recording=path,
        track=track,
        elbow_track=elbow_track,
        elbow_towards_in_base_m=elbow_towards_in_base_m,
        starts_at_in_base_m=starts_at_in_base_m,
        turn_rad=turn_rad,
        speed_factor=speed_factor,
        from_s=from_s,
        to_s=to_s,
        longest_gap_s=longest_gap_s,
        fastest_jump_mps=fastest_jump_mps,
        motion=motion,
        shift_in_base_m=shift_in_base_m,
        delay_s=delay_s,
        max_speed_mps=max_speed_mps,
    )


def _refuse_too_fast(
    hand: Fields, motion: RecordedMotion, speed_factor: float, max_speed_mps: float | None
) -> None:
    """A recording keeps its own speed, unless a bound is written or it is sped up."""
    if max_speed_mps is None and speed_factor <= 1.0:
        return
    bound_mps = REACHING_MPS if max_speed_mps is None else max_speed_mps
    if motion.max_speed_mps > bound_mps:
        field = hand.required("speed factor" if speed_factor > 1.0 else "speed at most")
        raise field.error(
            f"a hand that is never faster than {bound_mps:g} m/s",
            got=f"one of {motion.max_speed_mps:.3f} m/s",
            hint=f"speed at most: {math.ceil(motion.max_speed_mps * 10.0) / 10.0:g} m/s, if it is meant",
        )


def _recording(hand: Fields, path: Path, carried: Mapping[str, bytes]) -> Recording:
    """The carried recording with the SHA-256 that is asked for, else the file beside the scenario."""
    field = hand.required("recording")
    place = field.place
    file = (field.file.parent if field.file else Path()) / path
    pinned = hand.optional("sha256")
    digest = pinned.scalar("a SHA-256") if pinned else ""
    if pinned and not _SHA256.fullmatch(digest):
        raise pinned.error("a SHA-256: 64 digits and letters from a to f")
    if digest in carried:
        data = carried[digest]
    else:
        data = read_bytes(file, most=MAX_BYTES, place=place, error=RecordingError)
    found = hashlib.sha256(data).hexdigest()
    if pinned and found != digest:
        got = f"one with {found}"
        raise RecordingError(place=pinned.place, expected="a recording with this SHA-256", got=got)
    return _parsed(data, file)


@lru_cache(maxsize=8)
def _parsed(data: bytes, file: Path) -> Recording:
    """Parsed once for all the scenarios that repeat the same bytes."""
    return parse_recording(data, file)


def _track(field: Field) -> str:
    """A track as the columns spell it: ``right hand`` is ``right_hand``."""
    return field.sentence("the name of a track").replace(" ", "_")


def _elbow(hand: Fields, recording: Recording, track: str) -> tuple[str | None, Vector3 | None]:
    """What the forearm points to: a recorded elbow (the same side's by default) or a fixed point."""
    elbow_track, towards = hand.optional("elbow track"), hand.optional("elbow towards")
    if elbow_track and towards:
        raise towards.error("either an elbow track or a point that the elbow is towards", got="both")
    if towards:
        return None, read_position(towards)
    if elbow_track:
        return _track(elbow_track), None
    same_side = recording.elbow_of(track)
    if same_side is None:
        raise hand.whole.error(
            'the key "elbow track" or "elbow towards"',
            got="neither, and the recording has no elbow of the same side",
            hint=f"its tracks: {', '.join(map(shown, recording.tracks))}",
        )
    return same_side, None
