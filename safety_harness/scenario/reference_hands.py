"""The keys of hands and their moves."""

from __future__ import annotations

from safety_harness.scenario.fields import LARGEST_COORDINATE_M
from safety_harness.scenario.moves import REACHING_MPS, REACHING_MPS2
from safety_harness.scenario.read_hands import (
    ACCELERATIONS_MPS2,
    DEFAULT_FASTEST_JUMP_MPS,
    DEFAULT_LONGEST_GAP_S,
    LARGEST_FACTOR,
    LONGEST_GAP_S,
    TREMORS_HZ,
    TREMORS_M,
)
from safety_harness.scenario.read_moves import FASTEST_MPS, LONGEST_S, MOST_TIMES
from safety_harness.scenario.reference import (
    POINT,
    REQUIRED,
    TURN,
    Below,
    KeyTable,
    QuantityValue,
    Several,
    Text,
    Value,
    key_of,
    nice,
)
from safety_harness.scenario.units import ACCELERATION, LENGTH, NUMBER, RATE, SPEED, TIME

_SPEED = QuantityValue(dimension=SPEED, above=0.0, most=FASTEST_MPS)
_TIME = QuantityValue(dimension=TIME, above=0.0, most=LONGEST_S)
_DISTANCE = QuantityValue(dimension=LENGTH, least=0.0, most=LARGEST_COORDINATE_M)
_NAME = Text(form="name")


def _move(meaning: str, example: str, *keys: tuple[str, Value, str], optional: int = 0) -> KeyTable:
    """A move: its own key first; the last ``optional`` ones need not be there."""
    name = keys[0][0]
    defaults = [REQUIRED] * (len(keys) - optional) + ["none"] * optional
    return KeyTable(
        name=name,
        where=f"the move {name}",
        path=f"hands.moves.{name}",
        keys=tuple(
            key_of(key, value, default, meaning if key == name else what, example)
            for (key, value, what), default in zip(keys, defaults, strict=True)
        ),
    )


_BOX = Several(of=POINT, form="two opposite corners of a box", count=2)
_TIMES = QuantityValue(dimension=NUMBER, least=1, most=MOST_TIMES, whole=True)
_REACH_ON = (
    ("hesitating at", _DISTANCE, "the distance at which the hand stops on its way"),
    ("for", _TIME, "how long it stops there"),
)
MOVES = (
    _move("stop, and stay there", "- wait: 1 s", ("wait", _TIME, "")),
    _move(
        "straight there",
        "- move to: [840 mm, -350 mm, 5 mm]\n  speed: 0.5 m/s",
        ("move to", POINT, ""),
        ("speed", _SPEED, "how fast the hand moves"),
    ),
    _move(
        "head for the TCP, wherever it is, until that near, or give up; on the way, if the last two are "
        "there, stop that far from it for that long",
        "- reach for tcp: 2 m/s\n  until: 100 mm\n  at most: 3 s",
        ("reach for tcp", _SPEED, ""),
        ("until", _DISTANCE, "the distance to the TCP at which the reach ends"),
        ("at most", _TIME, "when the hand gives up, if the TCP gives way for that long"),
        *_REACH_ON,
        optional=2,
    ),
    _move(
        "the same, straight to the object",
        "- reach for object: 2 m/s\n  until: 100 mm\n  at most: 3 s\n  hesitating at: 400 mm\n  for: 300 ms",
        ("reach for object", _SPEED, ""),
        ("until", _DISTANCE, "the distance to the object's origin at which the reach ends"),
        ("at most", _TIME, "when the hand gives up"),
        *_REACH_ON,
        optional=2,
    ),
    _move(
        "keep heading for the TCP for that long, to stop that far from it",
        "- follow tcp: 0.3 m/s\n  keeping: 250 mm\n  for: 4 s",
        ("follow tcp", _SPEED, ""),
        ("keeping", _DISTANCE, "the distance to the TCP at which the hand stops"),
        ("for", _TIME, "how long the hand follows"),
    ),
    _move(
        "straight from one point of the box to another for that long; the points are drawn from the seed",
        "- wander: 0.6 m/s\n  within: [[1.0 m, -0.6 m, 0 mm], [1.2 m, -0.4 m, 200 mm]]\n  for: 2 s",
        ("wander", _SPEED, ""),
        ("within", _BOX, "the box that the hand does not leave"),
        ("for", _TIME, "how long the hand wanders"),
    ),
    _move(
        "to the one point, then so many times to the other and back",
        "- sweep: 0.8 m/s\n  from: [0.9 m, -0.3 m, -100 mm]\n  to: [0.9 m, -0.6 m, -100 mm]\n  times: 3",
        ("sweep", _SPEED, ""),
        ("from", POINT, "where a sweep begins and ends"),
        ("to", POINT, "where it turns"),
        ("times", _TIMES, "how often it goes there and back"),
    ),
    _move("straight back to where the hand started", "- withdraw: 1.6 m/s", ("withdraw", _SPEED, "")),
)
TREMOR = KeyTable(
    name="tremor",
    where="tremor of a hand",
    keys=(
        key_of(
            "amplitude",
            QuantityValue(dimension=LENGTH, least=TREMORS_M[0], most=TREMORS_M[1]),
            REQUIRED,
            "the displacement is never larger",
            "tremor: {amplitude: 1 mm, rate: 8 Hz}",
        ),
        key_of(
            "rate",
            QuantityValue(dimension=RATE, least=TREMORS_HZ[0], most=TREMORS_HZ[1]),
            REQUIRED,
            "of the ellipse that it goes along",
            "tremor: {amplitude: 1 mm, rate: 8 Hz}",
        ),
    ),
)
_NO_SHIFT, _SHIFT = "[0 mm, 0 mm, 0 mm]", "shifted by: [0 mm, 50 mm, 0 mm]"
_LATER = "delayed by: 500 ms"
_DELAY = QuantityValue(dimension=TIME, least=0.0, most=LONGEST_S)
_STARTS_AT = "starts at: [1.2 m, -0.7 m, 100 mm]"
MOVING_HAND = KeyTable(
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
        key_of("starts at", POINT, REQUIRED, "the hand's centre at time 0, where it is at rest", _STARTS_AT),
        key_of(
            "elbow towards",
            POINT,
            REQUIRED,
            "where the forearm points, at every moment",
            "elbow towards: [1.6 m, -1.2 m, 300 mm]",
        ),
        key_of(
            "shifted by", POINT, _NO_SHIFT, "added to `starts at` and to every point of the moves", _SHIFT
        ),
        key_of("delayed by", _DELAY, "0 s", "how long it waits before its first move", _LATER),
        key_of(
            "speed at most",
            _SPEED,
            nice(REACHING_MPS, SPEED),
            "no move may say more than this, less the tremor's own speed",
            "speed at most: 2.5 m/s",
        ),
        key_of(
            "acceleration at most",
            QuantityValue(dimension=ACCELERATION, least=ACCELERATIONS_MPS2[0], most=ACCELERATIONS_MPS2[1]),
            nice(REACHING_MPS2, ACCELERATION),
            "how hard the hand speeds up, turns and brakes",
            "acceleration at most: 20 m/s2",
        ),
        key_of(
            "tremor",
            Below(tables=(TREMOR,)),
            "none",
            "a small motion on top, at rest too",
            "tremor: {amplitude: 1 mm, rate: 8 Hz}",
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
_TOWARDS = "elbow towards: [1.6 m, -1.2 m, 300 mm]"
JOINED_HAND = KeyTable(
    name="a hand that goes with another",
    where="a hand that goes with another",
    path="hands",
    told_by="together with",
    keys=(
        key_of("hand", _NAME, REQUIRED, "for messages and reports", "- hand: left"),
        key_of("together with", _NAME, REQUIRED, "of the hand that leads", "together with: right"),
        key_of(
            "apart", POINT, REQUIRED, "from that hand's centre to this one's", "apart: [0 mm, 300 mm, 0 mm]"
        ),
        key_of("elbow towards", POINT, REQUIRED, "where the forearm points, at every moment", _TOWARDS),
    ),
)
RECORDED_HAND = KeyTable(
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
        key_of("shifted by", POINT, _NO_SHIFT, "added to `starts at`", _SHIFT),
        key_of("delayed by", _DELAY, "0 s", "how long the hand rests at its first sample", _LATER),
        key_of(
            "speed factor",
            QuantityValue(dimension=NUMBER, least=0.01, most=LARGEST_FACTOR),
            "1.0",
            "how many times as fast as it was recorded",
            "speed factor: 1.5",
        ),
        key_of(
            "speed at most",
            _SPEED,
            "as recorded; 2 m/s with a `speed factor` above 1",
            "a recording that is faster, as it is used, is refused",
            "speed at most: 2.5 m/s",
        ),
        key_of(
            "from",
            QuantityValue(dimension=TIME),
            "its beginning",
            "where the part that is used begins, in the recording's own time",
            "from: 1.5 s",
        ),
        key_of(
            "to",
            QuantityValue(dimension=TIME),
            "its end",
            "where the part that is used ends",
            "to: 13 s",
        ),
        key_of(
            "longest gap",
            QuantityValue(dimension=TIME, above=0.0, most=LONGEST_GAP_S),
            nice(DEFAULT_LONGEST_GAP_S, TIME),
            "how long the track may be missing",
            "longest gap: 300 ms",
        ),
        key_of(
            "fastest jump",
            QuantityValue(dimension=SPEED, above=0.0, most=FASTEST_MPS),
            nice(DEFAULT_FASTEST_JUMP_MPS, SPEED),
            "what is faster is another marker, not this one",
            "fastest jump: 4 m/s",
        ),
    ),
)
