"""Scenario files: ``read_scenario`` turns the text that a safety engineer wrote into a Scenario.

docs/scenario-language.md is the reference of the language.  One function reads one object; all
checks that need no kinematics are made here, every error has file, line and field.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from safety_harness.exceptions import Place, ScenarioError
from safety_harness.scenario.compose import COMPOSING, MATRIX, SUITE, Library, Variant, variants
from safety_harness.scenario.fault_phrases import read_faults
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, SENTENCE, Field, Fields, is_sentence
from safety_harness.scenario.model import (
    Claim,
    JointStart,
    OffsetStart,
    PoseStart,
    Robot,
    Scenario,
    TcpStart,
    Verdict,
)
from safety_harness.scenario.nodes import Node, parse_tree
from safety_harness.scenario.only_in_spaces import refuse_distributions
from safety_harness.scenario.places import Places
from safety_harness.scenario.read_hands import read_hands
from safety_harness.scenario.read_moves import LONGEST_S, read_position
from safety_harness.scenario.settings_keys import read_group, setting_keys
from safety_harness.scenario.units import ANGLE, TIME, shown
from safety_harness.settings import DEFAULTS, Settings

MOST_TICKS = 1_000_000
LARGEST_SEED = 2**63 - 1
DEFAULT_AVOIDER = "mc-dropout"

KEYS = (
    "scenario",
    "about",
    "duration",
    "seed",
    "robot",
    "tcp start",
    "avoider",
    "object",
    "hands",
    "faults",
    "hand sensor",
    "camera",
    "settings",
    "claims",
)
_COMPOSED = dict.fromkeys(
    COMPOSING, "only a file can have it, and a text is none: read_all_scenarios reads files"
) | {SUITE: "a suite is many scenarios: read_all_scenarios reads them"}
READ_ALONE = frozenset({"tcp start", "hands"})  # no other key is read by what these say
START_KEYS = ("offset", "position", "joints", "tilt")
# The three groups of settings that have a key of their own at the top.
TOP_GROUPS = {"object": "object", "hand sensor": "hand_sensor", "camera": "camera"}
SETTINGS_KEYS = {
    field.name.replace("_", " "): field.name
    for field in fields(Settings)
    if field.name not in TOP_GROUPS.values()
}


def read_scenario(path: Path) -> Scenario:
    """The scenario in a file, with what it extends.

    ScenarioError or RecordingError when it cannot be used as it stands, and for a matrix or a suite,
    which ``read_all_scenarios`` reads.
    """
    found = variants(path, Library())
    if len(found) > 1:
        raise ScenarioError(
            place=Place(file=path, field=MATRIX), expected="one scenario", got=f"a matrix of {len(found)}"
        )
    return scenario_of_variant(found[0], path)


def scenario_of_variant(variant: Variant, file: Path) -> Scenario:
    """The scenario of one tree that ``file`` stands for."""
    refuse_distributions(Field(variant.tree, file, path="", line=1))
    return scenario_of(variant.tree, file, name=variant.name)


def parse_scenario(
    text: str,
    file: Path | None = None,
    recordings: Mapping[str, bytes] | None = None,
    *,
    name: str | None = None,
    claims_required: bool = True,
) -> Scenario:
    """The scenario that ``text`` describes, which has to be complete in itself.

    ``file`` names it, unless ``name`` does, and is where recordings are sought from.

    ``recordings`` are bytes of recordings by their SHA-256, for a text that says ``sha256`` beside
    ``recording``: they are used in place of files.  A scenario without claims says nothing and is
    refused unless ``claims_required`` is False.  ScenarioError or RecordingError otherwise.
    """
    tree = parse_tree(text, file)
    refuse_distributions(Field(tree, file, path="", line=1))
    name = name or (file.stem if file else "unnamed")
    return scenario_of(tree, file, recordings, name=name, claims_required=claims_required)


def scenario_of(
    tree: Node,
    file: Path | None,
    recordings: Mapping[str, bytes] | None = None,
    *,
    name: str,
    claims_required: bool = True,
) -> Scenario:
    """As ``parse_scenario``, for a text that is a tree already."""
    root = Field(tree, file, path="", line=1)
    given = root.fields(KEYS, hints=_COMPOSED)
    settings = _settings(given)
    duration_s = _duration(given.required("duration"), settings)
    return Scenario(
        name=name,
        title=_title(given.required("scenario")),
        about=_about(given.optional("about")),
        duration_s=duration_s,
        seed=_seed(given.optional("seed")),
        start=_tcp_start(given.required("tcp start")),
        hands=read_hands(given.optional("hands"), settings=settings, carried=recordings or {}),
        avoider=_avoider(given.optional("avoider")),
        claims=_claims(given.required("claims"), required=claims_required),
        settings=settings,
        robot=_robot(given.optional("robot")),
        faults=read_faults(given.optional("faults"), duration_s=duration_s),
        file=file,
        places=Places(root),
    )


def scenario_again(
    known: Scenario,
    changed: Set[str],
    tree: Node,
    recordings: Mapping[str, bytes] | None = None,
    *,
    name: str,
) -> Scenario:
    """As ``scenario_of``, for a tree that says the same as that of ``known`` but under the keys ``changed``.

    What nothing else depends on is read alone; else all of it is.
    """
    if not changed <= READ_ALONE:
        return scenario_of(tree, known.file, recordings, name=name)
    root = Field(tree, known.file, path="", line=1)
    given = root.fields(KEYS, hints=_COMPOSED)
    start, hands = known.start, known.hands
    if "tcp start" in changed:
        start = _tcp_start(given.required("tcp start"))
    if "hands" in changed:
        hands = read_hands(given.optional("hands"), settings=known.settings, carried=recordings or {})
    return replace(known, name=name, start=start, hands=hands, places=Places(root))


def _title(field: Field) -> str:
    title = field.prose("a title on one line")
    if not title.strip():
        raise field.error("a title on one line")
    return title


def _about(field: Field | None) -> str:
    return field.prose("why one would try this", lines=True) if field else ""


def _duration(field: Field, settings: Settings) -> float:
    duration_s = field.quantity(TIME, above=0.0, most=LONGEST_S)
    if duration_s < settings.clock.control_period_s:
        raise field.error(f"at least one control period, {settings.clock.control_period_s:g} s")
    if duration_s > MOST_TICKS * settings.clock.control_period_s:
        raise field.error(f"at most {MOST_TICKS:,} control periods")
    return duration_s


def _seed(field: Field | None) -> int:
    return field.integer(least=0, most=LARGEST_SEED) if field else 0


def _robot(field: Field | None) -> Robot:
    return field.choice(Robot) if field else Robot.UR10


def _tcp_start(field: Field) -> TcpStart:
    given = field.fields(START_KEYS)
    ways = [key for key in START_KEYS if key in given and key != "tilt"]
    if len(ways) > 1 or ("joints" in given and "tilt" in given):
        wrong = given.required(ways[1] if len(ways) > 1 else "tilt")
        raise wrong.error("one of offset, position (each with a tilt, if you want) and joints", got="both")
    if "joints" in given:
        return _joint_start(given.required("joints"))
    tilt = given.optional("tilt")
    tilt_in_tcp_rad = tilt.vector(ANGLE, largest=LARGEST_ANGLE_RAD) if tilt else (0.0, 0.0, 0.0)
    if "position" in given:
        position_in_base_m = read_position(given.required("position"))
        return PoseStart(position_in_base_m=position_in_base_m, tilt_in_tcp_rad=tilt_in_tcp_rad)
    offset_in_base_m = read_position(given.required("offset"))
    return OffsetStart(offset_in_base_m=offset_in_base_m, tilt_in_tcp_rad=tilt_in_tcp_rad)


def _joint_start(field: Field) -> JointStart:
    a, b, c, d, e, f = (
        item.quantity(ANGLE, least=-LARGEST_ANGLE_RAD, most=LARGEST_ANGLE_RAD)
        for item in field.items("a list of six joint angles such as -90 deg", count=6)
    )
    return JointStart(joint_position_rad=(a, b, c, d, e, f))


def _avoider(field: Field | None) -> str:
    return field.sentence("the name of an avoider") if field else DEFAULT_AVOIDER


def _settings(given: Fields) -> Settings:
    """The defaults with the values that the file changes."""
    changes: dict[str, Any] = {}
    for key, name in TOP_GROUPS.items():
        group = given.optional(key)
        if group is not None:
            changes[name] = read_group(group, getattr(DEFAULTS, name))
    whole = given.optional("settings")
    if whole is not None:
        groups = whole.fields(tuple(SETTINGS_KEYS), hints=_misplaced())
        for key in groups:
            name = SETTINGS_KEYS[key]
            changes[name] = read_group(groups.required(key), getattr(DEFAULTS, name))
    return replace(DEFAULTS, **changes)


def _misplaced() -> dict[str, str]:
    """What to write instead of a key that stands one level too high, or too low, in ``settings``."""
    hints = {key: f'"{key}:" stands at the top of the file' for key in TOP_GROUPS}
    for group, name in SETTINGS_KEYS.items():
        for key in setting_keys(type(getattr(DEFAULTS, name))):
            hint = f"{group}: {{{key.words[0]}: ...}}"
            before = hints.get(key.words[0])
            hints[key.words[0]] = f"{before}, or {hint}" if before else f"write {hint}"
    return hints


def _claims(field: Field, *, required: bool) -> tuple[Claim, ...]:
    """Claims are looked up later; here they only have to be sentences with a verdict."""
    expected = "a mapping of claims, such as hand distance never below 50 mm: holds"
    entries = field.entries(expected)
    if required and not entries:
        raise field.error(expected)
    return tuple(_claim(sentence, verdict) for sentence, verdict in entries)


def _claim(sentence: str, verdict: Field) -> Claim:
    if not is_sentence(sentence):
        raise verdict.error(SENTENCE, got=shown(sentence))
    return Claim(sentence=sentence, expected=verdict.choice(Verdict), place=verdict.place)
