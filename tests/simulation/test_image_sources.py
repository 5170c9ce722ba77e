"""Three ways to an image of the same scene: closed form, pixel centres, PyBullet's renderer.

Measured here: against the closed form the features of both pixel images have a standard deviation
of 0.1 mm (position) and 1e-3 (gamma, delta, alpha); rendered ones add a bias of the painted
object's thickness, half a millimetre.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, hand, run, scenario

from safety_harness.admission.admit import admit, kinematics, start_joint_position
from safety_harness.controller.desired import view_of
from safety_harness.controller.records import overhead_transform_sensor_to_base
from safety_harness.perception.camera import transform_camera_to_tcp
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.robot.kinematics import TCP
from safety_harness.servoing.features import features
from safety_harness.settings import DEFAULTS, DetectorKind, HandSensorKind, ImageSource, Settings
from safety_harness.simulation.cell import Bodies, build_cell, place_hands
from safety_harness.simulation.engine import pybullet
from safety_harness.simulation.hand_motion import hands_at_start
from safety_harness.simulation.image_sources import render, rendered_object
from safety_harness.simulation.pybullet_world import PyBulletWorld
from safety_harness.simulation.sensing import exact_object, sensors

Vector = tuple[float, float, float]
CAMERA = DEFAULTS.camera
SIGMA = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])
