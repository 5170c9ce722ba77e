"""The keys of a scenario file, mapping by mapping, in the order in which they are best written."""

from __future__ import annotations

from safety_harness.scenario.compose import LONGEST_CHAIN, MOST_COMBINATIONS
from safety_harness.scenario.faults import MOST_FAULTS
from safety_harness.scenario.model import MAX_HANDS, Robot, Verdict
from safety_harness.scenario.read import DEFAULT_AVOIDER, LARGEST_SEED, SETTINGS_KEYS, TOP_GROUPS
from safety_harness.scenario.read_moves import LONGEST_S
from safety_harness.scenario.reference import (
    POINT,
    REQUIRED,
    ROTATION,
    TURN,
    Below,
    FreeKeys,
    KeyTable,
    QuantityValue,
    Several,
    Text,
    Word,
    below,
    key_of,
)
from safety_harness.scenario.reference_faults import fault_tables
from safety_harness.scenario.reference_hands import JOINED_HAND, MOVING_HAND, RECORDED_HAND
from safety_harness.scenario.reference_settings import group_table
from safety_harness.scenario.units import NUMBER, TIME

_TIME = QuantityValue(dimension=TIME, above=0.0, most=LONGEST_S)
_VERDICT = Word(options=tuple(verdict.value for verdict in Verdict))


_TILTED = "tilt: [0 deg, 3 deg, 0 deg]"
TCP_START = KeyTable(
    name="tcp start",
    where="tcp start",
    path="tcp start",
    keys=(
        key_of(
            "offset",
            POINT,
            "one of these three",
            "from the desired TCP, along the axes of the base",
            "tcp start: {offset: [40 mm, -120 mm, 60 mm]}",
        ),
        key_of(
            "position",
            POINT,
            "",
            "of the TCP in the base frame, in place of `offset`",
            "tcp start: {position: [680 mm, 60 mm, 410 mm]}",
        ),
        key_of(
            "joints",
            Several(of=TURN, form="list of six angles", count=6),
            "",
            "pan, lift, elbow, wrist 1, 2, 3; in place of `offset` and `tilt`",
            "tcp start: {joints: [-12 deg, -73 deg, 113 deg, -130 deg, -90 deg, -103 deg]}",
        ),
        key_of(
            "tilt",
            ROTATION,
            "none",
            "of the tool, from looking straight down, in the desired TCP's own frame",
            f"tcp start: {{offset: [0 mm, 0 mm, 0 mm], {_TILTED}}}",
        ),
    ),
)
GROUPS = {
    **{key: group_table(key, key) for key in TOP_GROUPS},
    **{key: group_table(key, f"settings.{key}") for key in SETTINGS_KEYS},
}
SETTINGS = KeyTable(
    name="settings",
    where="settings",
    path="settings",
    keys=tuple(
        key_of(
            key,
            Below(tables=(GROUPS[key],)),
            "the defaults",
            "a group of settings",
            GROUPS[key].keys[0].example,
        )
        for key in SETTINGS_KEYS
    ),
)
_HANDS = (MOVING_HAND, JOINED_HAND, RECORDED_HAND)
_LINE = Text(form="text, one line")
_PROSE = Text(form="text")
TOP = KeyTable(
    name="a scenario",
    where="a scenario",
    keys=(
        key_of(
            "scenario",
            _LINE,
            REQUIRED,
            "what is tried, as a title",
            "scenario: a hand reaches for the tool and withdraws",
        ),
        key_of("about", _PROSE, "empty", "why one would try it", "about: The reach is fast."),
        key_of(
            "duration",
            _TIME,
            REQUIRED,
            "how long the run lasts; from one to 1,000,000 control periods. It is not rounded: the run ends "
            "with the first control tick at or after it",
            "duration: 12 s",
            said=f"time, at most {LONGEST_S:g} s",
        ),
        key_of(
            "seed",
            QuantityValue(dimension=NUMBER, least=0, most=LARGEST_SEED, whole=True),
            "0",
            "every random number of the run descends from it",
            "seed: 7",
            said="whole number from 0 to 2^63 - 1",
        ),
        key_of(
            "robot",
            Word(options=tuple(robot.value for robot in Robot)),
            Robot.UR10.value,
            "the arm in the cell ([robots](#robot))",
            "robot: UR5",
        ),
        key_of(
            "tcp start",
            Below(tables=(TCP_START,)),
            REQUIRED,
            "where the tool is at the beginning",
            "tcp start: {offset: [40 mm, -120 mm, 60 mm]}",
        ),
        key_of(
            "avoider",
            Text(form="name or file"),
            DEFAULT_AVOIDER,
            "what proposes repulsive positions: a name, `FILE.py:NAME` or `FILE.safetensors` "
            "([avoiders](avoiders.md))",
            "avoider: opposite pose",
        ),
        key_of(
            "object",
            Below(tables=(GROUPS["object"],)),
            "the default object",
            "what is servoed on, and where it lies",
            "object: {position: [720 mm, 60 mm, -300 mm], yaw: 40 deg}",
        ),
        key_of(
            "hands",
            Several(of=Below(tables=_HANDS), form="list of at most two", most=MAX_HANDS),
            "none",
            "what the hands do",
            "hands:\n  - hand: right\n    starts at: [1.2 m, -0.7 m, 100 mm]\n"
            "    elbow towards: [1.6 m, -1.2 m, 300 mm]\n    moves:\n      - wait: 1 s",
        ),
        key_of(
            "faults",
            Several(of=Below(tables=fault_tables()), form=f"list of at most {MOST_FAULTS}", most=MOST_FAULTS),
            "none",
            "what goes wrong, and when",
            "faults:\n  - hand sensor: freezes\n    from: 500 ms\n    for: 200 ms",
        ),
        key_of(
            "hand sensor",
            Below(tables=(GROUPS["hand sensor"],)),
            "an ideal sensor",
            "the camera that watches the hands, and how it errs",
            "hand sensor: {kind: overhead, rate: 30 Hz}",
        ),
        key_of(
            "camera",
            Below(tables=(GROUPS["camera"],)),
            "exact images",
            "the eye-in-hand camera, and how it errs",
            "camera: {source: raster, rate: 30 Hz}",
        ),
        key_of(
            "settings",
            Below(tables=(SETTINGS,)),
            "the defaults",
            "every other value of the system",
            "settings: {avoidance: {critical distance: 350 mm}}",
        ),
        key_of(
            "claims",
            FreeKeys(of=_VERDICT, form="mapping, at least one", least=1),
            REQUIRED,
            "sentences of the catalogue and formulas, each with the verdict that you expect",
            "claims:\n  hand distance never below 50 mm: holds",
        ),
    ),
)
_PLAIN_MAPPING = FreeKeys(of=FreeKeys(of=Below(tables=()), form="mapping", least=1), form="mapping", least=1)
COMPOSED = KeyTable(
    name="files made of others",
    where="a scenario that is made of others",
    keys=(
        key_of(
            "extends",
            Text(form="path"),
            "none",
            f"the file whose values hold where this one says nothing; at most {LONGEST_CHAIN} in a chain",
            "extends: bases/overhead.yaml",
        ),
        key_of(
            "without",
            Several(of=Text(form="key or claim"), form="list of keys and claims", least=1),
            "none",
            "what of the extended file does not hold: keys at its top, or claims",
            "without: [hands, hand distance never below 50 mm]",
        ),
        key_of(
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
SUITE = KeyTable(
    name="a suite",
    where="a suite",
    keys=(
        key_of("suite", _LINE, REQUIRED, "what these scenarios are for", "suite: before a release"),
        key_of("about", _PROSE, "empty", "why one would run it", "about: All of it takes a minute."),
        key_of(
            "scenarios",
            Several(of=Text(form="path"), form="list of paths", least=1),
            REQUIRED,
            "files, folders and other suites, relative to this file",
            "scenarios: [fast-reach.yaml, recorded]",
        ),
    ),
)


def every_table() -> tuple[KeyTable, ...]:
    """All tables, each once, from the top of a file downwards."""
    found = [TOP, COMPOSED, SUITE]
    for key in TOP.keys:
        found += [table for table in below(key.value) if not any(table is other for other in found)]
    return tuple(found)
