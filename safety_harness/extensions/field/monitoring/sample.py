"""A line of a stream: the measurements of a cell at one time, as JSON.

    {"time_s": 12.344, "joint_position_rad": [0.1, -1.2, 1.9, -2.2, -1.5, 0.0],
     "hands": {"right": {"hand_position_in_base_m": [0.84, -0.35, 0.2],
                         "elbow_position_in_base_m": [1.0, -0.6, 0.25]},
               "left": null}}

Every part except ``time_s`` may be omitted if it was not measured. The value null stands for a lost hand.
"""

from __future__ import annotations

import json
from collections.abc import Collection

import msgspec

from safety_harness.base.exceptions import StreamError, near_miss
from safety_harness.extensions.field.logs.checked import FARTHEST_M, FARTHEST_RAD
from safety_harness.extensions.field.logs.streams import LATEST_S

FASTEST_RADPS = 100.0  # a joint with a larger speed has a mistake in its unit
MOST_CHARACTERS = 65_536  # a choice
Triple = tuple[float, float, float]


class HandSample(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The positions [m] of a hand's centre and of its elbow in the base frame."""

    hand_position_in_base_m: Triple
    elbow_position_in_base_m: Triple | None = None


class Sample(msgspec.Struct, forbid_unknown_fields=True, frozen=True, omit_defaults=True):
    """The measurements of a cell at ``time_s``. The joints are None if they were not measured."""

    time_s: float
    joint_position_rad: tuple[float, ...] | None = None
    joint_velocity_radps: tuple[float, ...] | None = None
    hands: dict[str, HandSample | None] = {}


_DECODER = msgspec.json.Decoder(Sample)


def read_sample(line: bytes, number: int, *, joints: int, hands: Collection[str], speeds: bool) -> Sample:
    """Return the sample in a line of the stream; raise StreamError if the line is wrong.

    Args:
        line: A line of the stream.
        number: The number of the line, for the error message.
        joints: The number of the arm's joints.
        hands: The names of the cell's hands. If the cell has no hands, hands in the line are ignored.
        speeds: True if a line with joint positions must also have joint speeds.

    """
    if len(line) > MOST_CHARACTERS:
        raise line_error(number, "line", f"at most {MOST_CHARACTERS:,} characters", f"{len(line):,} or more")
    try:
        sample = _DECODER.decode(line)
        # msgspec accepts a repeated name and keeps its last value, so a second parser looks for repetitions.
        json.loads(line, object_pairs_hook=lambda pairs: _refuse_twice(number, [name for name, _ in pairs]))
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        got = line[:60].decode(errors="replace").strip()
        raise line_error(number, "line", "a JSON object with time_s", f"{got!r} ({error})") from error
    _refuse_beyond(number, "time_s", (sample.time_s,), LATEST_S, "a time in seconds")
    position, velocity = sample.joint_position_rad, sample.joint_velocity_radps
    for name, values, most in (
        ("joint_position_rad", position, FARTHEST_RAD),
        ("joint_velocity_radps", velocity, FASTEST_RADPS),
    ):
        if values is not None:
            if len(values) != joints:
                raise line_error(number, name, f"{joints} numbers, one for each joint", str(len(values)))
            _refuse_beyond(number, name, values, most, f"numbers of at most {most:.4g} in size")
    if velocity is not None and position is None:
        raise line_error(number, "joint_velocity_radps", "joint_position_rad beside it", "none")
    if speeds and position is not None and velocity is None:
        expected = "joint_velocity_radps beside it, as the cell's joints have speeds known to"
        raise line_error(number, "joint_position_rad", expected, "none")
    for name, hand in sample.hands.items() if hands else ():
        if name not in hands:
            expected = f"hands that the monitor was told of: {', '.join(hands)}"
            hint = near_miss(name, hands) or "--hand NAME tells it of one"
            raise line_error(number, "hands", expected, name, hint)
        if hand is not None:
            for place in (hand.hand_position_in_base_m, hand.elbow_position_in_base_m or ()):
                _refuse_beyond(number, f"hands.{name}", place, FARTHEST_M, f"places within {FARTHEST_M:g} m")
    return sample


def _refuse_twice(number: int, names: list[str]) -> None:
    for at, name in enumerate(names):
        if name in names[:at]:
            raise line_error(
                number, name, "each name once", "it twice, and which of them counts is not known"
            )


def _refuse_beyond(number: int, name: str, values: tuple[float, ...], most: float, expected: str) -> None:
    for value in values:
        if not abs(value) <= most:  # also refuses a NaN
            raise line_error(number, name, expected, repr(value))


def line_error(number: int, name: str, expected: str, got: str, hint: str = "") -> StreamError:
    """Return an error about a line of the stream."""
    return StreamError.of_option(f"line {number} of the stream, {name}", expected, got, hint)


def line_of(sample: Sample) -> bytes:
    """Return ``sample`` as a JSON line of a stream."""
    return msgspec.json.encode(sample) + b"\n"
