"""Describe a watched cell: all that a LOG.yaml states, except its streams, which a monitor does not open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.robots import arm_model
from safety_harness.extensions.field.logs.certain import RECORDED, claims_of, log_file, settings_with
from safety_harness.extensions.field.logs.controller_reports import STREAMS
from safety_harness.extensions.field.logs.facts import (
    OF_HANDS,
    facts_of_hands,
    facts_of_joints,
    said_of_joints,
)
from safety_harness.extensions.field.logs.model import HandFacts, JointFacts
from safety_harness.extensions.field.logs.read import (
    KEYS,
    LONGEST_PERIOD_NS,
    NO_FOREARM,
    NOT_MEASURED,
    OF_CLOCK,
    OF_LOG,
    SHORTEST_PERIOD_NS,
    TCP,
    said_in,
)
from safety_harness.extensions.field.logs.streams import LATEST_S, NS
from safety_harness.scenario.codec import Tree, plain_text, scalar_text
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.model import MAX_HANDS, Scenario
from safety_harness.scenario.nodes import Mapping, Node, Scalar, parse_tree
from safety_harness.scenario.nodes import Sequence as Items
from safety_harness.scenario.read import scenario_of
from safety_harness.scenario.robots import is_arm_file, read_robot
from safety_harness.scenario.units import TIME, format_quantity
from safety_harness.scenario.write import node_of, text_of

TAKEN_OF_JOINTS = "joints: {known to: 0.1 deg, accelerate at most: 40 rad/s2, longest gap: 100 ms}\n"
TAKEN_OF_HANDS = """\
clock: {hands are ahead by: 0 ms, known to: 5 ms}
hands: {forearm: measured, longest gap: 200 ms, moves at most: 2 m/s, known to: 20 mm}
"""  # assumed without a LOG.yaml; 2 m/s is the speed of a reaching hand (ISO 13855)
NO_HANDS = HandFacts(known_to_m=0.0, moves_at_most_mps=0.0, longest_gap_s=0.2)


@dataclass(frozen=True)
class WatchedHand:
    """A hand in a stream.

    ``elbow`` is True if the stream contains the position of the elbow. ``forearm`` is True if the hand has a
    forearm.
    """

    name: str
    elbow: bool
    forearm: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class WatchedCell:
    """The description of a cell that a monitor watches, without the cell's measurements.

    ``scenario`` has the arm, the settings and the claims, and ``said`` is the tree of the LOG.yaml. The other
    fields describe the hands and the accuracy of the data, as for a log.
    """

    said: Field
    scenario: Scenario
    joint_facts: JointFacts
    hands: tuple[WatchedHand, ...]
    hand_facts: HandFacts
    hands_ahead_ns: int
    clock_known_to_s: float
    period_ns: int

    @cached_property
    def arm(self) -> ArmModel:
        """Return the arm without its capsules."""
        return arm_model(self.scenario.robot)

    @property
    def period_s(self) -> float:
        """Return the time [s] from one tick to the next."""
        return self.period_ns / NS

    def log_text(self, joints: str, hands: Sequence[str], claims: Sequence[str]) -> str:
        """Return a LOG.yaml with ``claims``, for a log with the sample tables ``joints`` and ``hands``."""
        tree = _tree_of(self.said.node)
        assert isinstance(tree, dict)
        file = log_file(self.said)
        if file is not None and "robot" in tree:
            tree["robot"] = _seen_from_anywhere(tree["robot"], file.parent.absolute())
        names = [scalar_text(hand.name) for hand in self.hands]
        forearms: dict[str, Tree] = {
            name: scalar_text(
                f"{table}#elbow" if hand.elbow else NOT_MEASURED if hand.forearm else NO_FOREARM
            )
            for name, hand, table in zip(names, self.hands, hands, strict=True)
        }
        streams = {name: scalar_text(f"{table}#hand") for name, table in zip(names, hands, strict=True)}
        kept: dict[str, Tree] = {key: tree[key] for key in KEYS if key in tree and key not in (TCP, *STREAMS)}
        of_joints, of_hands = _table(kept, "joints"), _table(kept, "hands")
        for table in (of_joints, of_hands):
            for key in ("names", "unit", "time", "frame", "left out", "speeds"):
                table.pop(key, None)
        log: dict[str, Tree] = {"joints": joints, "period": format_quantity(self.period_s, TIME)}
        kept["log"] = log
        if of_joints:
            kept["joints"] = of_joints
        if self.hands:
            log["hands"] = streams
            kept["hands"] = of_hands | {"forearm": forearms, "frame": "base"}
        kept["claims"] = [scalar_text(claim) for claim in claims]
        return text_of(kept)


def read_cell(path: Path, claims: Sequence[str] = ()) -> WatchedCell:
    """Return the cell that a LOG.yaml describes, without opening its streams.

    ``claims`` replace the claims of the file. A mistake in the file raises InputError with its place.
    """
    return _cell_of(said_in(path), claims)


def cell_taken(robot: str, hands: Sequence[str], period: str, claims: Sequence[str]) -> WatchedCell:
    """Return a cell for which there is no LOG.yaml; its uncertainties are those in ``assumptions_of``."""
    streams = ", ".join(f"{scalar_text(name)}: none" for name in hands)
    streams = f"hands: {{{streams}}}, " if hands else ""
    text = f"log: {{joints: none, {streams}period: {scalar_text(period)}}}\n"
    text += assumptions_of(hands) + f"robot: {scalar_text(robot)}\n"
    return _cell_of(Field(parse_tree(text, None), None, path="", line=1), claims)


def assumptions_of(hands: Sequence[str]) -> str:
    """Return the text of the assumptions about joints and ``hands`` that replace a LOG.yaml."""
    return TAKEN_OF_JOINTS + TAKEN_OF_HANDS * bool(hands)


def _cell_of(document: Field, claims: Sequence[str]) -> WatchedCell:
    given = document.fields(KEYS)
    streams = given.required("log").fields(OF_LOG)
    period = streams.optional("period")
    period_s = DEFAULTS.clock.control_period_s
    if period is not None:
        period_s = period.quantity(TIME, least=SHORTEST_PERIOD_NS / NS, most=LONGEST_PERIOD_NS / NS)
    if claims:
        node = Items(tuple(Scalar(claim, 1) for claim in claims), 1)
        document = Field(_with(document.node, "claims", node), document.file, path="", line=1)
        given = document.fields(KEYS)
    scenario = _scenario(given, period_s, document)
    cell = WatchedCell(
        said=document,
        scenario=scenario,
        joint_facts=facts_of_joints(said_of_joints(given), arm_model(scenario.robot)),
        hands=(),
        hand_facts=NO_HANDS,
        hands_ahead_ns=0,
        clock_known_to_s=0.0,
        period_ns=round(period_s * NS),
    )
    if (named := streams.optional("hands")) is None:
        return cell
    of_hands = given.required("hands").fields(OF_HANDS)
    clock = given.required("clock").fields(OF_CLOCK)
    return replace(
        cell,
        hands=_hands(named, of_hands.required("forearm")),
        hand_facts=facts_of_hands(of_hands),
        hands_ahead_ns=round(clock.required(OF_CLOCK[0]).quantity(TIME, least=-LATEST_S, most=LATEST_S) * NS),
        clock_known_to_s=clock.required(OF_CLOCK[1]).quantity(TIME, least=0.0, most=LATEST_S),
    )


def _hands(field: Field, forearm: Field) -> tuple[WatchedHand, ...]:
    named = isinstance(field.node, Mapping)
    names = [name for name, _ in field.entries("hands by their names")] if named else ["hand"]
    if not 0 < len(names) <= MAX_HANDS:
        raise field.error(f"1 to {MAX_HANDS} hands", got=str(len(names)))
    hands = []
    for name in names:
        own = forearm
        if isinstance(forearm.node, Mapping):
            own = forearm.fields(tuple(names)).required(name)
        text = own.scalar("the elbow's stream, not measured, or none")
        hands.append(WatchedHand(name, text not in (NOT_MEASURED, NO_FOREARM), text != NO_FOREARM))
    return tuple(hands)


def _scenario(given: Fields, period_s: float, document: Field) -> Scenario:
    """Return a scenario with the arm, obstacles, settings and claims of the LOG.yaml in ``given``."""
    robot = given.optional("robot")
    arm = arm_model(read_robot(robot, {})) if robot is not None else None
    start: Tree = ["0 deg"] * (len(arm.joint_names) if arm else 6)
    texts: dict[str, Node] = {
        "scenario": Scalar("a cell that is watched", 1),
        "duration": Scalar("1 s", 1),
        "avoider": Scalar(RECORDED, 1),
        "tcp start": node_of({"joints": start}),
        "settings": settings_with(period_s, given.optional("settings")),
        "claims": claims_of(given.optional("claims")),
    }
    for key in ("robot", "obstacles"):
        if (field := given.optional(key)) is not None:
            texts[key] = field.node
    tree = Mapping(tuple((Scalar(key, 1), node) for key, node in texts.items()), 1)
    return scenario_of(tree, log_file(document), name="monitor", claims_required=False)


def _seen_from_anywhere(robot: Tree, folder: Path) -> Tree:
    """Return the value of the key ``robot`` for use in a LOG.yaml in another folder.

    ``folder`` is added before the relative paths in the value.
    """
    if isinstance(robot, str):
        text = plain_text(robot)
        return (
            robot if text.startswith("shipped:") or not is_arm_file(text) else scalar_text(str(folder / text))
        )
    assert isinstance(robot, dict)
    texts = {key: plain_text(str(robot[key])) for key in ("arm", "urdf", "capsules") if key in robot}
    return robot | {key: scalar_text(str(folder / path)) for key, path in texts.items() if ":" not in path}


def _table(tree: dict[str, Tree], key: str) -> dict[str, Tree]:
    table = tree.get(key, {})
    assert isinstance(table, dict)
    return dict(table)


def _with(tree: Node, key: str, value: Node) -> Node:
    assert isinstance(tree, Mapping)
    kept = tuple(pair for pair in tree.entries if pair[0].text != key)
    return Mapping((*kept, (Scalar(key, 1), value)), tree.line)


def _tree_of(node: Node) -> Tree:
    if isinstance(node, Mapping):
        return {scalar_text(key.text): _tree_of(value) for key, value in node.entries}
    if isinstance(node, Items):
        return [_tree_of(item) for item in node.items]
    return scalar_text(node.text)
