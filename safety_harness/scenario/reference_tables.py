"""The tables of all keys of a scenario file, one table for each mapping, in the recommended order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from safety_harness.base.exceptions import near_miss
from safety_harness.base.extension_points import ExtensionPoint, loaded, names_of, part_named
from safety_harness.scenario.codec import (
    Below,
    FreeKeys,
    Key,
    KeyTable,
    QuantityValue,
    Several,
    Text,
    Tree,
)
from safety_harness.scenario.compose import LONGEST_CHAIN, MOST_COMBINATIONS
from safety_harness.scenario.faults import MOST_FAULTS, fault_tables
from safety_harness.scenario.fields import Field
from safety_harness.scenario.gate import GATE
from safety_harness.scenario.model import (
    BY_AT_MOST,
    DEFAULT_AVOIDER,
    HANDS,
    LARGEST_SEED,
    START,
    VISUAL_SERVO,
    Claim,
)
from safety_harness.scenario.moves import LASTING, LONGEST_S
from safety_harness.scenario.obstacles import OBSTACLES
from safety_harness.scenario.robots import ROBOT_VALUE, Robot
from safety_harness.scenario.settings_keys import SETTINGS_KEYS, TOP_GROUPS, group_table
from safety_harness.scenario.shield import SHIELD_VALUE
from safety_harness.scenario.units import NUMBER, shown

EXPECTED = "holds, violated, inconclusive or, with a bound, violated by at most 130 mm"


def _expectation(claim: Claim) -> str:
    """Return the expected verdict of a claim in the form that a file contains."""
    return claim.expectation


CLAIMS = FreeKeys(
    of=Text(
        kind=EXPECTED, pattern=f"^(holds|violated|inconclusive|violated{BY_AT_MOST}.+)$", writes=_expectation
    ),
    kind="mapping, at least one",
    expected="a mapping of claims, such as hand distance never below 50 mm: holds",
    least=1,
)

_STARTS = {key.name: key for table in START.tables for key in table.keys}
_FORMS = (*(replace(key, or_else="") for key in (_STARTS["position"], _STARTS["joints"])), _STARTS["tilt"])


class _StartTable(KeyTable):
    """The table of a TCP start, which has three alternative forms."""

    def read(self, field: Field) -> Any:
        """Return the start.

        Raise ScenarioError if the keys belong to more than one form of a start.
        """
        given = field.fields(self.names)
        given_keys = [key for key in self.names if key in given and key != "tilt"]
        if len(given_keys) > 1 or ("joints" in given and "tilt" in given):
            extra = given.required(given_keys[1] if len(given_keys) > 1 else "tilt")
            expected = "one of offset, position (each with a tilt, if you want) and joints"
            raise extra.error(expected, got="both")
        return START.by_key[given_keys[0] if given_keys else "offset"].made_of(given)


TCP_START = _StartTable(
    name="tcp start",
    path="tcp start",
    keys=(replace(_STARTS["offset"], or_else="one of these three"), *_FORMS),
)
GROUPS = {
    **{key: group_table(key, key) for key in TOP_GROUPS},
    **{key: group_table(key, f"settings.{key}") for key in SETTINGS_KEYS},
}
SETTINGS = KeyTable(
    name="settings",
    path="settings",
    keys=tuple(
        Key(key, Below(tables=(group,)), "a group of settings", group.keys[0].lines, "the defaults")
        for key, group in GROUPS.items()
        if key in SETTINGS_KEYS
    ),
)


def _title(field: Field) -> str:
    """Return a title.

    Raise ScenarioError for an empty title.
    """
    title = field.prose("a title on one line")
    if not title.strip():
        raise field.error("a title on one line")
    return title


def _prose(expected: str) -> Text:
    """Return the kind of value for a text of several lines.

    The phrase ``expected`` describes it in messages.
    """
    return Text(kind="text", reads=lambda field: field.prose(expected, lines=True))


def _added(name: str) -> Key:
    """Return the key with the name ``name``, which an installed package adds."""
    key: Key = part_named(ExtensionPoint.SCENARIO_KEYS, name, Key)
    return key


def _read_added(field: Field) -> tuple[tuple[str, Any], ...]:
    """Return the keys that packages add, each with its value.

    Only the packages whose keys the file contains are loaded.
    """
    names, given = sorted(names_of(ExtensionPoint.SCENARIO_KEYS)), field.entries("a mapping")
    for name, below in given:
        if name not in names:
            expected = f"a key that an installed package adds: {', '.join(names) or 'there is none'}"
            raise below.error(expected, got=f"the key {shown(name)}", hint=near_miss(name, names))
    return tuple((name, _added(name).value.read(below)) for name, below in given)


def _write_added(values: tuple[tuple[str, Any], ...]) -> dict[str, Tree]:
    """Return the keys that packages add with their values, as texts of a file."""
    return {name: _added(name).value.write(value) for name, value in values}


_LINE = Text(kind="text, one line", reads=_title)
TOP = KeyTable(
    name="a scenario",
    keys=(
        Key(
            "scenario",
            _LINE,
            "what is tried, as a title",
            "a hand reaches for the tool and withdraws",
            attribute="title",
        ),
        Key(
            "about",
            _prose("why one would try this"),
            "why one would try it",
            "The reach is fast.",
            "empty",
            attribute="about",
            fallback="",
        ),
        Key(
            "duration",
            LASTING,
            "how long the run lasts; from one to 1,000,000 control periods. It is not rounded: the run ends "
            "with the first control tick at or after it",
            "12 s",
            attribute="duration_s",
            said=f"time, at most {LONGEST_S:g} s",
        ),
        Key(
            "seed",
            QuantityValue(NUMBER, least=0, most=LARGEST_SEED, whole=True),
            "every random number of the run descends from it",
            "7",
            said="whole number from 0 to 2^63 - 1",
            attribute="seed",
            fallback=0,
        ),
        Key(
            "robot",
            ROBOT_VALUE,
            "the arm in the cell ([robots](#robot))",
            "UR5",
            "UR10",
            attribute="robot",
            fallback=Robot.UR10,
        ),
        Key(
            "tcp start",
            Below(tables=(TCP_START,)),
            "where the tool is at the beginning",
            "{offset: [40 mm, -120 mm, 60 mm]}",
            attribute="start",
        ),
        Key(
            "avoider",
            Text(kind="name or file", expected="the name of an avoider"),
            "what proposes repulsive positions: a name, `FILE.py:NAME` or `FILE.safetensors` "
            "([avoiders](how-to/avoider.md))",
            "opposite pose",
            attribute="avoider",
            fallback=DEFAULT_AVOIDER,
        ),
        Key(
            "controller",
            Text(kind="name or file", expected="the name of a controller"),
            "what drives the arm: a name, or a program of yours; only the visual servo has an avoider "
            "([controllers](how-to/controller.md))",
            "stop when near",
            attribute="controller",
            fallback=VISUAL_SERVO,
        ),
        Key(
            "shield",
            SHIELD_VALUE,
            "what slows the arm between any controller and the drives ([shield](explanation/shield.md))",
            "speed and separation",
            "none",
            attribute="shield",
            fallback=None,
        ),
        Key(
            "safety filter",
            Text(kind="file or program", expected="the file and name of a safety filter"),
            "a program of yours that may change each command on its way to the drives, in place of a shield "
            "([safety filters](how-to/filter.md))",
            "mine.py:Filter",
            "none",
            attribute="safety_filter",
            fallback="",
        ),
        Key(
            "predictor",
            Text(kind="name or file", expected="the name of a predictor, or the file and name of one"),
            "what predicts the hands, each with a set that should hold it: kalman filter, or a program of "
            "yours ([predictors](how-to/predictor.md))",
            "mine.py:Predictor",
            "the Kalman filter, without sets",
            attribute="predictor",
            fallback="",
        ),
        Key(
            "gate",
            Below(tables=(GATE,)),
            "what the gate asks for beside its checks ([gate](reference/controller.md#the-gate))",
            "{every hand within: 99 %}",
            "nothing",
            attribute="gate",
            fallback=None,
        ),
        Key(
            "object",
            Below(tables=(GROUPS["object"],)),
            "what is servoed on, and where it lies",
            "{position: [720 mm, 60 mm, -300 mm], yaw: 40 deg}",
            "the default object",
        ),
        Key(
            "obstacles",
            OBSTACLES,
            "boxes that stand in the cell ([obstacles](#obstacles))",
            "[{box: [400 mm, 300 mm, 500 mm], at: [900 mm, 500 mm, 0 mm]}]",
            "none",
            attribute="obstacles",
            fallback=(),
        ),
        Key(
            "hands",
            HANDS,
            "what the hands do",
            "hands:\n  - hand: right\n    starts at: [1.2 m, -0.7 m, 100 mm]\n"
            "    elbow towards: [1.6 m, -1.2 m, 300 mm]\n    moves:\n      - wait: 1 s",
            "none",
        ),
        Key(
            "faults",
            Several(of=Below(tables=fault_tables()), kind=f"list of at most {MOST_FAULTS}", most=MOST_FAULTS),
            "what goes wrong, and when",
            "faults:\n  - hand sensor: freezes\n    from: 500 ms\n    for: 200 ms",
            "none",
        ),
        Key(
            "hand sensor",
            Below(tables=(GROUPS["hand sensor"],)),
            "the camera that watches the hands, and how it errs",
            "{kind: overhead, rate: 30 Hz}",
            "an ideal sensor",
        ),
        Key(
            "camera",
            Below(tables=(GROUPS["camera"],)),
            "the eye-in-hand camera, and how it errs",
            "{source: raster, rate: 30 Hz}",
            "exact images",
        ),
        Key(
            "settings",
            Below(tables=(SETTINGS,)),
            "every other value of the system",
            "{avoidance: {critical distance: 350 mm}}",
            "the defaults",
        ),
        Key(
            "extensions",
            Text(kind="mapping", reads=_read_added, writes=_write_added, or_mapping=True),
            "keys that installed packages add, each read by its package "
            "([how](explanation/architecture.md#how-a-wing-registers-its-parts))",
            "{}",
            "none",
            attribute="extensions",
            fallback=(),
        ),
        Key(
            "claims",
            CLAIMS,
            "sentences of the catalogue and formulas, each with the verdict that you expect",
            "claims:\n  hand distance never below 50 mm: holds",
        ),
    ),
)
_PLAIN_MAPPING = FreeKeys(of=FreeKeys(of=Below(tables=()), least=1), least=1)
COMPOSED = KeyTable(
    name="files made of others",
    where="a scenario that is made of others",
    keys=(
        Key(
            "extends",
            Text(kind="path"),
            f"the file whose values hold where this one says nothing; at most {LONGEST_CHAIN} in a chain",
            "bases/overhead.yaml",
            "none",
        ),
        Key(
            "without",
            Several(of=Text(kind="key or claim"), kind="list of keys and claims", least=1),
            "what of the extended file does not hold: keys at its top, or claims",
            "[hands, hand distance never below 50 mm]",
            "none",
        ),
        Key(
            "matrix",
            _PLAIN_MAPPING,
            "axes, each with labels and what they change: one scenario for each combination, at most "
            f"{MOST_COMBINATIONS:,}",
            "matrix:\n  sensor:\n    ideal: {hand sensor: {kind: ideal}}\n"
            "    late: {hand sensor: {kind: overhead, latency: 50 ms}}",
            "none",
            said="mapping of mappings",
        ),
    ),
)
SUITE = KeyTable(
    name="a suite",
    keys=(
        Key("suite", _LINE, "what these scenarios are for", "before a release", attribute="title"),
        Key(
            "about",
            _prose("why one would run this"),
            "why one would run it",
            "All of it takes a minute.",
            "empty",
            attribute="about",
        ),
        Key(
            "scenarios",
            Several(of=Text(kind="path"), kind="list of paths", least=1),
            "files, folders and other suites, relative to this file",
            "[fast-reach.yaml, recorded]",
        ),
    ),
)


def every_table() -> tuple[KeyTable, ...]:
    """Return every table once, in the order in which a file needs them, from its top downwards."""
    keys = tuple(key for _, key in loaded(ExtensionPoint.SCENARIO_KEYS, Key))
    added = [KeyTable(name="extensions", path="extensions", keys=keys)] if keys else []
    return tuple({id(table): table for table in (TOP, COMPOSED, SUITE, *TOP.below(), *added)}.values())
