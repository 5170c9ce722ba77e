"""The keys of hands and their moves."""

from __future__ import annotations

from safety_harness.scenario.fields import LARGEST_COORDINATE_M
from safety_harness.scenario.read_hands import (
    DEFAULT_FASTEST_JUMP_MPS,
    DEFAULT_LONGEST_GAP_S,
    FASTEST_MPS,
    LARGEST_FACTOR,
    LONGEST_GAP_S,
    LONGEST_S,
)
from safety_harness.scenario.reference import (
    POINT,
    REQUIRED,
    TURN,
    Below,
    Quantity,
    Several,
    Table,
    Text,
    Value,
    key_of,
    nice,
)
from safety_harness.scenario.units import LENGTH, NUMBER, SPEED, TIME

_SPEED = Quantity(dimension=SPEED, above=0.0, most=FASTEST_MPS)
_TIME = Quantity(dimension=TIME, above=0.0, most=LONGEST_S)
_DISTANCE = Quantity(dimension=LENGTH, least=0.0, most=LARGEST_COORDINATE_M)
_NAME = Text(form="name")


def _move(meaning: str, example: str, *keys: tuple[str, Value, str]) -> Table:
    name = keys[0][0]
    return Table(
        name=name,
        where=f"the move {name}",
        path=f"hands.moves.{name}",
        keys=tuple(
            key_of(key, value, REQUIRED, meaning if number == 0 else what, example)
            for number, (key, value, what) in enumerate(keys)
        ),
    )


MOVES = (
    _move("stay where the hand is", "- wait: 1 s", ("wait", _TIME, "")),
    _move(
        "straight there",
        "- move to: [840 mm, -350 mm, 5 mm]\n  speed: 0.5 m/s",
        ("move to", POINT, ""),
        ("speed", _SPEED, "how fast the hand moves"),
    ),
    _move(
        "head for the TCP, wherever it is, until that near, or give up",
        "- reach for tcp: 2 m/s\n  until: 100 mm\n  at most: 3 s",
        ("reach for tcp", _SPEED, ""),
        ("until", _DISTANCE, "the distance to the TCP at which the reach ends"),
        ("at most", _TIME, "when the hand gives up, if the TCP gives way for that long"),
    ),
    _move(
        "keep heading for the TCP for that long, never nearer than that",
        "- follow tcp: 0.3 m/s\n  keeping: 250 mm\n  for: 4 s",
        ("follow tcp", _SPEED, ""),
        ("keeping", _DISTANCE, "the distance to the TCP below which the hand does not come"),
        ("for", _TIME, "how long the hand follows"),
    ),
    _move("straight back to where the hand started", "- withdraw: 1.6 m/s", ("withdraw", _SPEED, "")),
)
_STARTS_AT = "starts at: [1.2 m, -0.7 m, 100 mm]"
MOVING_HAND = Table(
    name="a hand that moves",
    where="a hand that moves",
    path="hands",
    keys=(
        key_of(
            "hand",
            _NAME,
            REQUIRED,
            "for messages and reports; another one for each hand",
            "- hand: right",
        ),
        key_of("starts at", POINT, REQUIRED, "the hand's centre at time 0", _STARTS_AT),
        key_of(
            "elbow towards",
            POINT,
            REQUIRED,
            "where the forearm points, at every moment",
            "elbow towards: [1.6 m, -1.2 m, 300 mm]",
        ),
        key_of(
            "moves",
            Several(of=Below(tables=MOVES), form="list"),
            REQUIRED,
            "what it does; an empty list for a hand that rests",
            "moves:\n  - wait: 1 s\n  - withdraw: 1.6 m/s",
        ),
    ),
)
RECORDED_HAND = Table(
    name="a hand that repeats a recording",
    where="a hand that repeats a recording",
    path="hands",
    keys=(
        key_of(
            "recording",
            Text(form="path"),
            REQUIRED,
            "of the CSV file, relative to the scenario file",
            "- recording: recordings/robothumanhandover-0.csv",
        ),
        key_of(
            "sha256",
            Text(form="64 hex digits", pattern="^[0-9a-f]{64}$"),
            "none",
            "refuse a file with other contents",
            f"sha256: {'0123456789abcdef' * 4}",
        ),
        key_of("hand", _NAME, "the track", "for messages and reports", "hand: right"),
        key_of(
            "track",
            _NAME,
            REQUIRED,
            "`right hand` means the columns `right_hand_x_m` and so on",
            "track: right hand",
        ),
        key_of(
            "elbow track",
            _NAME,
            "the same side's elbow, if it was recorded",
            "the person's elbow",
            "elbow track: right elbow",
        ),
        key_of(
            "elbow towards",
            POINT,
            "none",
            "in place of an elbow track: where the forearm points, at every moment",
            "elbow towards: [1.6 m, -1.2 m, 300 mm]",
        ),
        key_of("starts at", POINT, REQUIRED, "where the first sample that is used is put", _STARTS_AT),
        key_of("turned", TURN, "0 deg", "about the vertical through that first sample", "turned: 20 deg"),
        key_of(
            "speed factor",
            Quantity(dimension=NUMBER, least=0.01, most=LARGEST_FACTOR),
            "1.0",
            "how many times as fast as it was recorded",
            "speed factor: 1.5",
        ),
        key_of(
            "from",
            Quantity(dimension=TIME),
            "its beginning",
            "where the part that is used begins, in the recording's own time",
            "from: 1.5 s",
        ),
        key_of(
            "to",
            Quantity(dimension=TIME),
            "its end",
            "where the part that is used ends",
            "to: 13 s",
        ),
        key_of(
            "longest gap",
            Quantity(dimension=TIME, above=0.0, most=LONGEST_GAP_S),
            nice(DEFAULT_LONGEST_GAP_S, TIME),
            "how long the track may be missing",
            "longest gap: 300 ms",
        ),
        key_of(
            "fastest jump",
            Quantity(dimension=SPEED, above=0.0, most=FASTEST_MPS),
            nice(DEFAULT_FASTEST_JUMP_MPS, SPEED),
            "what is faster is another marker, not this one",
            "fastest jump: 4 m/s",
        ),
    ),
)
