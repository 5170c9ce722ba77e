"""Compare the filter's predictions with the hands at the predicted time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from safety_harness.claims.properties.base import Evaluation, Unit, Worded, inconclusive, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import no_hand
from safety_harness.claims.signals.predictions import prediction_errors_m, tracked_errors_m
from safety_harness.trace.trace import Trace

FILLED = ("track_valid", "predicted_hand_in_base_m")  # what was told then may be anything


@dataclass(frozen=True, kw_only=True)
class HandPredictions(Worded):
    """The claim that every prediction is within ``maximum_m`` of a true hand.

    The margin is ``maximum_m`` minus the largest distance of a prediction from the nearest true hand at the
    predicted time. A prediction made at the time t estimates the position of a hand's centre at t plus the
    horizon. The true hands at that time are interpolated linearly between two ticks. Each prediction is
    compared with the nearest true hand. Predictions for times after the run are not compared.
    """

    maximum_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "hand predictions within {maximum_m:mm}"

    @reads("hand_position_in_base_m", filled=FILLED, ends=lambda prop, trace, _: _ends(prop, trace))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every prediction of every tracked hand."""
        if not trace.scenario.hands:
            return unexercised(self, no_hand(trace))
        errors_m = tracked_errors_m(trace)  # (k, tracks)
        found_m = errors_m[trace.ticks["track_valid"][: len(errors_m)]]
        if not np.isfinite(found_m).all():
            tick = int(np.argmax((np.isnan(errors_m) | np.isposinf(errors_m)).any(axis=1)))
            return inconclusive(self, f"a prediction is not finite from {trace.time_s[tick]:.3f} s")
        if len(found_m) == 0:
            return unexercised(self, self._untracked(trace))
        tick, track = divmod(int(errors_m.argmax()), errors_m.shape[1])
        found_m.sort()
        median_m = 0.5 * (found_m[(len(found_m) - 1) // 2] + found_m[len(found_m) // 2])
        horizon_s = trace.scenario.settings.hand_filter.prediction_horizon_s
        then_s, error_m = trace.time_s[tick] + horizon_s, errors_m[tick, track]
        reason = (
            f"predicted for {then_s:.3f} s, off by {error_m * 1e3:.1f} mm; median {median_m * 1e3:.1f} mm"
        )
        return judged(self, trace, self.maximum_m - error_m, trace.time_s[tick], reason, len(found_m))

    def _untracked(self, trace: Trace) -> str:
        horizon_ms = trace.scenario.settings.hand_filter.prediction_horizon_s * 1e3
        seen = np.flatnonzero(trace.ticks["track_valid"].any(axis=1))
        tracked = f"first tracked at {trace.time_s[seen[0]]:.3f} s" if len(seen) else "never tracked"
        return f"a hand was {tracked}; one tracked {horizon_ms:g} ms before the end of the run exercises it"


def _ends(prop: HandPredictions, trace: Trace) -> tuple[float, float, bool]:
    """Return the margin's bounds.

    At the predicted time, the true hand may be anywhere within its error.
    """
    errors_m, known, ticks = prediction_errors_m(trace), trace.known, trace.ticks
    count, ahead = len(errors_m), len(ticks) - len(errors_m)
    hand_m = known.uncertainty_of("hand_position_in_base_m", len(ticks))
    later_m = np.maximum(hand_m[ahead:], np.append(hand_m[ahead + 1 :], hand_m[-1:]))[:count]
    before_m = hand_m[max(ahead - 1, 0) :][:count]
    off_m = known.uncertainty_of("predicted_hand_in_base_m", len(ticks))[:count] + np.maximum(
        later_m, before_m
    )
    there = ticks["track_valid"][:count]
    known_ticks = known.measured("track_valid", ticks)[:count] & known.measured(FILLED[1], ticks)[:count]
    sure = there & known_ticks[:, None]
    if not sure.any():
        return -np.inf, np.inf, False
    low = prop.maximum_m - float((errors_m + off_m[:, None])[sure].max())
    high = prop.maximum_m - float((errors_m - off_m[:, None])[sure].max())
    return (low if known_ticks.all() else -np.inf), high, True


HAND_PREDICTIONS = CatalogueEntry(
    prop=HandPredictions(maximum_m=0.05),
    rationale="the arm retreats from the predicted hand, so an error of the prediction is also an "
    "error of the distance",
    source="the paper, eqs. 7 and 8: a Kalman filter for the hand's box, extrapolated by the horizon",
    margin=(
        "the limit minus the greatest error of a prediction, which is its distance from the "
        "nearest true hand at the predicted time. For a track without a real hand, the error "
        "is also the distance from the nearest true hand"
    ),
    parameters="the limit; the prediction horizon in the settings",
    exercised="the tracker predicts a hand for a time within the run",
    inconclusive="the scenario has no hand, or the tracker follows none",
    broken_by="a hand sensor that sees a hand where there is none",
)
