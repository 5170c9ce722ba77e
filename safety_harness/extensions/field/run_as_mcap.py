"""A run as an MCAP file of ROS 2 messages, with its LOG.yaml, for Foxglove, RViz and our own log reader.

Hands, arm and obstacles use Foxglove's schemas for drawing. Joints, transforms and positions use standard
messages. A stamp is the time in the run plus one second, because in ROS 2 a stamp of zero means that the
stamp is missing.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jinja2 import StrictUndefined, Template
from numpy.typing import NDArray

from safety_harness.admission.avoiders import as_seen_from
from safety_harness.admission.claims import property_of
from safety_harness.base.elementary import cos, sin
from safety_harness.base.exceptions import OutputError, Place, TraceError
from safety_harness.base.extras import LOGS, PYBULLET
from safety_harness.base.settings import ImageSource
from safety_harness.base.whole_file import replacing, write_text, writing
from safety_harness.cell.perception.detector import opencv
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.properties.base import SI_UNITS, Evaluation
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.limits import TcpSpeedLimit
from safety_harness.claims.signals.true_motion import capsules_of, finer_paths, true_motion
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.write import text_of, tree_of
from safety_harness.trace.records import DecisionOutcome, Limit, Mode, Trigger
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided, measured

LOG_FILE, NS = "LOG.yaml", 10**9
OURS, FOXGLOVE, GEOMETRY = "safety_harness_msgs/msg/", "foxglove_msgs/msg/", "geometry_msgs/msg/"
JOINTS, TF, SCENE = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage", f"{FOXGLOVE}SceneUpdate"
TEMPLATES = Path(__file__).with_name("templates")
INFO, ERROR = 2, 4  # levels of a Log
HAND_COLOUR, ARM_COLOUR, BOX_COLOUR = (0.9, 0.5, 0.2, 0.9), (0.5, 0.6, 0.7, 0.6), (0.5, 0.5, 0.5, 0.5)
NONE, NOWHERE, UPRIGHT = np.zeros(0), (np.nan,) * 3, (0.0, 0.0, 0.0, 1.0)
PLACES = ("hand", "tcp", "proposed", "chosen", "opposite")  # of a decision
PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
REPORTED_COLUMNS = ("mode", "limits", "demanded_joint_velocity_radps", "predicted_hand_in_base_m")
FROM_SCENARIO = ("about", "robot", "obstacles", "camera", "settings", "claims")

Message = tuple[int, str, str, Any]  # when [ns], topic, type, content


def write_mcap(trace: Trace, evaluations: Sequence[Evaluation], path: Path) -> tuple[Path, Path]:
    """Write ``trace`` and the ``evaluations`` of its claims to ``path``, and LOG.yaml beside it.

    Returns:
        The paths of both files.

    Raises:
        TraceError: The trace was not simulated.
        MissingPackageError: The extra "logs" is missing.
        OutputError: A file cannot be written, or LOG.yaml exists and describes another file.

    """
    log = path.with_name(LOG_FILE)
    if not trace.known.simulated:
        got = "the trace of a log, which has its own files"
        raise TraceError(place=Place(field="known"), expected="the trace of a simulated run", got=got)
    if log.exists() and f'"{_quoted(path)}#' not in log.read_text(errors="replace"):
        expected = "no file, or one that an export wrote"
        raise OutputError(place=Place(file=log), expected=expected, got="another")
    with replace(LOGS, instead="").needed("runs as MCAP files", path):  # a run is not written as .csv
        from rosbags.rosbag2 import StoragePlugin, Writer
    messages, topics = _Messages(trace), dict[str, Any]()
    with writing(path), replacing(path) as part, TemporaryDirectory(dir=part.parent) as folder:
        with Writer(Path(folder, "run"), version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            for at_ns, topic, kind, content in sorted(messages.all_of(evaluations), key=lambda m: m[0]):
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, kind, typestore=messages.store)
                bag.write(topics[topic], at_ns, messages.store.serialize_cdr(content, kind))
        Path(folder, "run", "run.mcap").replace(part)
    write_text(log, _log_text(trace, path))
    return path, log


def _stamps(at_s: Any) -> Any:
    """Return the stamps (n,) [ns] for the times ``at_s`` (n,) in the run."""
    return NS + np.round(np.asarray(at_s) * NS).astype(np.int64)


def _hand_samples(trace: Trace, hand: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the stamps (n,) [ns] and the places (n, 2, 3) of a hand and its elbow in the base frame [m].

    There is a sample at each tick, at each change of motion between ticks, and at some fractions of a tick.
    The position between two samples is therefore almost known.
    """
    paths, period_s = finer_paths(trace), trace.scenario.settings.clock.control_period_s
    own = paths.corner_hand == hand
    at = np.concatenate([np.arange(len(trace.ticks)), paths.corner_at[own]])
    # A change of motion at a tick would be a second sample of the same time.
    stamps, first = np.unique(_stamps(at * period_s), return_index=True)
    return stamps, np.concatenate([paths.positions_in_base_m[:, hand], paths.corners_in_base_m[own]])[first]


def _limit_words(flags: int) -> str:
    """Return a text with the limits in ``flags``, such as "tcp speed and braking".

    The text uses the same words as LOG.yaml.
    """
    return " and ".join(_spaced(limit.name) for limit in Limit if limit & flags) or "none"


def _spaced(name: str | None) -> str:
    return str(name).lower().replace("_", " ")


def _most(values: Any) -> float:
    return float(np.abs(values).max(initial=0.0))


def _quoted(path: Path) -> str:
    """Return the file's name, escaped for use between double quotes in JSON and in YAML."""
    return json.dumps(path.name, ensure_ascii=False)[1:-1]


def _log_text(trace: Trace, path: Path) -> str:
    """Return the text of the LOG.yaml that describes the file ``path``.

    The text omits streams that the controller does not report. It also omits the decisions if at least one of
    them takes effect later than at the tick of its query. The format of a log has only one time for the query
    and its effect.
    """
    tree, decisions = tree_of(as_seen_from(path.parent, trace.scenario)), trace.decisions
    streams = [name for name in REPORTED_COLUMNS if measured(trace, name).all()]
    if decided(trace) and len(decisions) and (decisions["asked_tick"] == decisions["tick"]).all():
        streams.append("decisions")
    if isinstance(below := tree.get("settings", {}), Mapping):
        tree["settings"] = {key: entry for key, entry in below.items() if key != "clock"}
    kept = {"title": tree["scenario"]} | {key: tree[key] for key in FROM_SCENARIO if tree.get(key)}
    limits = [_limit_words(int(flags)) for flags in np.unique(trace.ticks["limits"])]
    template = Template((TEMPLATES / "mcap_log.yaml").read_text(), undefined=StrictUndefined)
    bounds = dict(zip(("radps", "radps2", "mps"), _bounds(trace), strict=True))
    text = template.render(trace=trace, file=_quoted(path), told=streams, limits=limits, most=bounds)
    return f"{text}\n{text_of(kept)}"


def _bounds(trace: Trace) -> tuple[float, float, float]:
    """Return bounds of the joint speeds [rad/s], joint accelerations [rad/s2] and hand speeds [m/s].

    A joint's speed may change at any moment of a tick. Its acceleration is therefore at most twice the change
    of speed in a period, divided by the period. Let c be the largest change of a hand's mean speed from one
    interval between samples to the next. Within an interval, the speed may exceed the mean speed by up to c.
    """
    true, period_s = true_motion(trace), trace.scenario.settings.clock.control_period_s
    means, excess = np.diff(true.joints_rad, axis=0) / period_s, 2.0 * _most(trace.overshoot_radps)
    change = max(_most(np.diff(speeds, axis=0)) for speeds in (true.rates_radps, means)) + excess
    fastest, hands_mps = max(_most(means), _most(true.rates_radps)) * (1.0 + 1e-9) + excess, 1e-3
    for hand in range(len(trace.scenario.hands)):
        stamps, places_m = _hand_samples(trace, hand)
        speeds = np.diff(places_m, axis=0) / (np.diff(stamps) / NS)[:, None, None]
        changes = np.linalg.norm(np.diff(speeds, axis=0), axis=2)
        hands_mps = max(hands_mps, (_most(np.linalg.norm(speeds, axis=2)) + _most(changes)) * (1.0 + 1e-9))
    limit = _most(arm_model(trace.scenario.robot).velocity_limit_radps)
    return max(fastest, limit), max(2.0 * change / period_s, 1e-6), hands_mps


class _Messages:
    """A builder of the messages for a trace."""

    def __init__(self, trace: Trace) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.trace, self.store = trace, get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg((TEMPLATES / "mcap_types.txt").read_text(), f"{OURS}State"))
        self.arm = arm_model(trace.scenario.robot)
        upright = np.array_equal(self.arm.transform_seat, np.eye(4))
        self.base = self.arm.link_names[0] if upright else "base"
        self.frames = (*self.arm.link_names, "tcp")  # in the order of forward kinematics
        self.stamps = _stamps(trace.time_s).tolist()

    def all_of(self, evaluations: Sequence[Evaluation]) -> Iterator[Message]:
        """Yield every message, although not in the order of time."""
        yield self._still_scene()
        rows = zip(self.stamps, self.trace.ticks, self._poses(), strict=True)
        for at_ns, tick, poses in rows:
            yield from self._tick(at_ns, tick, poses)
        for hand in range(len(self.trace.scenario.hands)):
            for at_ns, places in zip(*_hand_samples(self.trace, hand), strict=True):
                for body, place in zip(("hand", "elbow"), places, strict=True):
                    yield self._point(int(at_ns), f"/{body}_{hand + 1}", place)
        yield from self._decisions()
        yield from self._images()
        for number, evaluation in enumerate(evaluations):
            yield from self._claim(number, evaluation)

    def _new(self, kind: str, *fields: Any) -> Any:
        return self.store.types[kind](*fields)

    def _of_numbers(self, kind: str, values: Any) -> Any:
        return self._new(f"{GEOMETRY}{kind}", *map(float, values))

    def _time(self, at_ns: int) -> Any:
        return self._new("builtin_interfaces/msg/Time", *divmod(at_ns, NS))

    def _header(self, at_ns: int) -> Any:
        return self._new("std_msgs/msg/Header", self._time(at_ns), self.base)

    def _stamped(self, at_ns: int, topic: str, kind: str, *fields: object) -> Message:
        return at_ns, topic, kind, self._new(kind, self._header(at_ns), *fields)

    def _point(self, at_ns: int, topic: str, place: Any) -> Message:
        return self._stamped(at_ns, topic, f"{GEOMETRY}PointStamped", self._of_numbers("Point", place))

    def _event(self, at_ns: int, level: int, text: str, name: str) -> Message:
        kind = f"{FOXGLOVE}Log"
        return at_ns, "/events", kind, self._new(kind, self._time(at_ns), level, text, name, "", 0)

    def _poses(self) -> NDArray[np.float64]:
        """Return the place [m] and unit quaternion (x, y, z, w) of each frame, shape (n, frames, 7)."""
        from scipy.spatial.transform import Rotation

        joints_rad = np.ascontiguousarray(self.trace.ticks["joint_position_rad"])
        poses = np.array([links_in_base(self.arm, row) for row in joints_rad])  # (n, frames, 4, 4)
        turns = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat()
        return np.concatenate([poses[..., :3, 3], turns.reshape(*poses.shape[:2], 4)], axis=2)

    def _tick(self, at_ns: int, tick: Any, poses: NDArray[np.float64]) -> Iterator[Message]:
        """Yield the messages of a tick.

        They contain the joints, the transforms, the state of the controller, the tracked hands, and drawings
        of the hands.
        """
        names, joints_rad = list(self.arm.joint_names), tick["joint_position_rad"]
        turning, demanded = tick["joint_velocity_radps"], tick["demanded_joint_velocity_radps"]
        yield self._stamped(at_ns, "/joint_states", JOINTS, names, joints_rad, turning, NONE)
        yield self._stamped(at_ns, "/commands", JOINTS, names, NONE, demanded, NONE)
        framed = zip(self.frames, poses, strict=True)
        moved = [self._transform(at_ns, frame, pose) for frame, pose in framed if frame != self.base]
        yield at_ns, "/tf", TF, self._new(TF, moved)
        near_m = np.where(tick["hand_present"], tick["hand_distance_m"], np.inf).min()
        numbers = map(float, (near_m, tick["predicted_distance_m"], tick["tcp_speed_mps"]))
        mode, limits = Mode(tick["mode"]).name.lower(), _limit_words(int(tick["limits"]))
        yield self._stamped(at_ns, "/state", f"{OURS}State", mode, limits, *numbers)
        for track, place in enumerate(tick["predicted_hand_in_base_m"]):
            where = place if tick["track_valid"][track] else NOWHERE
            yield self._point(at_ns, f"/tracked_{track + 1}", where)
        size, drawn = self.trace.scenario.settings.hand, []
        for k, hand in enumerate(self.trace.scenario.hands):
            ends = tick["hand_position_in_base_m"][k], tick["elbow_position_in_base_m"][k]
            radii_m = size.radius_m, size.forearm_radius_m
            drawn.append(self._capsule(at_ns, self.base, hand.name, ends, radii_m, HAND_COLOUR))
        yield at_ns, "/hands", SCENE, self._new(SCENE, [], drawn)

    def _transform(self, at_ns: int, frame: str, pose: NDArray[np.float64]) -> Any:
        turn = self._of_numbers("Quaternion", pose[3:])
        moved = self._new(f"{GEOMETRY}Transform", self._of_numbers("Vector3", pose[:3]), turn)
        return self._new(f"{GEOMETRY}TransformStamped", self._header(at_ns), frame, moved)

    def _still_scene(self) -> Message:
        """Return the message that draws the obstacles and the arm's capsules.

        The frames of the capsules move according to the messages in /tf.
        """
        capsules, at_ns, drawn = capsules_of(self.trace), self.stamps[0], []
        for k, name in enumerate(capsules.names):
            ends, radii_m = (capsules.start_in_link[k], capsules.end_in_link[k]), [capsules.radius_m[k]] * 2
            frame = self.frames[capsules.link_index[k]]
            drawn.append(self._capsule(at_ns, frame, f"arm: {name}", ends, radii_m, ARM_COLOUR))
        for k, box in enumerate(self.trace.scenario.obstacles):
            turn = 0.0, 0.0, sin(box.yaw_rad / 2.0), cos(box.yaw_rad / 2.0)
            cube = self._shape("Cube", box.position_in_base_m, turn, box.size_m, BOX_COLOUR)
            drawn.append(self._entity(at_ns, self.base, f"obstacle {k + 1}", cubes=[cube]))
        return at_ns, "/scene", SCENE, self._new(SCENE, [], drawn)

    def _pose(self, at: Any, turn: Any = UPRIGHT) -> Any:
        turned = self._of_numbers("Quaternion", turn)
        return self._new(f"{GEOMETRY}Pose", self._of_numbers("Point", at), turned)

    def _shape(self, kind: str, at: Any, turn: Any, size_m: Any, colour: Any) -> Any:
        painted = self._of_numbers("Vector3", size_m), self._new(f"{FOXGLOVE}Color", *colour)
        return self._new(f"{FOXGLOVE}{kind}Primitive", self._pose(at, turn), *painted)

    def _capsule(self, at_ns: int, frame: str, name: str, ends: Any, radii_m: Any, colour: Any) -> Any:
        """Return the drawing of a capsule.

        It consists of a sphere at each of the two ``ends``, and a line between them that is as thick as the
        second sphere.
        """
        balls = [self._shape("Sphere", ends[k], UPRIGHT, [2.0 * radii_m[k]] * 3, colour) for k in range(2)]
        points, paint = [self._of_numbers("Point", at) for at in ends], self._new(f"{FOXGLOVE}Color", *colour)
        at, thick_m, none = self._pose((0.0,) * 3), 2.0 * float(radii_m[1]), np.zeros(0, np.uint32)
        line = self._new(f"{FOXGLOVE}LinePrimitive", 0, at, thick_m, False, points, paint, [], none)
        return self._entity(at_ns, frame, name, spheres=balls, lines=[line])

    def _entity(self, at_ns: int, frame: str, name: str, **shapes: Any) -> Any:
        forever = self._new("builtin_interfaces/msg/Duration", 0, 0)
        drawn = [shapes.get(kind, []) for kind in PRIMITIVES]
        return self._new(f"{FOXGLOVE}SceneEntity", self._time(at_ns), frame, name, forever, True, [], *drawn)

    def _decisions(self) -> Iterator[Message]:
        stamps = _stamps(self.trace.decisions["time_s"]).tolist()
        for at_ns, row in zip(stamps, self.trace.decisions, strict=True):
            places = [self._of_numbers("Point", row[f"{name}_position_in_base_m"]) for name in PLACES]
            spread = self._of_numbers("Vector3", row["proposed_spread_m"]), float(row["spread_threshold_m"])
            named = DecisionOutcome(row["outcome"]).name, Trigger(row["trigger"]).name
            texts = [*map(_spaced, named), str(row["fault"])]
            yield self._stamped(at_ns, "/decisions", f"{OURS}Decision", *places, *spread, *texts)
            yield self._event(at_ns, INFO, ", ".join(filter(None, texts)), "decision")

    def _images(self) -> Iterator[Message]:
        """Render the images of the object camera again and yield them, because a trace stores no images."""
        scenario, kind = self.trace.scenario, f"{FOXGLOVE}CompressedImage"
        if scenario.settings.camera.source is not ImageSource.RENDERED:
            return
        cv2 = opencv()
        with PYBULLET.needed("rendered images"):
            from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
        with PyBulletWorld(scenario, self.arm, self.trace.ticks["joint_position_rad"][0]) as world:
            for image in world.images_of(self.trace):
                at_ns, png = int(_stamps(image.time_s)), cv2.imencode(".png", image.pixels[:, :, ::-1])[1]
                yield at_ns, "/camera", kind, self._new(kind, self._time(at_ns), "camera", png.ravel(), "png")

    def _claim(self, number: int, own: Evaluation) -> Iterator[Message]:
        """Yield the messages about a claim.

        They contain the claim's quantity at every tick, an event at the worst moment, and the verdict at the
        end. Only a claim about the hand distance or about the TCP speed has a quantity at every tick.
        """
        prop = property_of(self.trace.scenario.claims[number], self.trace.scenario)
        topic, kind, rows, limit, sign = f"/claim_{number + 1}", f"{OURS}Claim", NONE, np.nan, 1.0
        if isinstance(prop, HandDistance):
            rows, limit = true_motion(self.trace).nearest_m, prop.minimum_m
        elif isinstance(prop, TcpSpeedLimit):
            rows, limit, sign = self.trace.ticks["tcp_speed_mps"], prop.maximum_mps, -1.0
        for at_ns, value in zip(self.stamps, rows.tolist(), strict=False):
            numbers = value, limit, sign * (value - limit)
            yield self._stamped(at_ns, topic, kind, own.sentence, "", SI_UNITS[own.unit], *numbers)
        margin, verdict = np.nan if own.margin is None else float(own.margin), own.verdict.value
        last, end_ns = (own.sentence, verdict, SI_UNITS[own.unit], np.nan, limit, margin), self.stamps[-1]
        yield self._stamped(end_ns, f"{topic}/verdict", kind, *last)
        worst_ns = end_ns if own.worst_time_s is None else int(_stamps(own.worst_time_s))
        level = ERROR if own.verdict is Verdict.VIOLATED else INFO
        yield self._event(worst_ns, level, f"{verdict}: {own.sentence} ({own.reason})", "claim")
