"""Scenario files: ``read_scenario`` turns a safety engineer's text into a Scenario.

docs/reference/scenario.md is the reference of the language. Each function of this module reads one object of
the file. This module makes all checks that need no kinematics, and every error states the file, the line and
the field.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.elementary import length
from safety_harness.base.exceptions import RecordingError, ScenarioError, refuse_other_type
from safety_harness.base.settings import DEFAULTS, Settings, Vector3
from safety_harness.base.shipped.contents import located
from safety_harness.scenario.compose import COMPOSING, SPACE_KEY, SUITE, Library, Variant, only_variant
from safety_harness.scenario.faults import read_faults
from safety_harness.scenario.fields import SENTENCE, Field, Fields, Places, each, is_sentence, walk
from safety_harness.scenario.files import as_path, read_bytes
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.model import (
    BY_AT_MOST,
    JOINED_HAND,
    MAX_HANDS,
    MOVING_HAND,
    NO_AVOIDER,
    NOT_LOADED,
    RECORDED_HAND,
    VISUAL_SERVO,
    Claim,
    HandTrajectory,
    JoinedHand,
    MovingHand,
    RecordedHand,
    Scenario,
    Verdict,
)
from safety_harness.scenario.moves import MOVE, REACHING_MPS, HandMove, Reach, Sweep, Wait, Wander, shifted
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar, parse_tree
from safety_harness.scenario.recording import MAX_BYTES, Recording, load_recording, parse_recording
from safety_harness.scenario.reference_tables import CLAIMS, EXPECTED, TOP
from safety_harness.scenario.robots import AnyRobot, OwnRobot, read_robot
from safety_harness.scenario.settings_keys import SETTINGS_KEYS, TOP_GROUPS, read_group, setting_keys
from safety_harness.scenario.units import DIMENSIONS, parse_quantity, shown

MOST_TICKS = 1_000_000  # some 0.7 GB of trace in memory
SMALLEST_BOX_M = 0.01  # from corner to corner
SHORTEST_SWEEP_M = 0.001
# A message lists the moves after the other required keys.
_MOVING_KEYS = (*MOVING_HAND.names[:3], "moves", *MOVING_HAND.names[3:-1])
_COMPOSED = dict.fromkeys(
    COMPOSING, "only a file can have it, and a text is none: read_all_scenarios reads files"
) | {SUITE: "a suite is many scenarios: read_all_scenarios reads them"}

# Distributions, which a scenario must not have: they belong to scenario spaces.
_HINT = f'a file that begins with "{SPACE_KEY}:" may have distributions in place of values'
_SENTENCES = re.compile(r"from [+-]?[0-9.].* to .+|normal .+(\+-|\+/-|±).+|one of .+,.+")
_KEYS = ({"one of"}, {"one of", "chances"}, {"box"}, {"shell", "from", "to"}, {"in"}, {"repeat", "moves"})
_PROSE = ("scenario", "about", "claims")


def read_scenario(path: str | Path | Scenario) -> Scenario:
    """Read the scenario in a file, together with the files that it extends.

    Args:
        path: The file, or ``shipped:NAME``.  A Scenario is returned unchanged.  To read a text, use
            ``parse_scenario``.

    Raises:
        ScenarioError: The file is malformed, or it is a matrix or a suite (``read_all_scenarios`` reads
            these).
        RecordingError: The file refers to a recording that cannot be used.
        InputError: ``path`` is neither a path nor a Scenario.

    """
    if isinstance(path, Scenario):
        return path
    path = as_path(path, "read_scenario(path)", of_text="parse_scenario")
    refuse_other_kind(path, FileKind.SCENARIO, FileKind.SUITE)
    return scenario_of_variant(only_variant(path, Library(), "one scenario"), path)


def scenario_of_variant(variant: Variant, file: Path) -> Scenario:
    """Return the scenario that the tree in ``variant`` describes.

    The tree comes from ``file``. Raise ScenarioError if the tree contains a distribution.
    """
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
    """Return the scenario that ``text`` describes.

    The text must not extend another file.

    Args:
        text: The text.
        file: A path whose folder contains the recordings. None means the working directory.
        recordings: The contents of recordings and of an arm's files, with their SHA-256 as keys. Where the
            text states a ``sha256`` beside a file, the content replaces the file.
        name: The name of the scenario. None means the name of ``file`` or, without a file, "unnamed".
        claims_required: Whether to refuse a scenario without claims, which has no verdict.

    Raises:
        ScenarioError: The text is malformed, or a value is impossible.
        RecordingError: A recording cannot be used.

    """
    hint = "read_scenario(path) reads a file"
    refuse_other_type("parse_scenario(text)", text, str, expected="a text", hint=hint)
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
    """Return the scenario that a tree describes.

    The arguments and errors are as in ``parse_scenario``.
    """
    root = Field(tree, file, path="", line=1)
    given = root.fields(TOP.names, hints=_COMPOSED)
    values = TOP.values(given)
    values["robot"] = read_robot(values["robot"], recordings or {})
    _choose_controller(given, values)
    settings = _settings(given, values["robot"])
    _check_duration(values["duration_s"], given.required("duration"), settings)
    return Scenario(
        name=name,
        hands=_hands(given.optional("hands"), settings=settings, carried=recordings or {}),
        claims=_claims(given.required("claims"), required=claims_required),
        settings=settings,
        faults=read_faults(given.optional("faults"), duration_s=values["duration_s"]),
        file=file,
        places=Places(root),
        **values,
    )


def _choose_controller(given: Fields, values: dict[str, Any]) -> None:
    """Set NO_AVOIDER for a controller that queries no avoider.

    Raise ScenarioError if the file also states an avoider.
    """
    if values["controller"] == VISUAL_SERVO:
        return
    if "avoider" in given:
        expected = "no avoider beside another controller than the visual servo, which alone asks one"
        got = f"one, and the controller {shown(values['controller'])}"
        raise given.required("avoider").error(expected, got=got)
    values["avoider"] = NO_AVOIDER


def refuse_distributions(root: Field) -> None:
    """Raise ScenarioError, with a hint, if a tree is a scenario space or contains a distribution."""
    if not isinstance(root.node, MappingNode):
        return
    for key, field in root.entries("a scenario"):
        if key == SPACE_KEY:
            expected = "one scenario"
            hint = "safety-harness fuzz searches it, and sample draws scenarios from it"
            raise field.error(expected, got="a scenario space", hint=hint)
        if key not in _PROSE:
            for child in walk(field):
                _refuse_distribution(child)


def _refuse_distribution(field: Field) -> None:
    """Raise ScenarioError if a field is a distribution."""
    if isinstance(field.node, Scalar) and _SENTENCES.fullmatch(field.node.text.strip()):
        raise field.error("one value", hint=_HINT)
    if isinstance(field.node, MappingNode):
        keys = [key.text for key, _ in field.node.entries]
        if set(keys) in _KEYS:
            raise field.error("one value", got=f"a mapping with the key {keys[0]}", hint=_HINT)


def _check_duration(duration_s: float, field: Field, settings: Settings) -> None:
    """Raise ScenarioError for a duration below one control period or above MOST_TICKS control periods."""
    if duration_s < settings.clock.control_period_s:
        raise field.error(f"at least one control period, {settings.clock.control_period_s:g} s")
    if duration_s > MOST_TICKS * settings.clock.control_period_s:
        raise field.error(f"at most {MOST_TICKS:,} control periods")


def _settings(given: Fields, robot: AnyRobot) -> Settings:
    """Return the default settings with the file's changes.

    The braking data of a user's own arm are part of the arm, not of the settings.
    """

    def read(named_group: tuple[str, Field]) -> tuple[str, Any]:
        name, group = named_group
        if name == "braking" and isinstance(robot, OwnRobot):
            raise group.error("the braking of an own arm below the key robot", got="it in the settings")
        return name, read_group(group, name)

    named_groups = [(name, given.required(key)) for key, name in TOP_GROUPS.items() if key in given]
    if "settings" in given:
        groups = given.required("settings").fields(tuple(SETTINGS_KEYS), hints=_misplaced())
        named_groups += [(SETTINGS_KEYS[key], group) for key, group in groups.by_key.items()]
    changes = dict(each(read, named_groups))
    if isinstance(robot, OwnRobot):
        changes["braking"] = robot.braking.settings
    return replace(DEFAULTS, **changes)


def _misplaced() -> dict[str, str]:
    """Return advice for misplaced keys in ``settings``.

    Such a key belongs one level lower, in a group, or at the top of the file.
    """
    hints = {key: f'"{key}:" stands at the top of the file' for key in TOP_GROUPS}
    for group, name in SETTINGS_KEYS.items():
        for key in setting_keys(type(getattr(DEFAULTS, name))):
            hint = f"{group}: {{{key.path[0]}: ...}}"
            earlier = hints.get(key.path[0])
            hints[key.path[0]] = f"{earlier}, or {hint}" if earlier else f"write {hint}"
    return hints


def _hands(
    field: Field | None, *, settings: Settings, carried: Mapping[str, bytes]
) -> tuple[HandTrajectory, ...]:
    """Return the hands of the scenario.

    There may be at most MAX_HANDS hands, and their names must differ. ``carried`` contains the contents of
    recordings, with their SHA-256 as keys. These contents replace the files.
    """
    if field is None:
        return ()
    hands: list[HandTrajectory] = []

    def read(item: Field) -> None:
        given = dict(item.entries("a hand: a mapping with the key hand or recording"))
        if "recording" in given:
            hand: HandTrajectory = _recorded_hand(item.fields(RECORDED_HAND.names), settings, carried)
        elif "together with" in given:
            hand = _joined_hand(item.fields(JOINED_HAND.names), hands)
        else:
            hand = _moving_hand(item.fields(_MOVING_KEYS))
        if any(hand.name == earlier.name for earlier in hands):
            raise item.error("another name for each hand", got=f'"{hand.name}" twice', hint="the key hand")
        hands.append(hand)

    each(read, field.items(f"a list of at most {MAX_HANDS} hands", most=MAX_HANDS))
    return tuple(hands)


def _moving_hand(given: Fields) -> MovingHand:
    """Return a hand that makes moves.

    Raise ScenarioError if the values of the hand contradict each other.
    """
    hand: MovingHand = MOVING_HAND.made_of(given)
    if hand.elbow_towards_in_base_m == shifted(hand.starts_at_in_base_m, hand.shift_in_base_m):
        raise given.required("elbow towards").error("a point other than where the hand starts")
    if hand.tremor is not None and hand.tremor.max_speed_mps >= hand.max_speed_mps:
        expected = f"a tremor slower than the hand's bound of {hand.max_speed_mps:g} m/s"
        hint = '2 pi times amplitude times rate; the bound is the hand\'s key "speed at most"'
        got = f"one of up to {hand.tremor.max_speed_mps:.3g} m/s"
        raise given.required("tremor").error(expected, got=got, hint=hint)
    pairs = zip(hand.moves, given.required("moves").items("a list of moves"), strict=True)
    each(lambda pair: _check_move(pair[0], dict(pair[1].entries("a move")), hand), pairs)
    return hand


def _check_move(move: HandMove, given: Mapping[str, Field], hand: MovingHand) -> None:
    """Raise ScenarioError for a move that is too fast for its hand, or whose values contradict each other."""
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
        expected = f"a distance of more than {move.until_distance_m * 1e3:g} mm, where the reach ends"
        raise given["hesitating at"].error(expected)


def _apart_m(first: Vector3, second: Vector3) -> float:
    """Return the distance [m] between two points."""
    return length(np.subtract(first, second))


def _joined_hand(given: Fields, earlier: list[HandTrajectory]) -> JoinedHand:
    """Return a hand that moves together with an earlier hand, which must be in ``earlier``."""
    hand: JoinedHand = JOINED_HAND.made_of(given)
    names = [candidate.name for candidate in earlier if not isinstance(candidate, JoinedHand)]
    if hand.joined_to not in names:
        known = ", ".join(f'"{name}"' for name in names) or "(there is none)"
        expected = f"the name of a hand that is written before: {known}"
        raise given.required("together with").error(expected)
    return hand


def _recorded_hand(given: Fields, settings: Settings, carried: Mapping[str, bytes]) -> RecordedHand:
    """Return a hand that repeats a recording, together with its motion.

    Raise RecordingError if the recording cannot be used.
    """
    values = RECORDED_HAND.values(given)
    recording = _recording(given, values["recording"], values.pop("motion", ""), carried)
    values.setdefault("name", values["track"].replace("_", " "))
    values["elbow_track"] = _elbow_track(given, values, recording)
    # The motion depends on the hand's other values, so it is loaded last.
    hand = RecordedHand(motion=NOT_LOADED, **values)
    places = {key: given.required(key).place for key in given}
    motion = load_recording(recording, hand, forearm_length_m=settings.hand.forearm_length_m, places=places)
    hand = replace(hand, motion=motion)
    _refuse_too_fast(given, hand)
    return hand


def _refuse_too_fast(given: Fields, hand: RecordedHand) -> None:
    """Raise ScenarioError if a recorded hand moves faster than its bound.

    If the file states no bound and the recording is not sped up, the function accepts any speed.
    """
    if hand.max_speed_mps is None and hand.speed_factor <= 1.0:
        return
    bound_mps = REACHING_MPS if hand.max_speed_mps is None else hand.max_speed_mps
    fastest_mps = hand.motion.max_speed_mps
    if fastest_mps > bound_mps:
        field = given.required("speed factor" if hand.speed_factor > 1.0 else "speed at most")
        expected = f"a hand that is never faster than {bound_mps:g} m/s"
        hint = f"speed at most: {math.ceil(fastest_mps * 10.0) / 10.0:g} m/s, if it is meant"
        raise field.error(expected, got=f"one of {fastest_mps:.3f} m/s", hint=hint)


def _recording(given: Fields, path: Path, digest: str, carried: Mapping[str, bytes]) -> Recording:
    """Return the recording with the stated SHA-256 from ``carried``, or otherwise from the file."""
    field = given.required("recording")
    file = located((field.file.parent if field.file else Path()) / path, field.place)
    if digest in carried:
        data = carried[digest]
    else:
        data = read_bytes(file, most=MAX_BYTES, place=field.place, error=RecordingError)
    actual = hashlib.sha256(data).hexdigest()
    if digest and actual != digest:
        place, got = given.required("sha256").place, f"one with {actual}"
        raise RecordingError(place=place, expected="a recording with this SHA-256", got=got)
    return parse_recording(data, file)


def _elbow_track(given: Fields, values: Mapping[str, Any], recording: Recording) -> str | None:
    """Return the track of the elbow, or None if the forearm points to a fixed point.

    The default is the track of the elbow on the same side as the hand.
    """
    if "elbow track" in given and "elbow towards" in given:
        expected = "either an elbow track or a point that the elbow is towards"
        raise given.required("elbow towards").error(expected, got="both")
    track: str | None = values.get("elbow_track")
    if track or "elbow towards" in given:
        return track
    same_side = recording.elbow_of(values["track"])
    if same_side is None:
        hint = f"its tracks: {', '.join(map(shown, recording.tracks))}"
        got = "neither, and the recording has no elbow of the same side"
        raise given.whole.error('the key "elbow track" or "elbow towards"', got=got, hint=hint)
    return same_side


def _claims(field: Field, *, required: bool) -> tuple[Claim, ...]:
    """Return the claims as sentences with expected verdicts.

    Admission looks up the sentences later.
    """
    entries = CLAIMS.read(field) if required else field.entries(CLAIMS.expected)
    return tuple(each(lambda entry: _claim(*entry), entries))


def _claim(sentence: str, verdict: Field) -> Claim:
    """Return a claim with its expected verdict.

    If the verdict is a violation, the claim may have a bound.
    """
    if not is_sentence(sentence):
        raise verdict.error(SENTENCE, got=shown(sentence))
    text, bounded, largest = verdict.scalar(EXPECTED).partition(BY_AT_MOST)
    if not bounded or text != Verdict.VIOLATED.value:
        return Claim(sentence=sentence, expected=verdict.choice(Verdict), place=verdict.place)
    for dimension in DIMENSIONS:
        with suppress(ScenarioError):
            most = parse_quantity(largest, dimension, verdict.place), dimension.si
            if most[0] >= 0.0:
                return Claim(sentence=sentence, expected=Verdict.VIOLATED, most=most, place=verdict.place)
    raise verdict.error("violated by at most a quantity of at least zero, such as 130 mm")
