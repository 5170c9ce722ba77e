"""A line of a stream: what was measured of a cell at one time, as JSON.

    {"time_s": 12.344, "joint_position_rad": [0.1, -1.2, 1.9, -2.2, -1.5, 0.0],
     "joint_velocity_radps": [0, 0, 0, 0, 0, 0],
     "hands": {"right": {"hand_position_in_base_m": [0.84, -0.35, 0.2],
                         "elbow_position_in_base_m": [1.0, -0.6, 0.25]},
               "left": null},
     "signals": {"servoing": true, "image error": 0.02}}

Any part but ``time_s`` may be missing: it was not measured then.  A hand that is null is lost; one that is
"absent" is known not to be there.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from safety_harness.exceptions import InputError
from safety_harness.formulas.signal import Interpolation, Signal
from safety_harness.formulas.signals import SIGNALS
from safety_harness.properties.base import HORIZON_M
from safety_harness.properties.hand_distance import TURNED_RAD
from safety_harness.scenario.model import MAX_HANDS
from safety_harness.trace.records import ENDLESS

FASTEST_RADPS = 100.0  # of any joint: what is more is a mistake of the unit
MOST_CHARACTERS = 65_536
Triple = tuple[float, float, float]
GIVEN: dict[str, Signal] = {one.words: one for one in SIGNALS if one.between is Interpolation.HELD}


class StreamError(InputError):
    """A line of a stream that cannot be used."""


class HandSample(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Centre of a hand and its elbow [m] in the base frame."""

    hand_position_in_base_m: Triple
    elbow_position_in_base_m: Triple | None = None


class Sample(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What was measured at ``time_s``."""

    time_s: float
    joint_position_rad: tuple[float, ...] | None = None
    joint_velocity_radps: tuple[float, ...] | None = None
    hands: dict[str, HandSample | Literal["absent"] | None] = {}
    signals: dict[str, float | bool] = {}


_DECODER = msgspec.json.Decoder(Sample)


def read_sample(line: bytes, number: int, joints: int) -> Sample:
    """The sample of a line of an arm of so many ``joints``; StreamError says what is wrong in which ``number``."""
    if len(line) > MOST_CHARACTERS:
        raise _error(number, "line", f"at most {MOST_CHARACTERS:,} characters", f"{len(line):,}")
    try:
        sample = _DECODER.decode(line)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        got = line[:60].decode(errors="replace").strip()
        raise _error(number, "line", "a JSON object with time_s", f"{got!r} ({error})") from error
    _refuse_beyond(number, "time_s", (sample.time_s,), 1e12, "a time in seconds")
    for name, most in (("joint_position_rad", TURNED_RAD), ("joint_velocity_radps", FASTEST_RADPS)):
        values: tuple[float, ...] | None = getattr(sample, name)
        if values is not None:
            if len(values) != joints:
                raise _error(number, name, f"{joints} numbers, one for each joint", str(len(values)))
            _refuse_beyond(number, name, values, most, f"numbers of at most {most:.4g} in size")
    if sample.joint_velocity_radps is not None and sample.joint_position_rad is None:
        raise _error(number, "joint_velocity_radps", "joint_position_rad beside it", "none")
    if len(sample.hands) > MAX_HANDS:
        raise _error(number, "hands", f"at most {MAX_HANDS}", str(len(sample.hands)))
    for hand in sample.hands.values():
        if isinstance(hand, HandSample):
            for place in (hand.hand_position_in_base_m, hand.elbow_position_in_base_m or ()):
                _refuse_beyond(number, "hands", place, HORIZON_M, f"positions within {HORIZON_M:g} m")
    for words, value in sample.signals.items():
        if words not in GIVEN:
            raise _error(number, "signals", f"one of {', '.join(GIVEN)}", words)
        _refuse_beyond(number, words, (value,), ENDLESS, "a finite number, or true or false")
    return sample


def _refuse_beyond(number: int, name: str, values: tuple[float, ...], most: float, expected: str) -> None:
    for value in values:
        if not abs(value) < most:  # of a NaN it is false
            raise _error(number, name, expected, repr(value))


def _error(number: int, name: str, expected: str, got: str) -> StreamError:
    return StreamError.of_option(f"line {number} of the stream, {name}", expected, got)


def line_of(sample: Sample) -> bytes:
    """As a stream has it."""
    return msgspec.json.encode(_without_nothing(msgspec.to_builtins(sample))) + b"\n"


def _without_nothing(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None and value != {}}
