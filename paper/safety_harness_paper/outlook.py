"""The paper's outlook, tried: ground truth by least object-pose error in place of least image error.

With the tool upright the two errors are the same number: every candidate keeps the orientation, and the image
error is then its displacement from the desired position.  What is left to try is where they differ: sampled
images, whose moments have pixel noise, and a TCP that is tilted when it gives way.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.regions import Region
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.avoider import Proposal, Vector
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base, view_of
from safety_harness.cell.controller.records import overhead_transform_sensor_to_base
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.servoing.features import feature_error, features
from safety_harness.cell.simulation.cameras import sensors
from safety_harness.cell.simulation.exact_views import exact_object
from safety_harness.extensions.lab.learning.dataset import seen
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.extensions.lab.learning.image_error import ImageErrors
from safety_harness.extensions.lab.learning.many_candidates import draw_many
from safety_harness.space.regions import paper_seen
from safety_harness_paper.trials import run, starts_of
from safety_harness_paper.work import Json, Task

TILTS_DEG = (0.0, 3.0, 5.0)
IMAGE, POSE = "least image error", "least object-pose error"
_DRAW = 6


def measurement(*, tcps: int, trials: int, root: int, settings: Settings) -> Task:
    """Select by both errors, and servo on from both."""
    return Task(
        "ground truth by object-pose error",
        measure,
        (("tcps", tcps), ("trials", trials), ("draw_seed", leaf(root, _DRAW)), ("settings", settings)),
        seconds=5.0 + tcps * 0.006 + trials * 0.6,
    )


def measure(folder: Path, *, tcps: int, trials: int, draw_seed: int, settings: Settings) -> Json:
    """How often and how far the selections differ, and iterations to the gain switch from each."""
    return {
        "selections": _selections(settings, tcps, draw_seed),
        "trials": [_trials(settings, trials, draw_seed, tilt) for tilt in TILTS_DEG[1:]],
    }


def _selections(settings: Settings, tcps: int, seed: int) -> list[Json]:
    """Upright by exact and by sampled images, then tilted by exact ones."""
    rng = np.random.default_rng(seed)
    cap, errors = CandidateCap.from_settings(settings), ImageErrors.from_settings(settings)
    desired = np.array(settings.cell.desired_tcp_position_in_base_m)
    starts = seen(settings).tcp.draw(rng, tcps)
    candidates = starts[:, None] + draw_many(cap, [rng] * tcps)  # (tcps, 100, 3)
    by_pose = np.linalg.norm(candidates - desired, axis=2)
    found = []
    for raster in (False, True):
        by_image, in_view = errors.at(candidates, raster=raster)
        name = "sampled images" if raster else "exact images"
        found.append(_compared(f"upright, {name}", candidates, by_image, by_pose, in_view))
    for tilt in TILTS_DEG[1:]:
        some = candidates[: max(tcps // 10, 10)]
        turns = [_tilt(rng, tilt) for _ in some]
        by_image, in_view = _tilted_errors(settings, some, turns)
        found.append(
            _compared(f"tilted by {tilt:g} deg, exact images", some, by_image, by_pose[: len(some)], in_view)
        )
    return found


def _compared(
    name: str,
    candidates: NDArray[np.float64],
    by_image: NDArray[np.float64],
    by_pose: NDArray[np.float64],
    in_view: NDArray[np.bool_],
) -> Json:
    """Among the candidates with the object in view; TCPs without any are left out and counted."""
    usable = in_view.any(axis=1)
    image = np.where(in_view, by_image, np.inf).argmin(axis=1)[usable]
    pose = np.where(in_view, by_pose, np.inf).argmin(axis=1)[usable]
    rows = np.arange(len(image))
    chosen, distances = candidates[usable], by_pose[usable]
    apart = np.linalg.norm(chosen[rows, image] - chosen[rows, pose], axis=1)
    return {
        "name": name,
        "tcps": len(image),
        "without_view": int(np.count_nonzero(~usable)),
        "same": int(np.count_nonzero(image == pose)),
        "apart_rms_m": float(np.sqrt((apart**2).mean())),
        "farther_from_goal_m": float((distances[rows, image] - distances[rows, pose]).mean()),
    }


def _tilt(rng: np.random.Generator, tilt_deg: float) -> NDArray[np.float64]:
    axis = rng.normal(size=3)
    turn: NDArray[np.float64] = np.radians(tilt_deg) * axis / np.linalg.norm(axis)
    return turn


def _tilted_errors(
    settings: Settings, candidates: NDArray[np.float64], tilts_rad: list[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """|f - f*|^2 (n, c) and whether the object is in view, the TCP's tilt kept at each candidate."""
    view = view_of(settings)
    cameras = sensors(settings, 0, 0, overhead_transform_sensor_to_base(settings))
    errors, in_view = np.full(candidates.shape[:2], np.inf), np.zeros(candidates.shape[:2], np.bool_)
    moments, f, e = np.empty(MOMENT_COUNT), np.empty(6), np.empty(6)
    pose = desired_transform_tcp_to_base(settings)
    upright = pose[:3, :3].copy()
    for row, tilt in enumerate(tilts_rad):
        pose[:3, :3] = upright @ rotation_from_vector(tilt)
        for column in range(candidates.shape[1]):
            pose[:3, 3] = candidates[row, column]
            if exact_object(cameras.state, cameras.polygon_in_base_m, pose, moments) and features(
                moments, view.area, view.depth_m, view.dense, f
            ):
                errors[row, column] = feature_error(f, view.features, e)
                in_view[row, column] = True
    return errors, in_view


class _Selected:
    """Eq. 13 with either error, for a TCP whose tilt is known beforehand."""

    def __init__(self, settings: Settings, tilt_rad: NDArray[np.float64], *, by_image: bool) -> None:
        self.name = IMAGE if by_image else POSE
        self._settings, self._tilt, self._by_image = settings, tilt_rad, by_image

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """The same candidates for both."""
        cap = CandidateCap.from_settings(self._settings)
        candidates = tcp_position_in_base_m + cap.draw(np.random.default_rng(seed))
        goal = np.array(self._settings.cell.desired_tcp_position_in_base_m)
        errors = np.linalg.norm(candidates - goal, axis=1)
        if self._by_image:
            image, in_view = _tilted_errors(self._settings, candidates[None], [self._tilt])
            if in_view.any():
                errors = np.where(in_view[0], image[0], np.inf)
        away = tcp_position_in_base_m - hand_position_in_base_m
        return Proposal(candidates[int(errors.argmin())] + self._settings.avoidance.hand_pull * away)


def _trials(settings: Settings, trials: int, seed: int, tilt_deg: float) -> Json:
    """PyBullet trials from seen TCPs that start tilted, the avoider told of the tilt at the start.

    Servoing for 100 ticks takes some of the tilt away; the avoider's images are those of the start.
    """
    rng = np.random.default_rng([seed, round(10 * tilt_deg)])
    hand = np.array(settings.avoidance.nominal_hand_position_in_base_m)
    found: dict[str, list[Any]] = {IMAGE: [], POSE: []}
    for number in range(trials):
        tilt = _tilt(rng, tilt_deg)
        x, y, z = (float(angle) for angle in tilt)
        starts, _ = starts_of(
            settings,
            1,
            int(rng.integers(2**63)),
            region=Region(paper_seen(settings).tcp),
            tilt_rad=(x, y, z),
        )
        for by_image, name in ((True, IMAGE), (False, POSE)):
            done = run(starts[0], _Selected(settings, tilt, by_image=by_image), hand, seed=number)
            found[name].append([done.fate, done.iterations])
    return {"tilt_deg": tilt_deg, "systems": found}
