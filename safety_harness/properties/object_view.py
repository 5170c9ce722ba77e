"""The servoing camera keeps the object in view, or has it back soon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.properties.base import (
    Evaluation,
    Unit,
    inconclusive,
    judged,
    runs_of,
    time_left_s,
    unreadable,
)
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.scenario.units import TIME
from safety_harness.trace.trace import Trace

MOVES_MPS = 1e-3


@dataclass(frozen=True, kw_only=True)
class ObjectInView:
    """``within_s`` less the longest time in which the last image did not show the whole object.

    Before the first image it is not in view.  A loss that lasts to the end of the run, and not yet
    longer than the limit, leaves open whether the object is recovered in time.
    """

    within_s: float
    unit: Unit = Unit.TIME

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"object in view or recovered within {self.within_s:g} s"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every loss from its first tick to that of the recovery."""
        problem = unreadable(trace, ("tcp_speed_mps",))
        if problem is not None:
            return inconclusive(self, problem)
        lost = ~trace.ticks["object_visible"]
        begins, ends = runs_of(lost)
        times_s = trace.time_s
        lasted = np.minimum(ends, len(lost) - 1) - begins  # in ticks
        worst = int(np.argmax(lasted)) if len(begins) else 0
        longest_s = float(times_s[lasted[worst]]) if len(begins) else 0.0
        margin_s = time_left_s(trace, self.within_s, int(lasted[worst]) if len(begins) else 0)
        begun_s = float(times_s[begins[worst]]) if len(begins) else 0.0
        exercised = int(np.count_nonzero(lost | (trace.ticks["tcp_speed_mps"] > MOVES_MPS)))
        if bool(lost[-1]) and margin_s >= 0.0:
            left_s = float(times_s[-1] - times_s[begins[-1]])
            return inconclusive(
                self,
                f"the object has been out of view for {left_s:.2f} s when the run ends",
                exercised=exercised,
            )
        return judged(
            self,
            trace,
            margin=margin_s,
            worst_time_s=begun_s + min(longest_s, self.within_s),
            reason=_words(len(begins), longest_s),
            exercised=exercised,
        )


def _words(losses: int, longest_s: float) -> str:
    if losses == 0:
        return "in view all the time"
    often = "once, for" if losses == 1 else f"{losses} times, longest"
    return f"out of view {often} {longest_s:.2f} s"


OBJECT_IN_VIEW = CatalogueEntry(
    example="object in view or recovered within 2 s",
    pattern=r"object in view or recovered within (.+)",
    make=lambda match, _, place: ObjectInView(within_s=quantity(match[1], TIME, place)),
    unit=Unit.TIME,
    rationale="servoing is blind without the object: giving way must not end the task",
    source="the paper, section 3: the features are of an object that is seen whole",
    margin="the limit less the longest time from the image that lost the object to one that shows it whole",
    parameters="the time allowed",
    exercised="the TCP moves, or the object is out of view",
    inconclusive="a loss that lasts to the end of the run and is not yet longer than the limit",
    scenario="fault-camera-hidden-by-a-hand",
    broken_by="an avoider that goes sideways on and on, behind a gate that passes everything",
)
