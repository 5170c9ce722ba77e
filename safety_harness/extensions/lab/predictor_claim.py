"""Check that the predicted sets contain every hand at one random instant of each run.

A predicted set that contains the hand in 95 % of all cases misses the hand in 5 %.  A single run therefore
shows little, and a plan bounds the fraction of runs in which the sets miss a hand.  The instants within a run
are not independent.  The claim therefore evaluates only one instant of each run, which the run's seed selects
at random with equal probabilities.  Runs with independent seeds are then independent trials, and the exact
bound of a campaign applies to the fraction of misses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.seeds import Branch, generator
from safety_harness.claims.properties.base import Evaluation, Unit, Worded, inconclusive, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import no_hand
from safety_harness.claims.signals.predictions import predicted_at
from safety_harness.trace.trace import Trace

Ends = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
HANDS = "hand_position_in_base_m"
NO_SET = -1.0  # the limit of (1 - g)/(1 + g), for a hand that the predictor does not expect at all


@dataclass(frozen=True, kw_only=True)
class HeldBySets(Worded):
    """A claim about predicted sets: they contain every hand at one random instant of a run.

    The margin is the least (1 - g)/(1 + g) over the hands at this instant. Here g is the hand's smallest
    gauge over all predicted sets.

    The gauge of a hand is 0 at a set's centre and 1 on its surface, and it grows linearly along each ray. The
    predictor's output at time t is a prediction for the time t plus the horizon. The claim interpolates the
    true hands at this later time linearly between two ticks. It ignores a set whose half width exceeds
    ``most_m`` along an axis of the base, because a set that fills the room would contain every hand. The
    claim evaluates only hands that have been present for ``since_s``. It draws the instant from all instants
    with such a hand.
    """

    most_m: float
    since_s: float
    unit: Unit = Unit.FRACTION
    wording: ClassVar[str] = (
        "predicted sets of at most {most_m:mm} hold each hand that has been there for {since_s:ms}, "
        "at a drawn instant"
    )

    @reads(HANDS, also=["track_valid", "predicted_hand_in_base_m"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Evaluate the claim at the random instant that the run's seed selects."""
        if not trace.scenario.predictor:
            return inconclusive(self, "the scenario has no predictor")
        if not trace.scenario.hands:
            return unexercised(self, no_hand(trace))
        ends = _ends_of_horizon(trace)
        gauges = _gauges(trace, ends, self.most_m)  # (k, hands)
        counts = self._counts(trace, ends)
        instants = np.flatnonzero(counts.any(axis=1))
        if len(instants) == 0:
            return unexercised(self, f"no hand was there for {self.since_s * 1e3:g} ms and the horizon")
        draw = generator(trace.scenario.seed, Branch.PREDICTED_INSTANT)
        tick = int(instants[draw.integers(len(instants))])
        gauge = float(gauges[tick][counts[tick]].max())
        margin = (1.0 - gauge) / (1.0 + gauge) if np.isfinite(gauge) else NO_SET
        held = (gauges <= 1.0)[counts].mean()
        reason = f"drawn instant {trace.time_s[tick]:.3f} s: {_size_words(trace, tick)}"
        reason += f"; the sets hold the hand at {held:.1%} of all instants{_lateness(trace, gauges)}"
        return judged(self, trace, margin, trace.time_s[tick], reason, len(instants))

    def _counts(self, trace: Trace, ends: Ends) -> NDArray[np.bool_]:
        """Return whether the claim evaluates a hand at a tick, shape (k, hands).

        The hand must have been present for ``since_s``, and must still be present at the end of the horizon.
        """
        present = trace.ticks["hand_present"][:, : len(trace.scenario.hands)].astype(np.bool_)
        ticks = np.arange(len(present))[:, None]
        # The latest tick at which the hand was absent, or -1.
        absent = np.maximum.accumulate(np.where(present, -1, ticks), axis=0)
        since = self.since_s / trace.scenario.settings.clock.control_period_s
        long = present & (ticks - absent - 1 >= since - 1e-9)
        start, later, _ = ends
        return np.asarray(long[: len(start)] & present[start] & present[later])


def _ends_of_horizon(trace: Trace) -> Ends:
    """Return the ticks around the end of each prediction horizon, and interpolation weights, shape (k,) each.

    The function uses the k ticks whose horizon ends within the trace.  The first two arrays contain the ticks
    just before and just after the end of the horizon.

    The third array contains the weight of the later tick in a linear interpolation.
    """
    at = predicted_at(trace)
    start = at.astype(np.int64)
    part = np.asarray(at - start, dtype=np.float64)
    return start, start + (part > 0.0), part


def _gauges(trace: Trace, ends: Ends, most_m: float) -> NDArray[np.float64]:
    """Return the smallest gauge of each true hand over the sets predicted for its time, shape (k, hands).

    The gauge is infinite if there is no such set.

    The function ignores sets with a half width above ``most_m``.  Here k is the number of ticks whose
    predictions are for times within the trace.
    """
    ticks, sets = trace.ticks, trace.predicted
    start, later, part = ends
    count, share = len(start), part[:, None, None]
    hands_m = ticks[HANDS][:, : len(trace.scenario.hands)]
    true_m = hands_m[start] * (1.0 - share) + hands_m[later] * share
    gauges = np.full(true_m.shape[:2], np.inf)
    for track in range(ticks["track_valid"].shape[1]):
        there = np.flatnonzero(ticks["track_valid"][:count, track])
        if len(there) == 0:
            continue
        off_m = true_m[there] - ticks["predicted_hand_in_base_m"][there, track][:, None]
        shape_m2 = sets["shape_m2"][there, track]
        widths_m = np.sqrt(np.diagonal(shape_m2, axis1=1, axis2=2))[:, None]
        in_box = np.abs(off_m / widths_m).max(axis=2)
        own = np.where(sets["box"][there, track][:, None], in_box, _in_ellipsoids(shape_m2, off_m))
        own = np.where(widths_m.max(axis=2) <= most_m, own, np.inf)
        gauges[there] = np.minimum(gauges[there], own)
    return gauges


def _in_ellipsoids(shape_m2: NDArray[np.float64], off_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the gauges sqrt(d' S^-1 d), shape (k, hands).

    Here d is a row of ``off_m``, which has the shape (k, hands, 3), and S is the matrix in ``shape_m2``,
    which has the shape (k, 3, 3).

    The function inverts S by cofactors, because the result is then bit-identical on all machines.  A
    library's solver does not guarantee this.
    """
    s, (x, y, z) = shape_m2, np.moveaxis(off_m, 2, 0)
    xx, yy, zz = (
        s[:, 1, 1] * s[:, 2, 2] - s[:, 1, 2] * s[:, 1, 2],
        s[:, 0, 0] * s[:, 2, 2] - s[:, 0, 2] * s[:, 0, 2],
        s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] * s[:, 0, 1],
    )
    xy = s[:, 0, 2] * s[:, 1, 2] - s[:, 0, 1] * s[:, 2, 2]
    xz = s[:, 0, 1] * s[:, 1, 2] - s[:, 0, 2] * s[:, 1, 1]
    yz = s[:, 0, 1] * s[:, 0, 2] - s[:, 0, 0] * s[:, 1, 2]
    det = (s[:, 0, 0] * xx + s[:, 0, 1] * xy + s[:, 0, 2] * xz)[:, None]
    own = xx[:, None] * x * x + yy[:, None] * y * y + zz[:, None] * z * z
    mixed = xy[:, None] * x * y + xz[:, None] * x * z + yz[:, None] * y * z
    return np.asarray(np.sqrt(np.maximum((own + 2.0 * mixed) / det, 0.0)))


def _size_words(trace: Trace, tick: int) -> str:
    """Return a text with the half widths of the sets at a tick, beginning with the largest set."""
    there = trace.ticks["track_valid"][tick]
    squares_m2 = np.diagonal(trace.predicted["shape_m2"][tick][there], axis1=1, axis2=2)
    sizes = sorted((np.sqrt(row) * 1e3 for row in squares_m2), key=lambda widths: -float(widths.max()))
    texts = (" x ".join(f"{width:.0f}" for width in widths) + " mm" for widths in sizes)
    return "half widths " + ", ".join(texts) if sizes else "no set"


def _lateness(trace: Trace, gauges: NDArray[np.float64]) -> str:
    """Return a text with the longest delay, over all hands, until a set first contained the hand.

    The delay begins when the hand appears.  The text is empty if some hand was in no set at any tick.
    """
    late_s = 0.0
    for hand in range(gauges.shape[1]):
        there = np.flatnonzero(trace.ticks["hand_present"][: len(gauges), hand])
        held = there[gauges[there, hand] <= 1.0]
        if len(held) == 0:
            return ""
        late_s = max(late_s, float(trace.time_s[held[0]] - trace.time_s[there[0]]))
    return f", first {late_s * 1e3:.0f} ms after it came"


HELD_BY_SETS = CatalogueEntry(
    prop=HeldBySets(most_m=0.4, since_s=0.2),
    rationale="a controller that keeps out of a predicted set assumes that the set contains the hand",
    source="split conformal prediction: the coverage of a set is a fraction of independent cases",
    margin=(
        "(1 - g)/(1 + g) with the gauge g of the hand in its nearest set (0 at the centre, 1 "
        "on the surface), the least value over the hands at the drawn instant. The margin is "
        "-100 % for a hand without a set, even if the sensor does not see the hand"
    ),
    parameters=(
        "the greatest half width of a set that counts; the time for which a hand must be "
        "present before it counts; the prediction horizon in the settings"
    ),
    exercised=(
        "a hand has been present for the stated time, and is still present at the end of the "
        "horizon, within the run"
    ),
    inconclusive="the scenario has no predictor",
    broken_by="a predictor whose sets are too small, or that loses the hand",
)
