"""The paper's argument for a network: a decision is quicker than the image errors of 100 candidates.

The same question asked again and again on one core, one call at a time, clocked on the wall.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.base.settings import ImageSource, Settings
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.extensions.lab.learning.image_error import ImageErrors
from safety_harness.scenario.model import OffsetStart, Scenario
from safety_harness_paper.avoiders import BAYESIAN, DNN, ENSEMBLE
from safety_harness_paper.networks import avoider_in
from safety_harness_paper.work import Done, Json, Task

EXACT, RASTER, RENDERED = (
    "100 candidates, closed-form moments",
    "100 candidates, sampled 640 x 480 images",
    "100 candidates, rendered 640 x 480 images",
)
MOST_RENDERED = 60  # images; the figure is 100 times one


def measurement(models: tuple[Task, ...], *, calls: int, settings: Settings) -> Task:
    """Clock the decisions."""
    return Task(
        "time decisions against image errors",
        measure,
        (("calls", calls), ("settings", settings)),
        models,
        seconds=20.0,
        alone=True,
    )


def measure(
    folder: Path, dnn: Done, bayesian: Done, ensemble: Done, *, calls: int, settings: Settings
) -> Json:
    """{"seconds": {what: [each call]}, "images": ...}."""
    hand = np.array(settings.avoidance.nominal_hand_position_in_base_m)
    tcp = np.array(settings.cell.desired_tcp_position_in_base_m) + [0.03, 0.1, -0.05]
    cap, errors = CandidateCap.from_settings(settings), ImageErrors.from_settings(settings)
    found: dict[str, Any] = {}
    for name, done in ((DNN, dnn), (BAYESIAN, bayesian), (ENSEMBLE, ensemble)):
        avoider = avoider_in(done)
        found[name] = _clock(
            lambda seed, avoider=avoider: avoider.propose(  # type: ignore[misc]
                hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=seed
            ),
            calls,
        )

    def online(raster: bool) -> Callable[[int], object]:
        def decide(seed: int) -> object:
            candidates = tcp + cap.draw(np.random.default_rng(seed))
            return errors.select(candidates[None], raster=raster)

        return decide

    found[EXACT] = _clock(online(False), calls)
    found[RASTER] = _clock(online(True), max(calls // 10, 10))
    images = min(MOST_RENDERED, max(calls // 20, 5))
    one = _rendered(settings, images)
    found[RENDERED] = [100.0 * seconds for seconds in one]
    return {"seconds": found, "rendered_images": images}


def _clock(call: Callable[[int], object], calls: int) -> list[float]:
    for seed in range(3):
        call(seed)
    seconds = []
    for seed in range(calls):
        begun_s = time.perf_counter()
        call(seed)
        seconds.append(time.perf_counter() - begun_s)
    return seconds


def _rendered(settings: Settings, images: int) -> list[float]:
    """Seconds for one rendered image with its threshold and moments, as a world takes it at each tick."""
    own = replace(settings, camera=replace(settings.camera, source=ImageSource.RENDERED))
    scenario = Scenario(
        name="images",
        title="images",
        about="",
        duration_s=1.0,
        seed=0,
        start=OffsetStart(offset_in_base_m=(0.03, 0.1, -0.05)),
        hands=(),
        avoider="opposite pose",
        claims=(),
        settings=own,
    )
    start = admit(scenario, avoider=OppositePose(settings.avoidance.radius_m))
    seconds = []
    with PyBulletWorld(scenario, start.arm, start.joint_position_rad) as world:
        controller = start.controller()
        for _ in range(images + 2):
            begun_s = time.perf_counter()
            observation = world.observe()
            seconds.append(time.perf_counter() - begun_s)
            world.step(controller.step(observation))
    return seconds[2:]
