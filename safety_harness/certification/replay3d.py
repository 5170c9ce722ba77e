"""What the 3-D replay of a run needs, as JSON: the arm's frames and capsules, and columns of the trace.

The viewer turns the joints itself, so that arm, hands and distances are those of the trace; columns are
32-bit floats in base64.  Long runs are thinned evenly, with every worst moment and every decision kept; the
viewer goes straight from one kept tick to the next.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.report.arm_page import arm_in_scene, column, in_script, rounded
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.path_views import shown_moment
from safety_harness.report.svg import plain
from safety_harness.report.words import MODE_WORDS
from safety_harness.robot.robots import arm_capsules, arm_model
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.settings import Object
from safety_harness.simulation.truth import cell_capsules
from safety_harness.trace.unmeasured import as_measured, decided, measured

MOST_TICKS = 750  # more are not seen; a run of ten seconds has 1250
ANY = 1_000_000  # no capsule: it is not known to which a hand is nearest


def replay_json(run: JudgedRun) -> str:
    """The replay of a run with at least one tick, safe to stand within a ``script`` element."""
    trace = as_measured(run.trace)
    settings = trace.scenario.settings
    arm = arm_model(trace.scenario.robot)
    capsules = cell_capsules(arm_capsules(trace.scenario.robot), settings)
    kept = kept_ticks(run)
    ticks = trace.ticks[kept]
    hands = len(trace.scenario.hands)
    present = measured(trace, "hand_present")[kept]
    there = present & np.isfinite(ticks["hand_position_in_base_m"]).all(axis=2)
    modes = {} if measured(trace, "mode").all() else {"-1": "mode not measured"}
    nearest = np.where(measured(trace, "hand_distance_capsule")[kept], ticks["hand_distance_capsule"], ANY)
    predicted = np.where(ticks["track_valid"][:, :, None], ticks["predicted_hand_in_base_m"], np.nan)
    used = int(np.max(np.flatnonzero(ticks["track_valid"].any(axis=0)) + 1, initial=0))
    found: dict[str, Any] = {
        **arm_in_scene(arm, capsules),
        "hands": [plain(hand.name, longest=40) for hand in trace.scenario.hands],
        "hand_radius_m": settings.hand.radius_m,
        "forearm_radius_m": settings.hand.forearm_radius_m,
        "forearm_length_m": settings.hand.forearm_length_m,
        "critical_distance_m": settings.avoidance.critical_distance_m,
        "table_height_m": settings.cell.table_height_m,
        "desired_tcp_in_base_m": list(settings.cell.desired_tcp_position_in_base_m),
        "object_in_base_m": _object(settings.object),
        "boxes_in_base_m": [_faces(box) for box in trace.scenario.obstacles],
        "tracks": used,
        "modes": {str(int(mode)): words for mode, words in MODE_WORDS.items()} | modes,
        "decisions": [_decision(decision) for decision in trace.decisions if decided(trace, "time_s")],
        "columns": {
            "time_s": column(ticks["time_s"]),
            "joint_position_rad": column(ticks["joint_position_rad"]),
            "tcp_in_base_m": column(ticks["transform_tcp_to_base"][:, :3, 3]),
            "hand_in_base_m": column(ticks["hand_position_in_base_m"][:, :hands]),
            "elbow_in_base_m": column(ticks["elbow_position_in_base_m"][:, :hands]),
            "hand_distance_m": column(np.where(present, ticks["hand_distance_m"], np.nan)[:, :hands]),
            "nearest_capsule": column(np.where(there, nearest, -1)[:, :hands]),
            "predicted_in_base_m": column(predicted[:, :used]),
            "mode": column(np.where(measured(trace, "mode")[kept], ticks["mode"], -1)),
        },
    }
    return in_script(found)


def kept_ticks(run: JudgedRun) -> NDArray[np.int64]:
    """Which ticks the replay shows."""
    count = len(run.trace.ticks)
    step = -(-count // MOST_TICKS)
    worst = [e.worst_time_s for e in run.evaluations if e.worst_time_s is not None]
    at_worst = [int(np.argmin(np.abs(run.trace.time_s - time_s))) for time_s in worst if isfinite(time_s)]
    asked = run.trace.decisions["tick"].tolist()[:MOST_TICKS] if decided(run.trace, "tick") else []
    kept = {*range(0, count, step), count - 1, *at_worst, *asked}
    return np.array(sorted(kept), np.int64)


def start_s(run: JudgedRun) -> float:
    """Where the replay stands at first: at the moment that the drawings show."""
    moment = shown_moment(run)
    return float(run.trace.time_s[0]) if moment is None else moment.time_s


def _object(shape: Object) -> list[list[float]]:
    c, s = np.cos(shape.yaw_rad), np.sin(shape.yaw_rad)
    corners = np.zeros((len(shape.polygon_m), 3))
    corners[:, :2] = np.array(shape.polygon_m) @ np.array([[c, s], [-s, c]])
    return [rounded(corner) for corner in corners + shape.position_in_base_m]


def _faces(box: Obstacle) -> list[list[list[float]]]:
    """The corners of its floor, its top and two walls, which have all edges."""
    corners = [rounded(corner) for corner in box.corners_in_base_m]
    return [[corners[k] for k in face] for face in ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6))]


def _decision(decision: np.void) -> dict[str, Any]:
    chosen = decision["chosen_position_in_base_m"]
    finite = bool(np.all(np.isfinite(chosen)))
    return {"time_s": float(decision["time_s"]), "chosen_in_base_m": rounded(chosen) if finite else None}
