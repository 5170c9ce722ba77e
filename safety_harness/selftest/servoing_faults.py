"""What can be wrong with servoing: features, interaction matrix, gain."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.controller.cycle import ControllerRecords
from safety_harness.selftest.fault import FaultyPart, SeededFault, SeverityLevels
from safety_harness.selftest.perception_faults import parameters, seen
from safety_harness.selftest.system import Change, Delayed, Records
from safety_harness.servoing.features import ALPHA, X_N

FEATURES = ("x_n", "y_n", "a_n", "gamma", "delta", "alpha")


def _low_gain(records: ControllerRecords, factor: float) -> None:
    records.parameters["gain_far"] *= factor


def _unswitched(records: ControllerRecords, factor: float) -> None:
    records.parameters["gain_near"] *= factor


def _wrong_sign(records: ControllerRecords, factor: float) -> None:
    for name in ("gain_far", "gain_near"):
        records.parameters[name] *= factor


def _negated_column(records: ControllerRecords, feature: float) -> None:
    for name in ("desired_interaction_pinv", "desired_interaction"):
        records.parameters[name][0][:, int(feature) - 1] *= -1.0


def _lost_column(records: ControllerRecords, feature: float) -> None:
    records.parameters["desired_interaction_pinv"][0][:, int(feature) - 1] = 0.0


def turned_alpha(records: ControllerRecords, angle_rad: float) -> None:
    """The desired direction of the object is another one."""
    records.parameters["desired_features"][0, ALPHA] += angle_rad


def _wrong_goal(records: ControllerRecords, by_m: float) -> None:
    records.parameters["desired_features"][0, X_N] += by_m


def _wrong_mount(records: ControllerRecords, angle_rad: float) -> None:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose = records.parameters["transform_camera_to_tcp"][0]
    pose[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ pose[:3, :3]


def _blind_and_sure(admitted: Admitted) -> Change:
    """The object is always said to be in view, where it was seen last."""
    last: list[NDArray[np.float64]] = []

    def see(observation: Records) -> Records:
        o = observation[0]
        if o["image_new"] and o["object_visible"]:
            last[:] = [o["moments"].copy()]
        elif o["image_new"] and last:
            o["object_visible"], o["moments"] = True, last[0]
        return observation

    return see


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


def _frozen(admitted: Admitted, from_s: float, observation: Records) -> None:
    if observation[0]["time_s"] >= from_s:
        observation[0]["image_new"] = False


_servoing = partial(SeededFault, part=FaultyPart.SERVOING)

SERVOING_FAULTS = (
    _servoing(
        name="gain never raised",
        hazard="the near gain from the start: the task takes for ever",
        seed_into=parameters(_low_gain),
        ladder=SeverityLevels((0.0, 0.25, 0.5, 0.7), "times the far gain"),
    ),
    _servoing(
        name="gain never switched",
        hazard="the far gain to the end: the arm overshoots where it works",
        seed_into=parameters(_unswitched),
        ladder=SeverityLevels((40.0, 4.0, 2.0), "times the near gain"),
    ),
    _servoing(
        name="gain of the wrong sign",
        hazard="the arm runs away from its task until it is stopped",
        seed_into=parameters(_wrong_sign),
        ladder=SeverityLevels((-4.0, -1.0, -0.1), "times"),
    ),
    _servoing(
        name="gain too high",
        hazard="the arm swings about its goal",
        seed_into=parameters(_wrong_sign),
        ladder=SeverityLevels((1000.0, 400.0, 100.0, 20.0), "times"),
    ),
    _servoing(
        name="wrong row of the interaction matrix",
        hazard="one feature is driven the wrong way: the camera turns away",
        seed_into=parameters(_negated_column),
        ladder=SeverityLevels((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=FEATURES),
    ),
    _servoing(
        name="row of the interaction matrix lost",
        hazard="one feature is not servoed on: the arm ends beside its goal",
        seed_into=parameters(_lost_column),
        ladder=SeverityLevels((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=FEATURES),
    ),
    _servoing(
        name="direction of the object wrong",
        hazard="the tool arrives turned",
        seed_into=parameters(turned_alpha),
        ladder=SeverityLevels((np.pi / 2, 0.5, 0.1, 0.02, 0.005), "deg", 180.0 / np.pi),
    ),
    _servoing(
        name="wrong desired position",
        hazard="the tool arrives beside the object",
        seed_into=parameters(_wrong_goal),
        ladder=SeverityLevels((0.1, 0.03, 0.01, 0.003), "mm", 1e3),
    ),
    _servoing(
        name="wrong hand-eye calibration",
        hazard="the arm spirals instead of going straight",
        seed_into=parameters(_wrong_mount),
        ladder=SeverityLevels((np.pi, 1.8, 1.2, 0.6), "deg", 180.0 / np.pi),
    ),
    _servoing(
        name="lost object not noticed",
        hazard="the arm goes on by an old picture while the object is hidden",
        seed_into=lambda s, _: s.seeing(_blind_and_sure),
    ),
    _servoing(
        name="late images that nobody counts",
        hazard="the control loop swings",
        seed_into=lambda s, delay_s: s.seeing(partial(_late_image, delay_s)),
        ladder=SeverityLevels((20.0, 5.0, 2.0, 1.0), "s"),
    ),
    _servoing(
        name="frozen image",
        hazard="the arm goes on and on in the direction of the last picture",
        seed_into=seen(_frozen),
        ladder=SeverityLevels((0.5, 2.0, 5.0), "s after the start"),
    ),
)
