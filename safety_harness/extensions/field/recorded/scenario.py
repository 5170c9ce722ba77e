"""Make scenarios from a log of real events, and spaces around them.

The log provides the start of the arm, the motion of the hands and the claims. A scenario of the cell provides
the rest: the desired TCP, the object, the hand sensor and the controller.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from safety_harness.base.distribution import installed_version
from safety_harness.base.exceptions import LogError, OutputError, Place
from safety_harness.base.settings import Vector3
from safety_harness.base.whole_file import writing
from safety_harness.cell.robot.robots import arm_model
from safety_harness.extensions.field.logs.certain import trace_from_log
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.extensions.field.logs.read import log_of, said_in
from safety_harness.extensions.field.recorded.hands import HandFile, hand_file
from safety_harness.scenario.codec import Tree, scalar_text
from safety_harness.scenario.compose import merged
from safety_harness.scenario.model import JoinedHand, JointStart, Scenario, Verdict
from safety_harness.scenario.nodes import Mapping, Node, Scalar
from safety_harness.scenario.units import LENGTH, SPEED, TIME, format_quantity, nice, parse_quantity
from safety_harness.scenario.write import text_of, tree_of
from safety_harness.trace.trace import Trace

SLIGHTLY_BEYOND_RAD = math.radians(1.0)  # an encoder's zero and noise may show a joint beyond its limit

WIDTH = 108  # 110 columns less the "# " of a comment
AXES = ("x", "y", "z")
PACE, SHIFT = "pace", "shift {}"
_JUDGED_BY = ("hand", "braking")  # settings that affect the verdicts on logs and runs


def read_part(file: Path, begin: str | None = None, end: str | None = None) -> CellLog:
    """Return the log that a LOG.yaml describes, or a part of the log.

    Args:
        file: The LOG.yaml.
        begin: The time at which the part begins, as text such as ``1.5 s``, or None for the file's own
            ``from``.
        end: The time at which the part ends, as text such as ``4 s``, or None for the file's own ``to``.

    """
    description, part = said_in(file), {}
    for key, text in (("from", begin), ("to", end)):
        if text is not None:
            parse_quantity(text, TIME, Place(field=f"--{key}"))
            part[key] = text
    if part:
        description = description._replace(node=merged(description.node, _mapping({"log": _mapping(part)})))
    return log_of(description, name=file.stem)


def _mapping(entries: dict[str, str] | dict[str, Mapping]) -> Mapping:
    def node(value: str | Mapping) -> Node:
        return Scalar(value, 1) if isinstance(value, str) else value

    return Mapping(tuple((Scalar(key, 1), node(value)) for key, value in entries.items()), 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class FromLog:
    """A ``scenario`` that reproduces the events in ``log``, and the ``trace`` of the log.

    In the scenario, the hands repeat the recorded motion. ``cell`` is another scenario, which provides the
    parts that ``log`` lacks. ``hands`` contains the recordings of the hands.
    """

    log: CellLog
    trace: Trace
    cell: Scenario
    scenario: Scenario
    hands: tuple[HandFile, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Around:
    """The variations in a space.

    All hands are shifted by up to ``shift_m`` along each axis. Their recorded speed is multiplied by a factor
    in the interval ``speeds`` (low, high).
    """

    shift_m: float | None = None
    speeds: tuple[float, float] | None = None

    def __bool__(self) -> bool:
        return self.shift_m is not None or self.speeds is not None


def scenario_from(log: CellLog, cell: Scenario, *, elbow_towards_in_base_m: Vector3 | None = None) -> FromLog:
    """Return the scenario of a log in the cell of another scenario.

    Args:
        log: The log.
        cell: The scenario with the parts that the log lacks.
        elbow_towards_in_base_m: The point (3,) at which unmeasured forearms point [m], or None for the point
            of the hand in ``cell``.

    Raises:
        LogError: A gap is longer than the log allows, the direction of a forearm is unknown, or the log and
            ``cell`` differ in arm, obstacles, or the settings of hand or braking.

    """
    data = trace_from_log(log)
    _refuse_another_cell(log, data.trace.scenario, cell)
    length_m = cell.settings.hand.forearm_length_m
    hands = tuple(
        hand_file(
            log,
            body,
            elbow_towards_in_base_m=elbow_towards_in_base_m or _elbow_towards(cell, body.name),
            forearm_length_m=length_m,
        )
        for body in log.hands
    )
    arm, q = arm_model(log.robot), log.joints.values[0, : log.joints.values.shape[1] // 2]
    ends = np.clip(q, arm.position_lower_rad, arm.position_upper_rad)
    start_rad = np.where(np.abs(q - ends) <= SLIGHTLY_BEYOND_RAD, ends, q)  # a note of the log reports this
    own = data.trace.scenario
    claims = own.claims or cell.claims
    scenario = replace(
        cell,
        name=log.name,
        title=f"what happened in {log.name}: {own.title}",
        about=own.about,
        duration_s=(log.ticks - 1) * log.period_s,
        start=JointStart(joint_position_rad=tuple(start_rad.tolist())),
        hands=tuple(file.hand for file in hands),
        claims=tuple(replace(claim, expected=Verdict.HOLDS) for claim in claims),
        places={},
    )
    notes = [note for file in hands for note in file.notes]
    first = np.abs(data.trace.ticks["joint_velocity_radps"][0]).max()
    if np.degrees(first) >= 1.0:
        turned = f"a joint turned at {np.degrees(first):.0f} deg/s when the log begins; a run begins at rest"
        notes.append(f"{turned}: begin where the arm stood, with --from")
    return FromLog(log=log, trace=data.trace, cell=cell, scenario=scenario, hands=hands, notes=tuple(notes))


USUAL = "opposite pose"


def usual_cell(log: CellLog, desired_tcp_in_base_m: Vector3 | None = None) -> Scenario:
    """Return a scenario of the log's arm, obstacles and settings, with defaults for the rest.

    The avoider is ``USUAL``. The object lies at its default place, under the desired TCP.

    Args:
        log: The log.
        desired_tcp_in_base_m: The desired TCP (3,) [m], or None for the TCP at the end of the log.

    """
    trace = trace_from_log(log).trace
    own, end_m = trace.scenario, trace.ticks["transform_tcp_to_base"][-1, :3, 3]
    x, y, z = desired_tcp_in_base_m or tuple(round(float(x_m), 4) for x_m in end_m)
    place, lies = own.settings.cell, own.settings.object
    by_x, by_y = x - place.desired_tcp_position_in_base_m[0], y - place.desired_tcp_position_in_base_m[1]
    object_x, object_y, object_z = lies.position_in_base_m
    lies = replace(lies, position_in_base_m=(round(object_x + by_x, 4), round(object_y + by_y, 4), object_z))
    place = replace(place, desired_tcp_position_in_base_m=(x, y, z))
    settings = replace(own.settings, cell=place, object=lies)
    return replace(own, settings=settings, avoider=USUAL, hands=(), places={})


def _elbow_towards(cell: Scenario, name: str) -> Vector3 | None:
    """Return the point towards which the forearm of a hand points in ``cell``.

    This hand has the given ``name``. If there is no such hand but ``cell`` has a single hand, the function
    uses that hand. The result is None without a suitable hand.
    """
    hands = [hand for hand in cell.hands if hand.name == name] or list(cell.hands)
    if len(hands) != 1 or isinstance(hands[0], JoinedHand):
        return None
    return hands[0].elbow_towards_in_base_m


def _refuse_another_cell(log: CellLog, own: Scenario, cell: Scenario) -> None:
    pairs: list[tuple[str, object, object]] = [
        ("robot", own.robot, cell.robot),
        ("obstacles", own.obstacles, cell.obstacles),
        *((f"settings.{key}", getattr(own.settings, key), getattr(cell.settings, key)) for key in _JUDGED_BY),
    ]
    for field, ours, theirs in pairs:
        if ours != theirs:
            raise LogError(
                place=Place(file=log.file, field=field),
                expected=f"the same {field.rpartition('.')[2]} as in the scenario {cell.name}",
                got=f"{_shortened(ours)}, and {_shortened(theirs)} there",
                hint="say it in LOG.yaml as the scenario does, since both are judged by it",
            )


def _shortened(value: object) -> str:
    text = str(value) if value else "none"
    return text if len(text) <= 120 else f"{text[:120]}..."


def scenario_text(made: FromLog, *, named: str) -> str:
    """Return the text of the scenario file, with comments on the origin of each part.

    ``named`` is the name of the cell's scenario in these comments.
    """
    return _comments([*_origin(made, named)]) + text_of(tree_of(made.scenario))


def space_text(made: FromLog, around: Around, *, named: str) -> str:
    """Return the text of a space around the scenario, in which all hands are shifted and sped up together.

    Raise LogError if the log has no hands.
    """
    if not made.hands:
        raise LogError.of_option(
            "--around, --speed", "a log with hands, which these options vary", "one without"
        )
    slowest, fastest = around.speeds or (1.0, 1.0)
    # The slowest draw needs the most time for the whole recording.
    scenario = replace(made.scenario, duration_s=made.scenario.duration_s / slowest)
    tree = dict(tree_of(scenario))
    del tree["scenario"], tree["seed"]
    title = scalar_text(f"around {scenario.title}")
    choices: dict[str, Tree] = {}
    if around.shift_m is not None:
        reach = format_quantity(around.shift_m, LENGTH)
        choices |= {SHIFT.format(axis): f"from -{reach} to {reach}" for axis in AXES}
    if around.speeds is not None:
        choices[PACE] = f"from {slowest!r} to {fastest!r}"
    hands = tree["hands"]
    assert isinstance(hands, list)
    tree["hands"] = [
        _varied(hand, file.hand.motion.max_speed_mps * fastest, around)
        for hand, file in zip(hands, made.hands, strict=True)
    ]
    varied = []
    if around.shift_m is not None:
        varied.append(f"up to {nice(around.shift_m, LENGTH)} elsewhere along each axis")
    if around.speeds is not None:
        varied.append(f"{slowest:g} to {fastest:g} times as fast")
    sentence = f"Every draw repeats the recording, with all hands {' and '.join(varied)}."
    text = _comments([*_origin(made, named), sentence])
    return text + text_of({"scenario space": title, **tree, "choices": choices})


def _varied(hand: Tree, fastest_mps: float, around: Around) -> dict[str, Tree]:
    assert isinstance(hand, dict)
    entries: dict[str, Tree] = dict(hand)
    if around.shift_m is not None:
        entries["shifted by"] = [f"the {SHIFT.format(axis)}" for axis in AXES]
    if around.speeds is not None:
        entries["speed factor"] = f"the {PACE}"
        entries["speed at most"] = format_quantity(math.ceil(fastest_mps * 10.0 + 0.1) / 10.0, SPEED)
    return entries


def _origin(made: FromLog, named: str) -> list[str]:
    """Return paragraphs that state the origin of each part of the scenario."""
    log, cell, facts = made.log, made.cell, made.log.hand_facts
    stream = log.file.name if log.file else log.name
    lines = [f"Made of {stream} by safety-harness scenario from, version {installed_version()}."]
    begin_s = log.origin_ns / 1e9
    seen = f"the hands as they were measured ({', '.join(hand.name for hand in made.hands)}), " * bool(
        made.hands
    )
    claims = "the claims" if made.trace.scenario.claims else "but no claims: these are the scenario's"
    lines.append(
        f"From the log: {seen}the joints at the start, {begin_s:.3f} s of their clock, the duration, "
        f"{claims}. The arm starts at rest."
    )
    if facts is not None:
        known = nice(facts.known_to_m, LENGTH) if np.isfinite(facts.known_to_m) else "what each sample says"
        lines.append(
            f"The hands are known to {known}, their clock to "
            f"{nice(log.clock_known_to_s, TIME)}; between samples, at most {nice(facts.longest_gap_s, TIME)} "
            "apart, they go straight."
        )
    decider = f"the controller, {cell.controller}" if cell.driven else f"the avoider, {cell.avoider}"
    lines.append(
        f"Not in the log, but from {named}: the desired TCP, the object, the camera, the hand "
        f"sensor, {decider}, faults, seed and all settings."
    )
    unseen = [body.name for body in log.hands if body.elbow is None and body.forearm]
    if unseen:
        lines.append(f"The forearm of {' and '.join(unseen)} was not measured; a point states its direction.")
    expected = [f"{claim.expected.value}: {claim.sentence}" for claim in made.trace.scenario.claims]
    if expected:
        lines.append(
            "This file expects every claim to hold, as a test should. LOG.yaml expects "
            f"{'; '.join(expected)}."
        )
    return [*lines, *made.notes]


def _comments(paragraphs: Sequence[str]) -> str:
    lines = [line for text in paragraphs for line in textwrap.wrap(text, WIDTH)]
    return "".join(f"# {line}\n" for line in lines)


def write_all(files: dict[Path, bytes]) -> None:
    """Write all ``files``.

    If a file already exists with other contents, raise OutputError and write no file.
    """
    for path, data in files.items():
        if path.is_symlink() or (path.exists() and (not path.is_file() or path.read_bytes() != data)):
            raise OutputError.of_file(path, "a file that is not there yet, or the same", "another one")
    for path, data in files.items():
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
