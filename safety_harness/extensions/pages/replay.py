"""Prepare a run's 3-D replay as JSON.

The replay has the frames, capsules and meshes of the arm, and some columns of the trace. The viewer computes
the arm's motion from the joint angles, so that arm, hands and distances agree with the trace. For a long run,
the data contain evenly spaced ticks, every worst moment and every decision. Between these ticks, the viewer
interpolates linearly.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import HandSensorKind, Settings
from safety_harness.cell.controller.records import overhead_transform_sensor_to_base
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cell.simulation.cameras import object_polygon_in_base
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.properties.protective_separation import times_left_s
from safety_harness.claims.signals.separation import REACHING_MPS, lengths
from safety_harness.extensions.pages.arm_meshes import arm_meshes
from safety_harness.extensions.pages.packing import as_attribute, packed
from safety_harness.extensions.pages.path_views import shown_moment
from safety_harness.extensions.pages.prediction_spread import prediction_spread_m
from safety_harness.extensions.pages.svg import plain
from safety_harness.extensions.pages.timeline import LEFT_PX, MODE_INK, PANEL_PX, WIDTH_PX
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import (
    MODE_WORDS,
    OUTCOME_WORDS,
    TRIGGER_WORDS,
    claimed_hand_distance_m,
    failed_words,
)
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.trace.records import Check, DecisionOutcome, Trigger
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured, decided, measured

MOST_REPLAYS = 20  # the most replays on a page
MOST_TICKS = 750  # nobody sees more; a run of ten seconds has 1250
ANY = 1_000_000  # stands for no capsule, if the capsule nearest to a hand is unknown


class Replays:
    """The replays of one page, at most ``most``.

    Only the first replay of an arm contains the arm's meshes.
    """

    def __init__(self, most: int = MOST_REPLAYS) -> None:
        self._left = most
        self._meshes: dict[ArmModel, str] = {}  # for each arm, the replay that contains its meshes
        self._explained = ""  # the replay that explains what is drawn

    def arguments(self, run: JudgedRun, name: str, **more: object) -> dict[str, object] | None:
        """Return the arguments that the template macro ``replay`` needs to show ``run``.

        The result is None if the run has no ticks, or if the page already has ``most`` replays.

        Args:
            run: The run to replay.
            name: The id of the replay on the page.  The ids of its timeline begin with ``name-time-``.
            more: Additional arguments for the macro.

        """
        if self._left == 0 or len(run.trace.ticks) == 0:
            return None
        self._left -= 1
        self._explained = self._explained or f"{name}-replay"
        moment, arm = shown_moment(run), arm_model(run.trace.scenario.robot)
        time_s = run.trace.time_s
        data = replay_data(run) | {"charts": f"{name}-time-"}
        if self._meshes.setdefault(arm, name) == name:
            data["meshes"] = arm_meshes(arm)
        else:
            data["meshes_of"] = f"{self._meshes[arm]}-replay"
        return {
            "id": f"{name}-replay",
            "explained": self._explained,
            "data": as_attribute(data),
            "first_s": float(time_s[0]),
            "last_s": float(time_s[-1]),
            "from_s": start_s(run),
            "step_s": run.trace.scenario.settings.clock.control_period_s,
            "moment_s": "" if moment is None else f"{moment.time_s:.3f}",
            "moment_name": "Nearest hand" if moment is None or moment.claim is None else "Worst moment",
            **more,
        }


def replay_data(run: JudgedRun) -> dict[str, Any]:
    """Return the replay of ``run`` without the arm's meshes.

    The run must have at least one tick.
    """
    trace = as_measured(run.trace)
    settings = trace.scenario.settings
    arm = arm_model(trace.scenario.robot)
    kept = kept_ticks(run)
    ticks = trace.ticks[kept]
    hands = len(trace.scenario.hands)
    present = measured(trace, "hand_present")[kept]
    there = present & np.isfinite(ticks["hand_position_in_base_m"]).all(axis=2)
    modes = {} if measured(trace, "mode").all() else {"-1": "mode not measured"}
    nearest = np.where(measured(trace, "hand_distance_capsule")[kept], ticks["hand_distance_capsule"], ANY)
    predicted = np.where(ticks["track_valid"][:, :, None], ticks["predicted_hand_in_base_m"], np.nan)
    used = int(np.max(np.flatnonzero(ticks["track_valid"].any(axis=0)) + 1, initial=0))
    return {
        **arm_in_scene(arm, cell_capsules(arm_capsules(trace.scenario.robot), settings)),
        "name": plain(trace.scenario.name, longest=60),
        "hands": [plain(hand.name, longest=40) for hand in trace.scenario.hands],
        "hand_radius_m": settings.hand.radius_m,
        "forearm_radius_m": settings.hand.forearm_radius_m,
        "forearm_length_m": settings.hand.forearm_length_m,
        "critical_distance_m": settings.avoidance.critical_distance_m,
        "table_height_m": settings.cell.table_height_m,
        "desired_tcp_in_base_m": list(settings.cell.desired_tcp_position_in_base_m),
        "object_in_base_m": [rounded(corner) for corner in object_polygon_in_base(settings)],
        "boxes_in_base_m": [_faces(box) for box in trace.scenario.obstacles],
        "views": _views(settings),
        "tracks": used,
        **({} if trace.known.whole else {"lacking": "not measured"}),
        "modes": {str(int(mode)): mode_name for mode, mode_name in MODE_WORDS.items()} | modes,
        "mode_inks": {str(int(mode)): ink.variable for mode, ink in MODE_INK.items()},
        "decisions": _decisions(trace),
        "worst": _worst(run),
        "limits_m": sorted({d_m for e in run.evaluations if (d_m := claimed_hand_distance_m(e)) is not None}),
        "chart": [LEFT_PX, PANEL_PX, WIDTH_PX, max(trace.scenario.duration_s, float(trace.time_s[-1]))],
        **packed(
            {
                "time_s": ticks["time_s"],
                "joint_position_rad": ticks["joint_position_rad"],
                "tcp_in_base_m": ticks["transform_tcp_to_base"][:, :3, 3],
                "hand_in_base_m": ticks["hand_position_in_base_m"][:, :hands],
                "elbow_in_base_m": ticks["elbow_position_in_base_m"][:, :hands],
                "hand_distance_m": np.where(present, ticks["hand_distance_m"], np.nan)[:, :hands],
                "nearest_capsule": np.where(there, nearest, -1)[:, :hands],
                "predicted_in_base_m": predicted[:, :used],
                "spread_m": prediction_spread_m(trace)[kept][:, :used],
                "separation_m": _separation_m(trace)[kept],
                "mode": np.where(measured(trace, "mode")[kept], ticks["mode"], -1),
                "object_visible": np.where(
                    measured(trace, "object_visible")[kept], ticks["object_visible"], -1
                ),
                "faulty": (ticks["faults"] != 0) & measured(trace, "faults")[kept],
            }
        ),
    }


def arm_in_scene(arm: ArmModel, capsules: CapsuleSet) -> dict[str, Any]:
    """Return the arm's frames and capsules in the form that the viewer reads."""
    return {
        "joint_origins": [rounded(origin, 9) for origin in arm.joint_origins],
        "joint_axes": arm.joint_axes.tolist(),
        "flange": rounded(arm.flange, 9),
        "capsules": [
            {"link": int(link), "start": rounded(start), "end": rounded(end), "radius_m": float(radius)}
            for link, start, end, radius in zip(
                capsules.link_index,
                capsules.start_in_link,
                capsules.end_in_link,
                capsules.radius_m,
                strict=True,
            )
        ],
    }


def rounded(values: NDArray[np.float64], digits: int = 5) -> list[float]:
    """Return the numbers of ``values`` (...,) as a flat list, rounded for pictures."""
    return [round(float(value), digits) for value in values.ravel()]


def kept_ticks(run: JudgedRun) -> NDArray[np.int64]:
    """Return the indices of the ticks that the replay shows."""
    count = len(run.trace.ticks)
    step = -(-count // MOST_TICKS)
    worst = [e.worst_time_s for e in run.evaluations if e.worst_time_s is not None]
    at_worst = [int(np.argmin(np.abs(run.trace.time_s - time_s))) for time_s in worst if isfinite(time_s)]
    decided_at = run.trace.decisions["tick"].tolist()[:MOST_TICKS] if decided(run.trace, "tick") else []
    # Besides evenly spaced ticks, keep the last tick, the worst moments and the decisions.
    kept = {*range(0, count, step), count - 1, *at_worst, *decided_at}
    return np.array(sorted(kept), np.int64)


def start_s(run: JudgedRun) -> float:
    """Return the time [s] at which the replay starts, which is the moment that the drawings show."""
    moment = shown_moment(run)
    return float(run.trace.time_s[0]) if moment is None else moment.time_s


def _separation_m(trace: Trace) -> NDArray[np.float64]:
    """Return the separation distance (n,) [m] that the arm needs from a human who reaches for the arm.

    The distance follows from the reaction and stop times of ``trace``, and is NaN where these times are
    unknown. The distance assumes that the arm approaches at the TCP's speed, whereas claims use the speed of
    each link.
    """
    speed_mps = trace.ticks["tcp_speed_mps"]
    ticks = zip(speed_mps.tolist(), *(column.tolist() for column in times_left_s(trace)), strict=True)
    needed = [sum(lengths(REACHING_MPS, speed, wait_s, stop_s, 0.0, 0.0)) for speed, wait_s, stop_s in ticks]
    return np.where(measured(trace, "tcp_speed_mps"), needed, np.nan)


def _views(settings: Settings) -> list[dict[str, Any]]:
    """Return the field of view of the servoing camera, and of an overhead hand camera if there is one.

    The position of the servoing camera is relative to the tool. The overhead camera is at its mount in the
    base frame. The corners of the servoing camera's view lie in the object's plane, as seen from the arm's
    goal. The corners of the overhead camera's view lie in the plane of the table.
    """
    camera, sensor, cell = settings.camera, settings.hand_sensor, settings.cell
    mount = transform_camera_to_tcp(camera, calibrated=False)
    depth_m = cell.desired_tcp_position_in_base_m[2] - settings.object.position_in_base_m[2]
    cameras = [(mount, camera, depth_m, True)]
    if sensor.kind is HandSensorKind.OVERHEAD:
        hung = overhead_transform_sensor_to_base(settings)
        cameras.append((hung, sensor, float(hung[2, 3]) - cell.table_height_m, False))  # type: ignore[arg-type]
    return [
        {"on_tool": on_tool, "transform": rounded(transform), "corners": _corners(optics, depth)}
        for transform, optics, depth, on_tool in cameras
    ]


def _corners(optics: Any, depth_m: float) -> list[list[float]]:  # a Camera or a HandSensor
    half = 0.5 * depth_m / optics.focal_px * np.array([optics.width_px, optics.height_px])
    return [rounded(np.array([*half * sign, depth_m])) for sign in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def _faces(box: Obstacle) -> list[list[list[float]]]:
    """Return the corners of four faces of a box: floor, top and two opposite walls.

    These four faces contain all edges of the box.
    """
    corners = [rounded(corner) for corner in box.corners_in_base_m]
    return [[corners[k] for k in face] for face in ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6))]


def _worst(run: JudgedRun) -> list[dict[str, Any]]:
    """Return the worst moment of each claim that has a worst moment."""
    return [
        {"time_s": judged.worst_time_s, "violated": judged.verdict is Verdict.VIOLATED}
        for judged in run.evaluations
        if judged.worst_time_s is not None and isfinite(judged.worst_time_s)
    ]


def _decisions(trace: Trace) -> list[dict[str, Any]]:
    """Return the time, the start, the chosen position and the refused positions of each decision.

    The result is empty if the decisions were not measured.
    """
    if not decided(trace, "time_s"):
        return []
    return [_decision(trace, decision) for decision in trace.decisions]


def _decision(trace: Trace, decision: np.void) -> dict[str, Any]:
    def place(name: str) -> list[float] | None:
        position_m = decision[f"{name}_position_in_base_m"]
        return rounded(position_m) if np.isfinite(position_m).all() else None

    texts, refused = [], []
    if decided(trace, "trigger"):
        texts.append(TRIGGER_WORDS[Trigger(decision["trigger"])])
    if decided(trace, "outcome"):
        texts.append(OUTCOME_WORDS[DecisionOutcome(decision["outcome"])])
    if decided(trace, "proposed_failed", "opposite_failed"):
        failed = Check(int(decision["proposed_failed"])), Check(int(decision["opposite_failed"]))
        names = zip(("proposed", "opposite"), failed, strict=True)
        refused = [at for name, check in names if check and (at := place(name)) is not None]
        texts += [f"refused: {failed_words(*failed)}"] if any(failed) else []
    return {
        "time_s": float(decision["time_s"]),
        "from": place("tcp"),
        "chosen": place("chosen"),
        "refused": refused,
        "says": ", ".join(texts),
    }
