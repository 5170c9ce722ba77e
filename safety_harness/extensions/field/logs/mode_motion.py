"""Check the mode that a controller reports against the motion of the arm."""

from __future__ import annotations

import numpy as np

from safety_harness.base.elementary import product
from safety_harness.claims.properties.base import runs_of
from safety_harness.claims.properties.servoing import (
    CONVERGED,
    GAIN_SWITCH,
    GAIN_SWITCH_ITERATIONS,
    GAIN_SWITCH_WITHIN,
)
from safety_harness.claims.signals.poses import position_errors_m
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

TCP, HAND = "transform_tcp_to_base", "hand_position_in_base_m"
OF_THE_GOAL = (GAIN_SWITCH, GAIN_SWITCH_WITHIN, GAIN_SWITCH_ITERATIONS, CONVERGED)
CAUSE_REACH = 1.5  # a hand may cause a retreat within so many critical distances; a retreat ends beyond one
RETREATED_M = 0.01  # least way of a retreat from the desired position; braking after one takes below 1 mm


def refuse_retreat_while_servoing(trace: Trace, log: CellLog) -> None:
    """Raise LogError where the arm retreats from a near hand while its reported mode is servoing.

    The check assumes that the arm approaches the desired pose, so it applies only if a claim is about this
    pose. Servoing brings the TCP nearer to the desired position. The arm retreats if the TCP certainly moves
    away from this position, and also away from a hand at about the critical distance.
    """
    known, ticks, stream = trace.known, trace.ticks, log.told.mode
    aims = any(entry.understands(claim.sentence) for claim in trace.scenario.claims for entry in OF_THE_GOAL)
    if not aims or stream is None or known.missing([TCP, HAND]) or not trace.scenario.hands:
        return
    servoing = known.measured("mode", ticks) & (ticks["mode"] == Mode.SERVOING)
    servoing &= known.measured(TCP, ticks) & known.measured(HAND, ticks).all(axis=1)
    tcp_off_m, hand_off_m = (known.uncertainty_of(name, len(ticks)) for name in (TCP, HAND))
    far_m = position_errors_m(trace)
    tcp_m = true_motion(trace).tcp_m
    from_hands_m = tcp_m[:, None] - ticks[HAND]
    apart_m = np.where(ticks["hand_present"], np.linalg.norm(from_hands_m, axis=2), np.inf)
    hand_m = apart_m.min(axis=1)
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    is_near = hand_m - tcp_off_m - hand_off_m < CAUSE_REACH * critical_m
    for first, stop in zip(*runs_of(servoing & is_near), strict=True):
        least_m = np.minimum.accumulate((far_m + tcp_off_m)[first:stop])
        away = (far_m - tcp_off_m)[first:stop] - least_m > RETREATED_M
        if not away.any():
            continue
        end = first + int(np.argmax(away))
        begin = first + int(np.argmin((far_m + tcp_off_m)[first : end + 1]))
        if product(tcp_m[end] - tcp_m[begin], from_hands_m[begin, apart_m[begin].argmin()]) > 0.0:
            at = int(np.searchsorted(stream.time_ns, log.origin_ns + end * log.period_ns, side="right")) - 1
            raise stream.samples.error(
                at,
                f"the TCP no farther from the desired position than the {far_m[begin] * 1e3:.4g} mm at "
                f"{trace.time_s[begin]:.3f} s, as the mode is servoing all the while",
                f"{far_m[end] * 1e3:.4g} mm at {trace.time_s[end]:.3f} s by the joints, away from a hand "
                f"{hand_m[begin] * 1e3:.4g} mm from it",
                "a controller that reports one mode only? then leave the mode out; or settings: {cell: ...}",
            )
