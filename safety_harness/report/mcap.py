"""A run as an MCAP file of ROS 2 messages, for Foxglove, RViz and our own reader of logs.

Hands, arm and obstacles are drawn in Foxglove's schemas; joints, transforms and places are the usual messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.claims import property_of
from safety_harness.extras import LOGS
from safety_harness.properties.base import Evaluation, Property
from safety_harness.properties.hand_distance import HandDistance
from safety_harness.properties.limits import TcpSpeedLimit
from safety_harness.properties.true_motion import HandPaths, capsules_of, finer_paths, true_motion
from safety_harness.robot.kinematics import links_in_base
from safety_harness.robot.robots import arm_model
from safety_harness.scenario.model import Verdict
from safety_harness.trace.records import DecisionOutcome, Limit, Mode, Trigger
from safety_harness.trace.trace import Trace
from safety_harness.whole_file import replacing, writing

BEGIN_NS, NS = 10**9, 10**9  # a stamp of zero is none
BASE = "base"
OURS, FOXGLOVE = "safety_harness_msgs/msg/", "foxglove_msgs/msg/"
TYPES = Path(__file__).with_name("templates") / "mcap_types.txt"
INFO, WARNING, ERROR = 2, 3, 4  # levels of a Log
HAND_COLOUR, ARM_COLOUR, BOX_COLOUR = (0.9, 0.5, 0.2, 0.9), (0.5, 0.6, 0.7, 0.6), (0.5, 0.5, 0.5, 0.5)
NOWHERE = [np.nan] * 3

Told = tuple[int, str, str, Any]  # when [ns], topic, type, message


def write_mcap(trace: Trace, evaluations: Sequence[Evaluation], path: Path) -> None:
    """Write ``trace`` and the ``evaluations`` of its scenario's claims to ``path``.

    MissingPackageError without the extra "logs"; OutputError if the file cannot be written.
    """
    with LOGS.needed("runs as MCAP files", path):
        from rosbags.rosbag2 import StoragePlugin, Writer
    messages = _Messages(trace)
    told = sorted(messages.all_of(evaluations), key=lambda one: one[0])
    with writing(path), replacing(path) as part, TemporaryDirectory(dir=path.parent) as folder:
        with Writer(Path(folder) / "run", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            topics: dict[str, Any] = {}
            for at_ns, topic, kind, message in told:
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, kind, typestore=messages.store)
                bag.write(topics[topic], at_ns, messages.store.serialize_cdr(message, kind))
        (Path(folder) / "run" / "run.mcap").replace(part)


def stamp_ns(time_s: float) -> int:
    """The stamp [ns] of a time in the run."""
    return BEGIN_NS + round(time_s * NS)


def hand_samples(trace: Trace, paths: HandPaths, hand: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(n,) stamps [ns] and (n, 2, 3) places of a hand and its elbow in the base frame [m].

    At the ticks, where it turns between them, and in parts of a tick, so that little is left open between.
    """
    own, period_s = paths.corner_hand == hand, trace.scenario.settings.clock.control_period_s
    ticks = np.arange(len(trace.ticks))
    at = np.concatenate([ticks, paths.corner_at[own]]) * period_s
    places = np.concatenate([paths.positions_in_base_m[:, hand], paths.corners_in_base_m[own]])
    stamps, first = np.unique(BEGIN_NS + np.round(at * NS).astype(np.int64), return_index=True)
    return stamps, places[first]


def joined(flags: int) -> str:
    """The words for limits, as LOG.yaml has them."""
    names = [one.name or "" for one in Limit if one and one & flags]
    return " and ".join(name.lower().replace("_", " ") for name in names) or "none"


class _Messages:
    """Makes the messages of a trace."""

    def __init__(self, trace: Trace) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.trace, self.store = trace, get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(TYPES.read_text(), OURS + "State"))
        self.arm = arm_model(trace.scenario.robot)
        seated = not np.array_equal(self.arm.transform_seat, np.eye(4))
        self.base = BASE if seated else self.arm.link_names[0]
        self.stamps = [stamp_ns(float(at)) for at in trace.time_s]

    def all_of(self, evaluations: Sequence[Evaluation]) -> Iterator[Told]:
        """Every message, topic by topic."""
        yield from self._joints()
        yield from self._transforms()
        yield from self._hands()
        yield from self._scene()
        yield from self._states()
        yield from self._decisions()
        for number, one in enumerate(evaluations):
            yield from self._claim(number, one)

    def _of(self, kind: str, *fields: object) -> Any:
        return self.store.types[kind](*fields)

    def _time(self, at_ns: int) -> Any:
        return self._of("builtin_interfaces/msg/Time", *divmod(at_ns, NS))

    def _header(self, at_ns: int) -> Any:
        return self._of("std_msgs/msg/Header", self._time(at_ns), self.base)

    def _xyz(self, values: Sequence[float] | NDArray[np.float64], kind: str = "Point") -> Any:
        return self._of(f"geometry_msgs/msg/{kind}", *(float(value) for value in values))

    def _joints(self) -> Iterator[Told]:
        kind, names = "sensor_msgs/msg/JointState", list(self.arm.joint_names)
        for at_ns, tick in zip(self.stamps, self.trace.ticks, strict=True):
            for topic, angles, rates in (
                ("/joint_states", tick["joint_position_rad"], tick["joint_velocity_radps"]),
                ("/commands", np.zeros(0), tick["demanded_joint_velocity_radps"]),
            ):
                state = self._of(kind, self._header(at_ns), names, angles, rates, np.zeros(0))
                yield at_ns, topic, kind, state

    def _transforms(self) -> Iterator[Told]:
        from scipy.spatial.transform import Rotation

        kind = "tf2_msgs/msg/TFMessage"
        for at_ns, joints_rad in zip(self.stamps, true_motion(self.trace).joints_rad, strict=True):
            poses = links_in_base(self.arm, np.ascontiguousarray(joints_rad))
            turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
            of_links = [
                self._of(
                    "geometry_msgs/msg/TransformStamped",
                    self._header(at_ns),
                    self.frame(link),
                    self._of(
                        "geometry_msgs/msg/Transform",
                        self._xyz(poses[link, :3, 3], "Vector3"),
                        self._xyz(turns[link], "Quaternion"),
                    ),
                )
                for link in range(len(poses))
                if self.frame(link) != self.base
            ]
            yield at_ns, "/tf", kind, self._of(kind, of_links)

    def frame(self, link: int) -> str:
        """The name of a frame of forward kinematics: a link's, or last the TCP's."""
        names = self.arm.link_names
        return names[link] if link < len(names) else "tcp"

    def _hands(self) -> Iterator[Told]:
        """Where hands and elbows truly are, and where the controller takes them to be."""
        kind, trace = "geometry_msgs/msg/PointStamped", self.trace
        paths = finer_paths(trace)
        for hand in range(len(trace.scenario.hands)):
            for at_ns, places in zip(*hand_samples(trace, paths, hand), strict=True):
                for body, place in zip(("hand", "elbow"), places, strict=True):
                    point = self._of(kind, self._header(int(at_ns)), self._xyz(place))
                    yield int(at_ns), f"/{body}_{hand + 1}", kind, point
        for at_ns, tick in zip(self.stamps, trace.ticks, strict=True):
            tracks = zip(tick["track_valid"], tick["predicted_hand_in_base_m"], strict=True)
            for track, (valid, place) in enumerate(tracks, start=1):
                point = self._of(kind, self._header(at_ns), self._xyz(place if valid else NOWHERE))
                yield at_ns, f"/tracked_{track}", kind, point

    def _scene(self) -> Iterator[Told]:
        """The arm's capsules, which follow /tf, and obstacles once; the hands at every tick."""
        scenario, size = self.trace.scenario, self.trace.scenario.settings.hand
        capsules, kind = capsules_of(self.trace), f"{FOXGLOVE}SceneUpdate"
        still = []
        for name, link, start, end, radius_m in zip(
            capsules.names,
            capsules.link_index.tolist(),
            capsules.start_in_link,
            capsules.end_in_link,
            capsules.radius_m,
            strict=True,
        ):
            shapes = self._capsule(start, end, (radius_m, radius_m), ARM_COLOUR)
            still.append(self._entity(self.stamps[0], self.frame(link), f"arm: {name}", *shapes))
        for number, box in enumerate(scenario.obstacles, start=1):
            turn = 0.0, 0.0, np.sin(box.yaw_rad / 2.0), np.cos(box.yaw_rad / 2.0)
            cube = self._shape("Cube", box.position_in_base_m, turn, box.size_m, BOX_COLOUR)
            still.append(self._entity(self.stamps[0], self.base, f"obstacle {number}", cubes=[cube]))
        yield self.stamps[0], "/scene", kind, self._of(kind, [], still)
        for at_ns, places in zip(self.stamps, true_motion(self.trace).hands_m, strict=True):
            entities = [
                self._entity(
                    at_ns,
                    self.base,
                    hand.name,
                    *self._capsule(*places[index], (size.radius_m, size.forearm_radius_m), HAND_COLOUR),
                )
                for index, hand in enumerate(scenario.hands)
            ]
            yield at_ns, "/hands", kind, self._of(kind, [], entities)

    def _shape(self, kind: str, at: Any, turn: Any, size: Any, colour: Any, *scales: float) -> Any:
        pose = self._of("geometry_msgs/msg/Pose", self._xyz(at), self._xyz(turn, "Quaternion"))
        of_colour = self._of(f"{FOXGLOVE}Color", *colour)
        return self._of(f"{FOXGLOVE}{kind}Primitive", pose, self._xyz(size, "Vector3"), *scales, of_colour)

    def _capsule(self, start: Any, end: Any, radii_m: tuple[float, float], colour: Any) -> tuple[Any, Any]:
        """A sphere of the first radius at the start, one of the second at the end, a cylinder between."""
        along, upright = end - start, (0.0, 0.0, 0.0, 1.0)
        length_m = float(np.linalg.norm(along))
        unit = along / length_m if length_m > 0.0 else np.array([0.0, 0.0, 1.0])
        turn = np.array([-unit[1], unit[0], 0.0, 1.0 + unit[2]])  # from z to the axis
        norm = float(np.linalg.norm(turn))
        turn = turn / norm if norm > 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
        ends = zip((start, end), radii_m, strict=True)
        spheres = [self._shape("Sphere", at, upright, [2.0 * r] * 3, colour) for at, r in ends]
        size = 2.0 * radii_m[1], 2.0 * radii_m[1], length_m
        return spheres, [self._shape("Cylinder", (start + end) / 2.0, turn, size, colour, 1.0, 1.0)]

    def _entity(
        self, at_ns: int, frame: str, name: str, spheres: Any = (), cylinders: Any = (), cubes: Any = ()
    ) -> Any:
        forever = self._of("builtin_interfaces/msg/Duration", 0, 0)
        shapes = [], list(cubes), list(spheres), list(cylinders), [], [], [], []
        kind, when = f"{FOXGLOVE}SceneEntity", self._time(at_ns)
        return self._of(kind, when, frame, name, forever, True, [], *shapes)

    def _states(self) -> Iterator[Told]:
        """What the controller does and how near a hand is, and each change of its mode as an event."""
        kind, before, nearest_m = f"{OURS}State", None, true_motion(self.trace).nearest_m
        for at_ns, tick, near_m in zip(self.stamps, self.trace.ticks, nearest_m.tolist(), strict=True):
            mode = Mode(tick["mode"]).name.lower()
            numbers = near_m, float(tick["predicted_distance_m"]), float(tick["tcp_speed_mps"])
            state = self._of(kind, self._header(at_ns), mode, joined(int(tick["limits"])), *numbers)
            yield at_ns, "/state", kind, state
            if mode != before:
                yield self._event(at_ns, INFO, mode.replace("_", " "), "mode")
            before = mode

    def _event(self, at_ns: int, level: int, words: str, name: str) -> Told:
        kind = f"{FOXGLOVE}Log"
        return at_ns, "/events", kind, self._of(kind, self._time(at_ns), level, words, name, "", 0)

    def _decisions(self) -> Iterator[Told]:
        kind, points = f"{OURS}Decision", ("hand", "tcp", "proposed", "chosen", "opposite")
        for one in self.trace.decisions:
            at_ns, outcome = stamp_ns(float(one["time_s"])), DecisionOutcome(one["outcome"])
            places = [self._xyz(one[f"{name}_position_in_base_m"]) for name in points]
            spread = self._xyz(one["proposed_spread_m"], "Vector3"), float(one["spread_threshold_m"])
            trigger, fault = Trigger(one["trigger"]).name.lower(), str(one["fault"])
            words = (outcome.name.lower(), trigger.replace("_", " "), fault)
            yield at_ns, "/decisions", kind, self._of(kind, self._header(at_ns), *places, *spread, *words)
            level = INFO if outcome is DecisionOutcome.PROPOSED else WARNING
            yield self._event(at_ns, level, ", ".join(filter(None, words)), "decision")

    def _claim(self, number: int, one: Evaluation) -> Iterator[Told]:
        """The value that a claim limits at every tick, its margin at the worst moment, its verdict at the end.

        Only claims on the distance of hands and on the TCP's speed have a value at every tick.
        """
        kind, topic = f"{OURS}Claim", f"/claims/claim_{number + 1}"
        prop = property_of(self.trace.scenario.claims[number], self.trace.scenario)
        final = one.sentence, one.verdict.value, one.unit.symbol, np.nan, np.nan
        for at_ns, value, limit, margin in zip(self.stamps, *self._series(prop), strict=True):
            numbers = float(value), float(limit), float(margin)
            words = one.sentence, "", one.unit.symbol
            yield at_ns, topic, kind, self._of(kind, self._header(at_ns), *words, *numbers)
        worst_ns = self.stamps[-1] if one.worst_time_s is None else stamp_ns(one.worst_time_s)
        margin = np.nan if one.margin is None else one.margin
        for at_ns in sorted({worst_ns, self.stamps[-1]}):
            yield at_ns, f"{topic}/verdict", kind, self._of(kind, self._header(at_ns), *final, float(margin))
        level = ERROR if one.verdict is Verdict.VIOLATED else INFO
        yield self._event(worst_ns, level, f"{one.verdict.value}: {one.sentence} ({one.reason})", "claim")

    def _series(self, prop: Property) -> tuple[NDArray[np.float64], ...]:
        """(n,) value, limit and margin of a property, SI; NaN where it has none from tick to tick."""
        count = len(self.trace.ticks)
        if isinstance(prop, HandDistance):
            value = true_motion(self.trace).nearest_m
            return value, np.full(count, prop.minimum_m), value - prop.minimum_m
        if isinstance(prop, TcpSpeedLimit):
            value = self.trace.ticks["tcp_speed_mps"]
            return value, np.full(count, prop.maximum_mps), prop.maximum_mps - value
        return (np.full(count, np.nan),) * 3
