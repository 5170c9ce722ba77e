"""A trace as a log of a real cell would give it: much of it was not measured, and nothing is exact."""

from __future__ import annotations

from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    OF_DECISIONS,
    Gap,
    Measurement,
    Source,
)
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

UNSEEN = Gap(first=100, after=180, hand=0)  # of a run that lasts a second and a half, at least
OF_THE_CONTROLLER = (
    *("mode", "gain", "camera_twist", "demanded_joint_velocity_radps", "limits", "faults", "decision"),
    *("object_visible", "features", "feature_error", "sse"),
    *("track_valid", "predicted_hand_in_base_m", "predicted_distance_m"),
)


def partly_measured(trace: Trace) -> Trace:
    """No mode, no decisions, no camera, no tracks; the hands by a sensor, which lost one of them a while."""
    lost = UNSEEN if UNSEEN.after <= len(trace.ticks) else Gap(first=1, after=2, hand=0)
    by_sensor = Measurement(source=Source.SENSOR, uncertainty=0.008, gaps=(lost,))
    unknown = (*OF_THE_CONTROLLER, *(name for name in COLUMNS_OF_A_TRACE if name.startswith(OF_DECISIONS)))
    return knowing(
        trace,
        {
            "joint_position_rad": Measurement(source=Source.LOG),
            "joint_velocity_radps": Measurement(source=Source.LOG, uncertainty=0.001),
            "hand_position_in_base_m": by_sensor,
            "elbow_position_in_base_m": by_sensor,
            "hand_distance_m": Measurement(source=Source.DERIVED, uncertainty=0.008, gaps=(lost,)),
            "hand_distance_capsule": Measurement(source=Source.DERIVED, gaps=(lost,)),
            **dict.fromkeys(unknown, NOT_MEASURED),
        },
    )
