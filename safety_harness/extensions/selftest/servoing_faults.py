"""Define faults of the visual servo, in its features, its interaction matrix and its gain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.base.elementary import cos, product, sin
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.cell.servoing.features import ALPHA, X_N
from safety_harness.extensions.selftest.fault import faults_in, known, of_servoing, seeded, seeing, seen
from safety_harness.extensions.selftest.system import Change, Delayed, Records

FEATURES = ("x_n", "y_n", "a_n", "gamma", "delta", "alpha")


@of_servoing("gain never raised", "the near gain from the start: the task takes for ever")
@seeded(known, (0.0, 0.25, 0.5, 0.7), "times the far gain")
def _low_gain(records: ControllerRecords, factor: float) -> None:
    records.parameters["gain_far"] *= factor


@of_servoing("gain never switched", "the far gain to the end: the arm overshoots where it works")
@seeded(known, (40.0, 4.0, 2.0), "times the near gain")
def _unswitched(records: ControllerRecords, factor: float) -> None:
    records.parameters["gain_near"] *= factor


@of_servoing("gain of the wrong sign", "the arm runs away from its task until it is stopped")
@seeded(known, (-4.0, -1.0, -0.1), "times")
def _wrong_sign(records: ControllerRecords, factor: float) -> None:
    for name in ("gain_far", "gain_near"):
        records.parameters[name] *= factor


@of_servoing("gain too high", "the arm swings about its goal")
@seeded(known, (1000.0, 400.0, 100.0, 20.0), "times")
def _high_gain(records: ControllerRecords, factor: float) -> None:
    for name in ("gain_far", "gain_near"):
        records.parameters[name] *= factor


@of_servoing(
    "wrong row of the interaction matrix", "one feature is driven the wrong way: the camera turns away"
)
@seeded(known, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=FEATURES)
def _negated_column(records: ControllerRecords, feature: float) -> None:
    for name in ("desired_interaction_pinv", "desired_interaction"):
        records.parameters[name][0][:, int(feature) - 1] *= -1.0


@of_servoing(
    "row of the interaction matrix lost", "one feature is not servoed on: the arm ends beside its goal"
)
@seeded(known, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=FEATURES)
def _lost_column(records: ControllerRecords, feature: float) -> None:
    records.parameters["desired_interaction_pinv"][0][:, int(feature) - 1] = 0.0


@of_servoing("direction of the object wrong", "the tool arrives turned")
@seeded(known, (np.pi / 2, 0.5, 0.1, 0.02, 0.005), "deg", 180.0 / np.pi)
def _turned_alpha(records: ControllerRecords, angle_rad: float) -> None:
    records.parameters["desired_features"][0, ALPHA] += angle_rad


@of_servoing("wrong desired position", "the tool arrives beside the object")
@seeded(known, (0.1, 0.03, 0.01, 0.003), "mm", 1e3)
def _wrong_goal(records: ControllerRecords, by_m: float) -> None:
    records.parameters["desired_features"][0, X_N] += by_m


@of_servoing("wrong hand-eye calibration", "the arm spirals instead of going straight")
@seeded(known, (np.pi, 1.8, 1.2, 0.6), "deg", 180.0 / np.pi)
def _wrong_mount(records: ControllerRecords, angle_rad: float) -> None:
    c, s = cos(angle_rad), sin(angle_rad)
    pose = records.parameters["transform_camera_to_tcp"][0]
    pose[:3, :3] = product(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), pose[:3, :3])


@of_servoing("lost object not noticed", "the arm goes on by an old picture while the object is hidden")
@seeded(seeing)
def _blind_and_sure(_: float, admitted: Admitted) -> Change:
    """Report the object as visible even if it is not, at the place where the camera last saw it."""
    last: list[NDArray[np.float64]] = []

    def see(observation: Records) -> Records:
        o = observation[0]
        if o["image_new"] and o["object_visible"]:
            last[:] = [o["moments"].copy()]
        elif o["image_new"] and last:
            o["object_visible"], o["moments"] = True, last[0]
        return observation

    return see


@of_servoing("late images that nobody counts", "the control loop swings")
@seeded(seeing, (20.0, 5.0, 2.0, 1.0), "s")
def _late_image(delay_s: float, admitted: Admitted) -> Change:
    images = Delayed(delay_s)

    def see(observation: Records) -> Records:
        o = observation[0]
        if o["image_new"]:
            images.put(float(o["time_s"]), (bool(o["object_visible"]), o["moments"].copy()))
        image = images.due(float(o["time_s"]))
        o["image_new"] = image is not None
        if image is not None:
            o["object_visible"], o["moments"] = image
        return observation

    return see


@of_servoing("frozen image", "the arm goes on and on in the direction of the last picture")
@seeded(seen, (0.5, 2.0, 5.0), "s after the start")
def _frozen(admitted: Admitted, from_s: float, observation: Records) -> None:
    if observation[0]["time_s"] >= from_s:
        observation[0]["image_new"] = False


SERVOING_FAULTS = faults_in(globals())
