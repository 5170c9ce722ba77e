"""Reading the hands of a scenario: what their keys alone cannot say, and the recordings that they repeat."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.exceptions import RecordingError
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.model import (
    JOINED_HAND,
    MAX_HANDS,
    MOVING_HAND,
    RECORDED_HAND,
    HandTrajectory,
    JoinedHand,
    MovingHand,
    RecordedHand,
)
from safety_harness.scenario.moves import MOVE, REACHING_MPS, HandMove, Reach, Sweep, Wait, Wander, shifted
from safety_harness.scenario.recording import (
    MAX_BYTES,
    NOT_LOADED,
    Recording,
    load_recording,
    parse_recording,
)
from safety_harness.scenario.units import shown
from safety_harness.settings import Settings, Vector3

SMALLEST_BOX_M = 0.01  # from corner to corner
SHORTEST_SWEEP_M = 0.001
# The moves follow the keys that have to be there, in a message.
_MOVING_KEYS = (*MOVING_HAND.names[:3], "moves", *MOVING_HAND.names[3:-1])


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
            hand: HandTrajectory = _recorded_hand(item.fields(RECORDED_HAND.names), settings, carried)
        elif "together with" in given:
            hand = _joined_hand(item.fields(JOINED_HAND.names), hands)
        else:
            hand = _moving_hand(item.fields(_MOVING_KEYS))
        if any(hand.name == other.name for other in hands):
            raise item.error("another name for each hand", got=f'"{hand.name}" twice', hint="the key hand")
        hands.append(hand)
    return tuple(hands)


def _moving_hand(given: Fields) -> MovingHand:
    hand: MovingHand = MOVING_HAND.made_of(given)
    if hand.elbow_towards_in_base_m == shifted(hand.starts_at_in_base_m, hand.shift_in_base_m):
        raise given.required("elbow towards").error("a point other than where the hand starts")
    if hand.tremor is not None and hand.tremor.max_speed_mps >= hand.max_speed_mps:
        raise given.required("tremor").error(
            f"a tremor slower than the hand's bound of {hand.max_speed_mps:g} m/s",
            got=f"one of up to {hand.tremor.max_speed_mps:.3g} m/s",
            hint='2 pi times amplitude times rate; the bound is the hand\'s key "speed at most"',
        )
    for move, field in zip(hand.moves, given.required("moves").items("a list of moves"), strict=True):
        _check_move(move, dict(field.entries("a move")), hand)
    return hand


def _check_move(move: HandMove, given: Mapping[str, Field], hand: MovingHand) -> None:
    """ScenarioError for a move that the hand's bound on speed forbids, and for values that do not agree."""
    if isinstance(move, Wander) and _apart_m(*move.corners_in_base_m) < SMALLEST_BOX_M:
        expected = f"a box of at least {SMALLEST_BOX_M * 1e3:g} mm from corner to corner"
        raise given["within"].error(expected)
    if isinstance(move, Sweep) and _apart_m(move.from_in_base_m, move.to_in_base_m) < SHORTEST_SWEEP_M:
        expected = f'a point at least {SHORTEST_SWEEP_M * 1e3:g} mm away from that of "from"'
        raise given["to"].error(expected)
    if not isinstance(move, Wait) and move.speed_mps > hand.max_move_speed_mps:
        beside = " beside its tremor" if hand.tremor else ""
        raise given[MOVE.table_of(move).name_of("speed_mps")].error(
            f"a speed of at most {hand.max_move_speed_mps:.4g} m/s, the hand's bound{beside}",
            hint='a hand is faster on purpose with the key "speed at most" of its own, above "moves"',
        )
    if isinstance(move, Reach) and move.hesitation and move.hesitation.distance_m <= move.until_distance_m:
        expected = f'a distance farther away than "until", {given["until"].got()}'
        raise given["hesitating at"].error(expected)


def _apart_m(one: Vector3, other: Vector3) -> float:
    return float(np.linalg.norm(np.subtract(one, other)))


def _joined_hand(given: Fields, before: list[HandTrajectory]) -> JoinedHand:
    """A hand that goes with one that is written before it."""
    hand: JoinedHand = JOINED_HAND.made_of(given)
    names = [other.name for other in before if not isinstance(other, JoinedHand)]
    if hand.joined_to not in names:
        known = ", ".join(f'"{name}"' for name in names) or "(there is none)"
        expected = f"the name of a hand that is written before: {known}"
        raise given.required("together with").error(expected)
    return hand


def _recorded_hand(given: Fields, settings: Settings, carried: Mapping[str, bytes]) -> RecordedHand:
    values = RECORDED_HAND.values(given)
    recording = _recording(given, values["recording"], values.pop("motion", ""), carried)
    values.setdefault("name", values["track"].replace("_", " "))
    values["elbow_track"] = _elbow_track(given, values, recording)
    hand = RecordedHand(motion=NOT_LOADED, **values)
    places = {key: given.required(key).place for key in given}
    motion = load_recording(recording, hand, forearm_length_m=settings.hand.forearm_length_m, places=places)
    hand = replace(hand, motion=motion)
    _refuse_too_fast(given, hand)
    return hand


def _refuse_too_fast(given: Fields, hand: RecordedHand) -> None:
    """A recording keeps its own speed, unless a bound is written or it is sped up."""
    if hand.max_speed_mps is None and hand.speed_factor <= 1.0:
        return
    bound_mps = REACHING_MPS if hand.max_speed_mps is None else hand.max_speed_mps
    fastest_mps = hand.motion.max_speed_mps
    if fastest_mps > bound_mps:
        field = given.required("speed factor" if hand.speed_factor > 1.0 else "speed at most")
        raise field.error(
            f"a hand that is never faster than {bound_mps:g} m/s",
            got=f"one of {fastest_mps:.3f} m/s",
            hint=f"speed at most: {math.ceil(fastest_mps * 10.0) / 10.0:g} m/s, if it is meant",
        )


def _recording(given: Fields, path: Path, digest: str, carried: Mapping[str, bytes]) -> Recording:
    """The carried recording with the SHA-256 that is asked for, else the file beside the scenario."""
    field = given.required("recording")
    file = (field.file.parent if field.file else Path()) / path
    if digest in carried:
        data = carried[digest]
    else:
        data = read_bytes(file, most=MAX_BYTES, place=field.place, error=RecordingError)
    found = hashlib.sha256(data).hexdigest()
    if digest and found != digest:
        place, got = given.required("sha256").place, f"one with {found}"
        raise RecordingError(place=place, expected="a recording with this SHA-256", got=got)
    return parse_recording(data, file)


def _elbow_track(given: Fields, values: Mapping[str, Any], recording: Recording) -> str | None:
    """What the forearm points to, if no fixed point: a recorded elbow, by default the same side's."""
    if "elbow track" in given and "elbow towards" in given:
        expected = "either an elbow track or a point that the elbow is towards"
        raise given.required("elbow towards").error(expected, got="both")
    track: str | None = values.get("elbow_track")
    if track or "elbow towards" in given:
        return track
    same_side = recording.elbow_of(values["track"])
    if same_side is None:
        raise given.whole.error(
            'the key "elbow track" or "elbow towards"',
            got="neither, and the recording has no elbow of the same side",
            hint=f"its tracks: {', '.join(map(shown, recording.tracks))}",
        )
    return same_side
