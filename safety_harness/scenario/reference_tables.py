"""The keys of a scenario file, mapping by mapping, in the order in which they are best written."""

from __future__ import annotations

from safety_harness.scenario.compose import LONGEST_CHAIN, MOST_COMBINATIONS
from safety_harness.scenario.faults import MOST_FAULTS
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M
from safety_harness.scenario.model import Robot, Verdict
from safety_harness.scenario.read import DEFAULT_AVOIDER, LARGEST_SEED, SETTINGS_KEYS, TOP_GROUPS
from safety_harness.scenario.read_hands import (
    DEFAULT_FASTEST_JUMP_MPS,
    DEFAULT_LONGEST_GAP_S,
    FASTEST_MPS,
    LARGEST_FACTOR,
    LONGEST_GAP_S,
    LONGEST_S,
)
from safety_harness.scenario.reference import (
    REQUIRED,
    Below,
    FreeKeys,
    Key,
    Quantity,
    Several,
    Table,
    Text,
    Value,
    Word,
    below,
    nice,
)
from safety_harness.scenario.reference_faults import fault_tables
from safety_harness.scenario.reference_settings import group_table
from safety_harness.scenario.units import ANGLE, LENGTH, NUMBER, SPEED, TIME

_COORDINATE = Quantity(dimension=LENGTH, least=-LARGEST_COORDINATE_M, most=LARGEST_COORDINATE_M)
_TURN = Quantity(dimension=ANGLE, least=-LARGEST_ANGLE_RAD, most=LARGEST_ANGLE_RAD)
_POINT = Several(of=_COORDINATE, form="point", count=3)
_ROTATION = Several(of=_TURN, form="rotation", count=3)
_SPEED = Quantity(dimension=SPEED, above=0.0, most=FASTEST_MPS)
_TIME = Quantity(dimension=TIME, above=0.0, most=LONGEST_S)
_DISTANCE = Quantity(dimension=LENGTH, least=0.0, most=LARGEST_COORDINATE_M)
_NAME = Text(form="name")
_VERDICT = Word(options=tuple(verdict.value for verdict in Verdict))


def _key(name: str, value: Value, default: str, meaning: str, example: str, said: str = "") -> Key:
    return Key(name=name, value=value, default=default, meaning=meaning, example=example, said=said)


TCP_START = Table(
    name="tcp start",
    where="tcp start",
    path="tcp start",
    keys=(
        _key(
            "offset",
            _POINT,
            "required without `joints`",
            "from the desired TCP, along the axes of the base",
            "tcp start: {offset: [40 mm, -120 mm, 60 mm]}",
        ),
        _key(
            "tilt",
            _ROTATION,
            "none",
            "of the tool, in the desired TCP's own frame",
            "tcp start: {offset: [0 mm, 0 mm, 0 mm], tilt: [0 deg, 3 deg, 0 deg]}",
        ),
        _key(
            "joints",
            Several(of=_TURN, form="list of six angles", count=6),
            "",
            "pan, lift, elbow, wrist 1, 2, 3; in place of `offset` and `tilt`",
            "tcp start: {joints: [-12 deg, -73 deg, 113 deg, -130 deg, -90 deg, -103 deg]}",
        ),
    ),
)


def _move(meaning: str, example: str, *keys: tuple[str, Value, str]) -> Table:
    name = keys[0][0]
    return Table(
        name=name,
        where=f"the move {name}",
        path=f"hands.moves.{name}",
        keys=tuple(
            _key(key, value, REQUIRED, meaning if number == 0 else what, example)
            for number, (key, value, what) in enumerate(keys)
        ),
    )


MOVES = (
    _move("stay where the hand is", "- wait: 1 s", ("wait", _TIME, "")),
    _move(
        "straight there",
        "- move to: [840 mm, -350 mm, 5 mm]\n  speed: 0.5 m/s",
        ("move to", _POINT, ""),
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
        _key(
            "hand",
            _NAME,
            REQUIRED,
            "for messages and reports; another one for each hand",
            "- hand: right",
        ),
        _key("starts at", _POINT, REQUIRED, "the hand's centre at time 0", _STARTS_AT),
        _key(
            "elbow towards",
            _POINT,
            REQUIRED,
            "where the forearm points, at every moment",
            "elbow towards: [1.6 m, -1.2 m, 300 mm]",
        ),
        _key(
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
        _key(
            "recording",
            Text(form="path"),
            REQUIRED,
            "of the CSV file, relative to the scenario file",
            "- recording: recordings/robothumanhandover-0.csv",
        ),
        _key(
            "sha256",
            Text(form="64 hex digits", pattern="^[0-9a-f]{64}$"),
            "none",
            "refuse a file with other contents",
            f"sha256: {'0123456789abcdef' * 4}",
        ),
        _key("hand", _NAME, "the track", "for messages and reports", "hand: right"),
        _key(
            "track",
            _NAME,
            REQUIRED,
            "`right hand` means the columns `right_hand_x_m` and so on",
            "track: right hand",
        ),
        _key(
            "elbow track",
            _NAME,
            "the same side's elbow, if it was recorded",
            "the person's elbow",
            "elbow track: right elbow",
        ),
        _key(
            "elbow towards",
            _POINT,
            "none",
            "in place of an elbow track: where the forearm points, at every moment",
            "elbow towards: [1.6 m, -1.2 m, 300 mm]",
        ),
        _key("starts at", _POINT, REQUIRED, "where the first sample that is used is put", _STARTS_AT),
        _key("turned", _TURN, "0 deg", "about the vertical through that first sample", "turned: 20 deg"),
        _key(
            "speed factor",
            Quantity(dimension=NUMBER, least=0.01, most=LARGEST_FACTOR),
            "1.0",
            "how many times as fast as it was recorded",
            "speed factor: 1.5",
        ),
        _key(
            "from",
            Quantity(dimension=TIME),
            "its beginning",
            "where the part that is used begins, in the recording's own time",
            "from: 1.5 s",
        ),
        _key(
            "to",
            Quantity(dimension=TIME),
            "its end",
            "where the part that is used ends",
            "to: 13 s",
        ),
        _key(
            "longest gap",
            Quantity(dimension=TIME, above=0.0, most=LONGEST_GAP_S),
            nice(DEFAULT_LONGEST_GAP_S, TIME),
            "how long the track may be missing",
            "longest gap: 300 ms",
        ),
        _key(
            "fastest jump",
            Quantity(dimension=SPEED, above=0.0, most=FASTEST_MPS),
            nice(DEFAULT_FASTEST_JUMP_MPS, SPEED),
            "what is faster is another marker, not this one",
            "fastest jump: 4 m/s",
        ),
    ),
)
GROUPS = {
    **{key: group_table(key, key) for key in TOP_GROUPS},
    **{key: group_table(key, f"settings.{key}") for key in SETTINGS_KEYS},
}
SETTINGS = Table(
    name="settings",
    where="settings",
    path="settings",
    keys=tuple(
        _key(
            key,
            Below(tables=(GROUPS[key],)),
            "the defaults",
            "a group of settings",
            GROUPS[key].keys[0].example,
        )
        for key in SETTINGS_KEYS
    ),
)
_LINE = Text(form="text, one line")
_PROSE = Text(form="text")
TOP = Table(
    name="a scenario",
    where="a scenario",
    keys=(
        _key(
            "scenario",
            _LINE,
            REQUIRED,
            "what is tried, as a title",
            "scenario: a hand reaches for the tool and withdraws",
        ),
        _key("about", _PROSE, "empty", "why one would try it", "about: The reach is fast."),
        _key(
            "duration",
            _TIME,
            REQUIRED,
            "how long the run lasts; from one to 1,000,000 control periods. It is not rounded: the run ends "
            "with the first control tick at or after it",
            "duration: 12 s",
            said=f"time, at most {LONGEST_S:g} s",
        ),
        _key(
            "seed",
            Quantity(dimension=NUMBER, least=0, most=LARGEST_SEED, whole=True),
            "0",
            "every random number of the run descends from it",
            "seed: 7",
            said="whole number from 0 to 2^63 - 1",
        ),
        _key(
            "robot",
            Word(options=tuple(robot.value for robot in Robot)),
            Robot.UR10.value,
            "the arm in the cell ([robots](#robot))",
            "robot: UR5",
        ),
        _key(
            "tcp start",
            Below(tables=(TCP_START,)),
            REQUIRED,
            "where the tool is at the beginning",
            "tcp start: {offset: [40 mm, -120 mm, 60 mm]}",
        ),
        _key(
            "avoider",
            Text(form="name or file"),
            DEFAULT_AVOIDER,
            "what proposes repulsive positions: a name, `FILE.py:NAME` or `FILE.safetensors` "
            "([avoiders](avoiders.md))",
            "avoider: opposite pose",
        ),
        _key(
            "hands",
            Several(of=Below(tables=(MOVING_HAND, RECORDED_HAND)), form="list of at most two", most=2),
            "none",
            "what the hands do",
            "hands:\n  - hand: right\n    starts at: [1.2 m, -0.7 m, 100 mm]\n"
            "    elbow towards: [1.6 m, -1.2 m, 300 mm]\n    moves:\n      - wait: 1 s",
        ),
        _key(
            "faults",
            Several(of=Below(tables=fault_tables()), form=f"list of at most {MOST_FAULTS}", most=MOST_FAULTS),
            "none",
            "what goes wrong, and when",
            "faults:\n  - hand sensor: freezes\n    from: 500 ms\n    for: 200 ms",
        ),
        _key(
            "hand sensor",
            Below(tables=(GROUPS["hand sensor"],)),
            "an ideal sensor",
            "the camera that watches the hands, and how it errs",
            "hand sensor: {kind: overhead, rate: 30 Hz}",
        ),
        _key(
            "camera",
            Below(tables=(GROUPS["camera"],)),
            "exact images",
            "the eye-in-hand camera, and how it errs",
            "camera: {source: raster, rate: 30 Hz}",
        ),
        _key(
            "settings",
            Below(tables=(SETTINGS,)),
            "the defaults",
            "every other value of the system",
            "settings: {avoidance: {critical distance: 350 mm}}",
        ),
        _key(
            "claims",
            FreeKeys(of=_VERDICT, form="mapping, at least one", least=1),
            REQUIRED,
            "sentences of the catalogue, each with the verdict that you expect",
            "claims:\n  hand distance never below 50 mm: holds",
        ),
    ),
)
_PLAIN_MAPPING = FreeKeys(of=FreeKeys(of=Below(tables=()), form="mapping", least=1), form="mapping", least=1)
COMPOSED = Table(
    name="files made of others",
    where="a scenario that is made of others",
    keys=(
        _key(
            "extends",
            Text(form="path"),
            "none",
            f"the file whose values hold where this one says nothing; at most {LONGEST_CHAIN} in a chain",
            "extends: bases/overhead.yaml",
        ),
        _key(
            "without",
            Several(of=Text(form="key or claim"), form="list of keys and claims", least=1),
            "none",
            "what of the extended file does not hold: keys at its top, or claims",
            "without: [hands, hand distance never below 50 mm]",
        ),
        _key(
            "matrix",
            _PLAIN_MAPPING,
            "none",
            "axes, each with labels and what they change: one scenario for each combination, at most "
            f"{MOST_COMBINATIONS:,}",
            "matrix:\n  sensor:\n    ideal: {hand sensor: {kind: ideal}}\n"
            "    late: {hand sensor: {kind: overhead, latency: 50 ms}}",
            said="mapping of mappings",
        ),
    ),
)
SUITE = Table(
    name="a suite",
    where="a suite",
    keys=(
        _key("suite", _LINE, REQUIRED, "what these scenarios are for, as a title", "suite: before a release"),
        _key("about", _PROSE, "empty", "why one would run it", "about: All of it takes a minute."),
        _key(
            "scenarios",
            Several(of=Text(form="path"), form="list of paths", least=1),
            REQUIRED,
            "files, folders and other suites, relative to this file",
            "scenarios: [fast-reach.yaml, recorded]",
        ),
    ),
)


def every_table() -> tuple[Table, ...]:
    """All tables, each once, from the top of a file downwards."""
    found = [TOP, COMPOSED, SUITE]
    for key in TOP.keys:
        found += [table for table in below(key.value) if not any(table is other for other in found)]
    return tuple(found)
