"""Reading the hands of a scenario: one function for each kind of hand and each move."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

from safety_harness.exceptions import RecordingError
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M, Field, Fields
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.model import (
    MAX_HANDS,
    FollowTcp,
    HandMove,
    HandTrajectory,
    MoveTo,
    MovingHand,
    ReachForTcp,
    RecordedHand,
    Wait,
    Withdraw,
)
from safety_harness.scenario.recording import load_recording
from safety_harness.scenario.recording_table import MAX_BYTES, Recording, parse_recording
from safety_harness.scenario.units import ANGLE, LENGTH, NUMBER, SPEED, TIME, near_miss, shown
from safety_harness.settings import Settings, Vector3

LONGEST_S = 3600.0  # of a run, and of anything in it
FASTEST_MPS = 20.0
LARGEST_FACTOR = 10.0
LONGEST_GAP_S = 10.0
_SHA256 = re.compile(r"[0-9a-f]{64}")

DEFAULT_LONGEST_GAP_S = 0.2
DEFAULT_FASTEST_JUMP_MPS = 5.0

_MOVING_KEYS = ("hand", "starts at", "elbow towards", "moves")
_RECORDED_KEYS = (
    "recording",
    "sha256",
    "hand",
    "track",
    "elbow track",
    "elbow towards",
    "starts at",
    "turned",
    "speed factor",
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
        if "recording" in dict(item.entries("a hand: a mapping with the key hand or recording")):
            hand: HandTrajectory = _recorded_hand(item.fields(_RECORDED_KEYS), settings, carried)
        else:
            hand = _moving_hand(item.fields(_MOVING_KEYS))
        if any(hand.name == other.name for other in hands):
            raise item.error("another name for each hand", got=f'"{hand.name}" twice', hint="the key hand")
        hands.append(hand)
    return tuple(hands)


def read_position(field: Field) -> Vector3:
    """A point in the base frame, or a shift, with a bound that catches slips of the unit."""
    return field.vector(LENGTH, largest=LARGEST_COORDINATE_M)


def _moving_hand(hand: Fields) -> MovingHand:
    starts_at_in_base_m = read_position(hand.required("starts at"))
    elbow = hand.required("elbow towards")
    elbow_towards_in_base_m = read_position(elbow)
    if elbow_towards_in_base_m == starts_at_in_base_m:
        raise elbow.error("a point other than where the hand starts")
    moves = hand.required("moves").items("a list of moves")
    return MovingHand(
        name=hand.required("hand").sentence("a name for the hand"),
        starts_at_in_base_m=starts_at_in_base_m,
        elbow_towards_in_base_m=elbow_towards_in_base_m,
        moves=tuple(_move(move) for move in moves),
    )


def _move(field: Field) -> HandMove:
    """The move that one of its keys names."""
    names = ", ".join(_MOVES)
    given = [key for key, _ in field.entries(f"a move: a mapping with one of the keys {names}")]
    kinds = [key for key in given if key in _MOVES]
    if len(kinds) != 1:
        hint = near_miss(given[0], _MOVES) if given and not kinds else ""
        got = f"the keys {', '.join(map(shown, given))}" if given else "an empty mapping"
        raise field.error(f"one move: one of the keys {names}", got=got, hint=hint)
    further_keys, read = _MOVES[kinds[0]]
    return read(field.fields((kinds[0], *further_keys)))


def _move_to(move: Fields) -> MoveTo:
    return MoveTo(
        position_in_base_m=read_position(move.required("move to")), speed_mps=_speed(move.required("speed"))
    )


def _wait(move: Fields) -> Wait:
    return Wait(duration_s=_duration(move.required("wait")))


def _reach_for_tcp(move: Fields) -> ReachForTcp:
    return ReachForTcp(
        speed_mps=_speed(move.required("reach for tcp")),
        until_distance_m=_distance(move.required("until")),
        at_most_s=_duration(move.required("at most")),
    )


def _follow_tcp(move: Fields) -> FollowTcp:
    return FollowTcp(
        speed_mps=_speed(move.required("follow tcp")),
        distance_m=_distance(move.required("keeping")),
        duration_s=_duration(move.required("for")),
    )


def _withdraw(move: Fields) -> Withdraw:
    return Withdraw(speed_mps=_speed(move.required("withdraw")))


# The key that names a move, the further keys it takes, and its reader.
_MOVES: dict[str, tuple[tuple[str, ...], Callable[[Fields], HandMove]]] = {
    "move to": (("speed",), _move_to),
    "wait": ((), _wait),
    "reach for tcp": (("until", "at most"), _reach_for_tcp),
    "follow tcp": (("keeping", "for"), _follow_tcp),
    "withdraw": ((), _withdraw),
}


def _speed(field: Field) -> float:
    return field.quantity(SPEED, above=0.0, most=FASTEST_MPS)


def _duration(field: Field) -> float:
    return field.quantity(TIME, above=0.0, most=LONGEST_S)


def _distance(field: Field) -> float:
    return field.quantity(LENGTH, least=0.0, most=LARGEST_COORDINATE_M)


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
        motion=load_recording(
            recording,
            track=track,
            elbow_track=elbow_track,
            elbow_towards_in_base_m=elbow_towards_in_base_m,
            forearm_length_m=settings.hand.forearm_length_m,
            starts_at_in_base_m=starts_at_in_base_m,
            turn_rad=turn_rad,
            speed_factor=speed_factor,
            from_s=from_s,
            to_s=to_s,
            longest_gap_s=longest_gap_s,
            fastest_jump_mps=fastest_jump_mps,
            places={key: hand.required(key).place for key in hand},
        ),
    )


def _recording(hand: Fields, path: Path, carried: Mapping[str, bytes]) -> Recording:
    """The carried recording with the SHA-256 that is asked for, else the file beside the scenario."""
    place = hand.required("recording").place
    file = (place.file.parent if place.file else Path()) / path
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


@lru_cache(maxsize=4)
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
