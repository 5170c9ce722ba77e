"""Does a trace's truth agree with itself?  Poses, speeds and distances follow from joints and hands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.exceptions import Place, TraceError
from safety_harness.properties.true_motion import capsules_of, first_stray, hand_paths
from safety_harness.robot.description import load_arm
from safety_harness.scenario.model import MAX_HANDS
from safety_harness.simulation.hand_motion import HAND
from safety_harness.simulation.truth import arm_record, fill_truth
from safety_harness.trace.consistency import Inconsistency, at_first, first_inconsistency
from safety_harness.trace.records import TICK, TICK_COMPILED
from safety_harness.trace.trace import Trace

DERIVED = ("transform_tcp_to_base", "tcp_speed_mps", "hand_distance_m")
TOLERANCE = 1e-9  # metres, metres a second and entries of rotations: another machine's last digits


def refuse_contradictions(trace: Trace, file: Path | None = None) -> None:
    """TraceError with field and tick if no run can have written ``trace``; ``file`` is what it names."""
    wrong = first_inconsistency(trace) or first_untruth(trace)
    if wrong is not None:
        where = wrong.where if file is not None else f"trace of {trace.scenario.name}: {wrong.where}"
        raise TraceError(place=Place(file=file, field=where), expected=wrong.expected, got=wrong.got)


def first_untruth(trace: Trace) -> Inconsistency | None:
    """The first tick whose pose, speed or hand distances are not those of its joints and hands.

    What is NaN must be NaN because joints or hands are; whether that can be judged is for the
    properties to say.  The order of the fields counts before that of the ticks.
    """
    settings = trace.scenario.settings
    arm = load_arm(trace.scenario.robot.arm_name)
    capsules = capsules_of(trace)
    derived = np.zeros(len(trace.ticks), TICK)
    _derive(
        arm_record(arm, settings),
        capsules.records,
        np.empty((len(capsules.names), 2, 3)),
        np.zeros(MAX_HANDS, HAND),
        trace.ticks.copy().view(TICK_COMPILED),  # compiled code takes no array that is read-only
        derived.view(TICK_COMPILED),
    )
    for name in DERIVED:
        stored, true = trace.ticks[name], derived[name]
        same = np.isclose(stored, true, rtol=0.0, atol=TOLERANCE, equal_nan=True)
        for found in at_first(~same, name, "tick", "what joints and hands give", stored):
            return found
    part = trace.ticks["hand_distance_capsule"]
    expected = f"one of {len(capsules.names)} parts"
    for found in at_first(part >= len(capsules.names), "hand_distance_capsule", "tick", expected, part):
        return found
    stray = first_stray(trace, hand_paths(trace)) if len(trace.ticks) else None
    if stray is None:
        return None
    hands = trace.ticks["hand_position_in_base_m"][stray]
    expected = "hands and elbows where the scenario moves them"
    return Inconsistency("hand_position_in_base_m", "tick", stray, expected, str(hands.tolist()))


@compiled
def _derive(
    arms: NDArray[np.void],  # (1,) ARM
    capsules: NDArray[np.void],  # (n,) CAPSULE
    capsule_endpoints_in_base_m: NDArray[np.float64],  # (n, 2, 3), overwritten
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND, overwritten
    stored: NDArray[np.void],  # (n,) TICK_COMPILED
    derived: NDArray[np.void],  # (n,) TICK_COMPILED, its truth written
) -> None:
    """The truth of every tick again, from its joints and hands."""
    for k in range(stored.shape[0]):
        tick = stored[k]
        for i in range(hands.shape[0]):
            hands[i].present = tick.hand_present[i] != 0
            for j in range(3):
                hands[i].position_in_base_m[j] = tick.hand_position_in_base_m[i, j]
                hands[i].elbow_in_base_m[j] = tick.elbow_position_in_base_m[i, j]
        fill_truth(
            arms,
            derived[k : k + 1],
            hands,
            capsules,
            capsule_endpoints_in_base_m,
            tick.joint_position_rad,
            tick.joint_velocity_radps,
            tick.time_s,
        )
