"""The signals that formulas can name.  ``hand_distance() > mm(50)`` is a formula, and so is ``stopped()``."""

from __future__ import annotations

import numpy as np

from safety_harness.formulas.hand_cells import hand_distance_of, nearest_hand_to_tcp_of
from safety_harness.formulas.sampling import (
    angle_to_desired_pose_of,
    deciding_of,
    distance_to_desired_pose_of,
    elapsed_time_of,
    falling_back_of,
    fault_acting_of,
    hand_tracked_of,
    image_error_of,
    in_mode,
    joint_speed_of,
    object_visible_of,
    predicted_hand_distance_of,
    prediction_error_of,
    spread_of,
    tcp_height_of,
    tcp_speed_of,
)
from safety_harness.formulas.signal import Flag, Interpolation, Measure, Signal
from safety_harness.scenario.units import ANGLE, ANGULAR_SPEED, LENGTH, NUMBER, SPEED, TIME
from safety_harness.trace.records import Mode

hand_distance = Measure(
    words="hand distance",
    dimension=LENGTH,
    meaning="of any hand or forearm from any link of the robot, surface to surface; negative inside",
    least=-np.inf,
    between=Interpolation.BOUNDED,
    sample=hand_distance_of,
)
nearest_hand_to_tcp = Measure(
    words="nearest hand to TCP",
    dimension=LENGTH,
    meaning="from the TCP to the centre of the nearest true hand",
    between=Interpolation.BOUNDED,
    sample=nearest_hand_to_tcp_of,
)
tcp_speed = Measure(
    words="TCP speed",
    dimension=SPEED,
    meaning="of the TCP; between ticks the mean speed counts too",
    between=Interpolation.BOUNDED,
    sample=tcp_speed_of,
)
tcp_height = Measure(
    words="TCP height",
    dimension=LENGTH,
    meaning="of the TCP above the origin of the robot's base frame",
    least=-np.inf,
    between=Interpolation.BOUNDED,
    sample=tcp_height_of,
)
distance_to_desired_pose = Measure(
    words="distance to desired pose",
    dimension=LENGTH,
    meaning="of the TCP from where servoing wants it",
    between=Interpolation.BOUNDED,
    sample=distance_to_desired_pose_of,
)
angle_to_desired_pose = Measure(
    words="angle to desired pose",
    dimension=ANGLE,
    meaning="by which the TCP is turned away from how servoing wants it",
    between=Interpolation.BOUNDED,
    sample=angle_to_desired_pose_of,
)
joint_speed = Measure(
    words="joint speed",
    dimension=ANGULAR_SPEED,
    meaning="of the fastest joint; between ticks the mean speed counts too",
    between=Interpolation.BOUNDED,
    sample=joint_speed_of,
)
image_error = Measure(
    words="image error",
    dimension=NUMBER,
    meaning="eq. 15 of the paper as the controller has it; unknown while the object is not seen",
    between=Interpolation.HELD,
    sample=image_error_of,
)
spread = Measure(
    words="spread",
    dimension=LENGTH,
    meaning="of the latest decision's proposal, largest of the three axes; unknown before the first decision",
    between=Interpolation.HELD,
    sample=spread_of,
)
predicted_hand_distance = Measure(
    words="predicted hand distance",
    dimension=LENGTH,
    meaning="from the TCP to the nearest hand that the controller predicts; endless where it predicts none",
    endless=True,
    between=Interpolation.HELD,
    sample=predicted_hand_distance_of,
)
prediction_error = Measure(
    words="prediction error",
    dimension=LENGTH,
    meaning="of each prediction made now from the nearest true hand at the time that it is for, the largest; "
    "unknown where none is made, or that time is after the run",
    between=Interpolation.TICKS_ONLY,
    sample=prediction_error_of,
)
elapsed_time = Measure(
    words="elapsed time",
    dimension=TIME,
    meaning="since the run began",
    between=Interpolation.BOUNDED,
    sample=elapsed_time_of,
)
object_visible = Flag(
    words="object visible",
    meaning="the controller's image shows the object",
    sample=object_visible_of,
)
servoing = Flag(words="servoing", meaning="the controller servoes", sample=in_mode(Mode.SERVOING))
repulsing = Flag(words="repulsing", meaning="the controller gives way", sample=in_mode(Mode.REPULSING))
stopped = Flag(words="stopped", meaning="a protective stop", sample=in_mode(Mode.PROTECTIVE_STOP))
object_lost = Flag(
    words="object lost",
    meaning="the controller waits for the object to be seen",
    sample=in_mode(Mode.OBJECT_LOST),
)
deciding = Flag(words="deciding", meaning="a decision is made at this tick", sample=deciding_of)
falling_back = Flag(
    words="falling back",
    meaning="it gives way to the opposite pose, or stops, since the latest proposal was refused",
    sample=falling_back_of,
)
hand_tracked = Flag(
    words="hand tracked", meaning="the controller predicts a hand at least", sample=hand_tracked_of
)
fault_acting = Flag(words="fault acting", meaning="one of the scenario's faults acts", sample=fault_acting_of)

SIGNALS: tuple[Signal, ...] = (
    hand_distance,
    nearest_hand_to_tcp,
    tcp_speed,
    tcp_height,
    distance_to_desired_pose,
    angle_to_desired_pose,
    joint_speed,
    image_error,
    spread,
    predicted_hand_distance,
    prediction_error,
    elapsed_time,
    object_visible,
    servoing,
    repulsing,
    stopped,
    object_lost,
    deciding,
    falling_back,
    hand_tracked,
    fault_acting,
)
