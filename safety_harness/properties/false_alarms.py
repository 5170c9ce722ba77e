"""Nobody there, no giving way: false alarms cost time, and trust."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit, begins_at, inconclusive, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.properties.reaction import gives_way
from safety_harness.properties.true_motion import nearest_hand_m
from safety_harness.scenario.moves import REACHING_MPS
from safety_harness.scenario.units import LENGTH
from safety_harness.settings import Settings
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace, once_a_trace


@dataclass(frozen=True, kw_only=True)
class NoFalseAlarms:
    """The limit less the distance of the nearest true hand from the TCP whenever the arm gives way.

    Asked where repulsion or a protective stop begins, and at every decision; not while they last, for
    a hand may leave before they end, nor of stops at a singularity.  The limit is ``within_m``, else the
    critical distance and what a hand at 2 m/s covers within the prediction horizon: a right prediction
    can be that far ahead.  A hand farther than twice the limit, or none, counts as twice the limit;
    where the arm never gave way the margin is the limit.

    Exercised by every tick without a true hand within the limit.
    """

    within_m: float | None = None
    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        words = "never gives way without a hand"
        return words if self.within_m is None else f"{words} within {self.within_m * 1e3:g} mm"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every beginning of giving way."""
        problem = unreadable(trace, ("transform_tcp_to_base", "hand_position_in_base_m"))
        if problem is not None:
            return inconclusive(self, problem)
        limit_m = self.limit_m(trace.scenario.settings)
        nearest_m = np.minimum(nearest_hand_m(trace), 2.0 * limit_m)
        alarms = beginnings(trace)
        worst = int(alarms[np.argmax(nearest_m[alarms])]) if len(alarms) else 0
        reason = "the arm never gave way"
        if len(alarms):
            far = nearest_m[worst] >= 2.0 * limit_m
            reason = "nobody" if far else f"nearest hand {nearest_m[worst] * 1e3:.1f} mm from the TCP"
            reason += f", worst of {len(alarms)} alarms" if len(alarms) > 1 else ""
        return judged(
            self,
            trace,
            margin=limit_m - float(nearest_m[worst]) if len(alarms) else limit_m,
            worst_time_s=float(trace.time_s[worst]),
            reason=reason,
            exercised=int(np.count_nonzero(nearest_m > limit_m)),
        )

    def limit_m(self, settings: Settings) -> float:
        """How far a hand may be that the arm gives way to."""
        if self.within_m is not None:
            return self.within_m
        horizon_s = settings.hand_filter.prediction_horizon_s
        return settings.avoidance.critical_distance_m + REACHING_MPS * horizon_s


@once_a_trace
def beginnings(trace: Trace) -> NDArray[np.int64]:
    """The ticks (k,) at which the arm begins to give way or decides to, stops at a singularity apart."""
    begins = begins_at(gives_way(trace))
    begins &= trace.ticks["limits"] & int(Limit.SINGULARITY) == 0
    begins[trace.decisions["tick"]] = True
    return np.flatnonzero(begins)


def _entry(prop: NoFalseAlarms, parameters: str) -> CatalogueEntry:
    return CatalogueEntry(
        example=prop.sentence,
        pattern=prop.sentence,
        make=lambda *_: prop,
        unit=prop.unit,
        rationale="an arm that gives way to nobody loses time, and people then switch its avoidance off",
        source="the project's own",
        margin="the limit less the distance of the nearest true hand from the TCP when giving way begins",
        parameters=parameters,
        exercised="no true hand is within the limit, for a tick at least",
        inconclusive="-",
        scenario="fault-false-hand",
        broken_by="a controller whose own critical distance is too long",
    )


FALSE_ALARMS = _entry(
    NoFalseAlarms(), "critical distance and prediction horizon of the settings, hands of at most 2 m/s"
)
FALSE_ALARMS_WITHIN = replace(
    _entry(NoFalseAlarms(within_m=0.6), "the limit"),
    pattern=r"never gives way without a hand within (.+)",
    make=lambda match, _, place: NoFalseAlarms(within_m=quantity(match[1], LENGTH, place)),
)
