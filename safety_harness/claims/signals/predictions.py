"""Compute the errors of predicted hands: the distances from the true hands at the predicted time."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.trace.trace import Trace


def predicted_at(trace: Trace) -> NDArray[np.float64]:
    """Return, in ticks, the time to which the prediction of each tick refers, shape (k,).

    Times after the trace are left out.
    """
    settings = trace.scenario.settings
    ahead = settings.hand_filter.prediction_horizon_s / settings.clock.control_period_s
    at = np.arange(len(trace.ticks), dtype=np.float64) + ahead
    return np.asarray(at[at <= len(trace.ticks) - 1])


def prediction_errors_m(trace: Trace) -> NDArray[np.float64]:
    """Return the distance [m] of each prediction from the nearest true hand, shape (k, tracks).

    The positions of the true hands are those at the predicted time. Only ticks whose predicted time lies
    within the trace are used, and k is the number of these ticks. The distance is NaN if a slot tracks no
    hand.
    """
    at = predicted_at(trace)
    predicted_m, hands_m = trace.ticks["predicted_hand_in_base_m"], true_motion(trace).hands_m
    errors_m = np.empty((len(at), predicted_m.shape[1]))
    _errors(predicted_m, hands_m, len(trace.scenario.hands), at, errors_m)
    return errors_m


def tracked_errors_m(trace: Trace) -> NDArray[np.float64]:
    """Return the distances of ``prediction_errors_m``, shape (k, tracks).

    If a slot tracks no hand, its distance is -inf.
    """
    errors_m = prediction_errors_m(trace)
    return np.where(trace.ticks["track_valid"][: len(errors_m)], errors_m, -np.inf)


@compiled
def _errors(
    predicted_m: NDArray[np.float64],  # (k or more, tracks, 3)
    hands_m: NDArray[np.float64],  # (n, hands or more, 2, 3)
    hands: int,
    at: NDArray[np.float64],  # (k,) what the predictions are for, in ticks
    errors_m: NDArray[np.float64],  # (k, tracks), written
) -> None:
    """Write the least |predicted - true| [m] over the hands into ``errors_m``.

    The true hands are interpolated at the times ``at``.
    """
    last = hands_m.shape[0] - 1
    for k in range(at.shape[0]):
        start = int(at[k])
        stop, part = min(start + 1, last), at[k] - start
        for track in range(errors_m.shape[1]):
            nearest = np.inf
            for hand in range(hands):
                total = 0.0
                for i in range(3):
                    true = hands_m[start, hand, 0, i] * (1.0 - part) + hands_m[stop, hand, 0, i] * part
                    total += (predicted_m[k, track, i] - true) ** 2
                distance_m = sqrt(total)
                if not distance_m >= nearest:
                    nearest = distance_m
                # A NaN must be the result, so that the claim becomes inconclusive.
                if np.isnan(distance_m):
                    break
            errors_m[k, track] = nearest
