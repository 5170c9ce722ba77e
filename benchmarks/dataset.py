"""How long does the paper's data set take, and do images select alike?

Run: python benchmarks/dataset.py.  The last part takes minutes: PyBullet's software renderer needs
60 ms and more for each of 2,000 images.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import resource
import time

import numpy as np
from numpy.typing import NDArray
from ratios import Ratio

from safety_harness.base.exceptions import SimulationError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.cell.servoing.features import feature_error, features
from safety_harness.cell.simulation.cell import build_cell, render, rendered_object
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.extensions.lab.learning.dataset import (
    SPACES,
    CompactDataset,
    candidates_of,
    generate,
    label_floor,
    seen,
    space_named,
    split_by_sample,
    split_by_tcp,
)
from safety_harness.extensions.lab.learning.image_error import ImageErrors

SEED = 1
RASTER_POSES = 1000
RENDERED_POSES = 20
AIMED_S, AIMED_BYTES = 5.0, 1e9


def peak_bytes() -> int:
    """The most memory that this process has held so far, libraries included."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def paper_scale() -> CompactDataset:
    """Generate 10,000 x 100 x 500 and print time, memory and what was out of view."""
    began = time.perf_counter()
    generate(DEFAULTS, seen(DEFAULTS), seed=SEED, tcps=1)
    print(f"compiling or loading the machine code {time.perf_counter() - began:.2f} s")
    before = peak_bytes()
    began = time.perf_counter()
    dataset = generate(DEFAULTS, seen(DEFAULTS), seed=SEED)
    elapsed_s = time.perf_counter() - began
    grown, peak = peak_bytes() - before, peak_bytes()
    met = "met" if elapsed_s < AIMED_S and peak < AIMED_BYTES else "MISSED"
    print(
        f"{len(dataset):,} samples in {elapsed_s:.2f} s; peak {peak / 1e6:.0f} MB, "
        f"{grown / 1e6:.0f} MB of it for this (aim: {AIMED_S:.0f} s, {AIMED_BYTES / 1e6:.0f} MB: {met})"
    )
    began = time.perf_counter()
    every = np.arange(len(dataset))
    rows = dataset.inputs(every).nbytes + dataset.targets(every).nbytes
    print(f"all rows, when asked for: {time.perf_counter() - began:.2f} s, {rows / 1e6:.0f} MB")
    for split in (split_by_sample, split_by_tcp):
        began = time.perf_counter()
        split(dataset, seed=SEED)
        print(f"{split.__name__} {time.perf_counter() - began:.2f} s")
    return dataset


def spaces() -> None:
    """Print what is out of view, and the floor, in the seen and the unseen TCPs."""
    for name in ("seen", "unseen tcp"):
        dataset = generate(DEFAULTS, space_named(name, DEFAULTS), seed=SEED)
        print(
            f"{dataset.space.name}: object not wholly in view of {dataset.views_without_object:,} of "
            f"{dataset.tcps * dataset.candidates:,} candidates (not selected), and of all candidates of "
            f"{dataset.tcps_without_view:,} TCPs (selected as if the image had no border)"
        )
        began = time.perf_counter()
        floor = label_floor(DEFAULTS, dataset.tcp_in_base[:1000], seed=SEED)
        elapsed_s = time.perf_counter() - began
        print(
            f"  label floor, {floor.redraws} redraws for each of 1,000 TCPs ({elapsed_s:.2f} s): "
            f"RMSE {in_mm(floor.rmse_m)}, MAE {in_mm(floor.mae_m)} mm"
        )
        noise = dataset.selected_in_base - dataset.optimum_in_base
        print(f"  selected from the continuous optimum: RMSE {in_mm(np.sqrt((noise**2).mean(axis=0)))} mm")


def in_mm(values_m: NDArray[np.float64] | tuple[float, ...]) -> str:
    """Millimetres with one decimal."""
    return " / ".join(f"{1e3 * value:.1f}" for value in values_m)


def agreement(
    name: str, candidates: NDArray[np.float64], exact: NDArray[np.int64], other: NDArray[np.int64]
) -> None:
    """Print how often two selections are the same candidate and how far apart they are."""
    rows = np.arange(len(candidates))
    first, second = candidates[rows, exact], candidates[rows, other]
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    apart = 1e3 * np.linalg.norm(first - second, axis=1)
    longer = 1e3 * (np.linalg.norm(second - desired, axis=1) - np.linalg.norm(first - desired, axis=1))
    print(f"{name}: same candidate for {np.count_nonzero(apart == 0.0)} of {len(rows)} TCPs")
    differing = apart[apart > 0.0]
    if len(differing):
        print(
            f"  the others are {np.median(differing):.1f} mm apart (median; at most {differing.max():.1f}),"
        )
        print(f"  their way to the desired position is longer by at most {longer.max():.2f} mm")


def raster(dataset: CompactDataset) -> None:
    """Images sampled at pixel centres against exact moments."""
    errors = ImageErrors.from_settings(DEFAULTS)
    numbers = np.arange(RASTER_POSES)
    candidates = candidates_of(dataset.settings, dataset.tcp_in_base, dataset.seed, numbers)
    agreement("raster", candidates, errors.select(candidates)[0], errors.select(candidates, raster=True)[0])


def rendered(dataset: CompactDataset) -> None:
    """Rendered and thresholded images, with the arm at its true joint angles, against exact moments."""
    errors = ImageErrors.from_settings(DEFAULTS)
    numbers = np.arange(RENDERED_POSES)
    candidates = candidates_of(dataset.settings, dataset.tcp_in_base, dataset.seed, numbers)
    exact = errors.select(candidates)[0]
    found, seconds = rendered_errors(errors, candidates.reshape(-1, 3))
    unseen = int(np.count_nonzero(np.isinf(found)))
    missed = int(np.count_nonzero(~errors.at(candidates)[1]))
    agreement("rendered", candidates, exact, np.argmin(found.reshape(candidates.shape[:2]), axis=1))
    print(
        f"  {found.size} images in {seconds:.0f} s; no whole object found in {unseen} of them, by exact "
        f"geometry in {missed}"
    )


def rendered_errors(errors: ImageErrors, positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """(k,) |f - f*|^2 of images rendered at (k, 3) of the TCP, and the seconds that they took.

    Infinite where no whole object is found.
    """
    arm = load_arm()
    kinematics = InverseKinematics(arm)
    preferred = np.array(DEFAULTS.cell.preferred_joint_position_rad)
    camera_to_tcp = transform_camera_to_tcp(DEFAULTS.camera, calibrated=False)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        bodies = build_cell(client, DEFAULTS, arm, preferred, rendered=True)
        found, began = np.empty(len(positions)), time.perf_counter()
        for k, position in enumerate(positions):
            pose = desired_transform_tcp_to_base(DEFAULTS)
            pose[:3, 3] = position
            joints = kinematics.nearest(pose, preferred)
            if joints is None:
                raise SimulationError("a candidate that the arm cannot reach")
            pybullet.resetJointStatesMultiDof(
                bodies.robot, bodies.joints, [[q] for q in joints], [[0.0]] * 6, physicsClientId=client
            )
            found[k] = error_in(errors, client, pose @ camera_to_tcp)
        return found, time.perf_counter() - began
    finally:
        pybullet.disconnect(client)


def error_in(errors: ImageErrors, client: int, camera_to_base: NDArray[np.float64]) -> float:
    """|f - f*|^2 of one rendered image; infinite where no whole object is found."""
    colour, _ = render(client, camera_to_base, errors.focal_px, errors.width_px, errors.height_px)
    visible, moments = rendered_object(colour, errors.focal_px)
    current = np.empty(6)
    if not visible or not features(moments, errors.area, errors.depth_m, errors.dense, current):
        return float(np.inf)
    return float(feature_error(current, errors.features, np.empty(6)))


def ratios() -> list[Ratio]:
    """A label by rendered images of its candidates over one of ours, the hands of a TCP included."""
    generate(DEFAULTS, seen(DEFAULTS), seed=SEED, tcps=1)
    turns, labels = [], 0
    for turn in range(3):
        began = time.perf_counter()
        dataset = generate(DEFAULTS, seen(DEFAULTS), seed=turn, tcps=1000)
        own_s = (time.perf_counter() - began) / 1000
        labels = len(dataset) // 1000
        candidates = candidates_of(dataset.settings, dataset.tcp_in_base, dataset.seed, np.arange(1))[0]
        image_s = rendered_errors(ImageErrors.from_settings(DEFAULTS), candidates[:10])[1] / 10
        turns.append((len(candidates) * image_s, own_s))
    note = f"a TCP of {labels} samples; ours {1e6 * min(own_s for _, own_s in turns):.0f} us"
    return [Ratio.of("data, rendered candidates over ours", [a / b for a, b in turns], note=note)]


def main() -> None:
    """Print everything."""
    dataset = paper_scale()
    print(f"spaces: {', '.join(SPACES)}")
    spaces()
    raster(dataset)
    rendered(dataset)


if __name__ == "__main__":
    main()
