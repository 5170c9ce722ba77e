"""The task gets on: hands may interrupt it, but not for ever."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, time_left_s, unreadable
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.properties.servoing import pose_errors
from safety_harness.scenario.units import TIME
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace, history

LEAST_GAIN_M = 1e-3  # nearer by less is not getting on (metres and radians together, as in eq. 15)
LEAST_SHARE = 0.1  # of the closed form's rate, with which servoing gets on


@dataclass(frozen=True, kw_only=True)
class NeverStarved:
    """``longest_s`` less the longest time that the task was starved.

    The error is eq. 15's for the true pose, (distance^2 + angle^2)^(1/2) in metres and radians; below the
    root of the gain switch the task is done.  Time is lost at every tick at which it is not done and the
    controller does not servo, or does with less than a tenth of the closed form's rate lambda |e|.  What
    was lost is made good when the error is 1 mm smaller than ever since the task was last done: so a
    system that servoes and gives way in turns, without ever getting nearer, starves.
    """

    longest_s: float
    unit: Unit = Unit.TIME

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"task never starved longer than {self.longest_s:g} s"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the whole run."""
        problem = unreadable(trace, ("transform_tcp_to_base",))
        if problem is not None:
            return inconclusive(self, problem)
        if time_left_s(trace, self.longest_s, len(trace.ticks) - 1) >= 0.0:
            return inconclusive(self, "the run is not longer than the task may starve")
        lost, away = lost_ticks(trace)
        worst = int(np.argmax(lost))
        margin_s = time_left_s(trace, self.longest_s, int(lost[worst]))
        if lost[-1] > 0 and margin_s >= 0.0:
            open_s = trace.time_s[lost[-1]]
            return inconclusive(
                self, f"starved for {open_s:.2f} s when the run ends", exercised=int(away.sum())
            )
        return judged(
            self,
            trace,
            margin=margin_s,
            worst_time_s=float(trace.time_s[worst]),
            reason=f"longest {trace.time_s[lost[worst]]:.2f} s",
            exercised=int(np.count_nonzero(away)),
        )


def lost_ticks(trace: Trace) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(n,) for how many ticks the task has been starved at each tick, and (n,) whether it is not done."""
    settings = trace.scenario.settings
    distance_m, angle_rad = pose_errors(trace)
    error = np.hypot(distance_m, angle_rad)
    done_below = float(np.sqrt(settings.servo.gain_switch_sse))
    lost = np.zeros(len(error), np.int64)
    _lose(
        error,
        history(trace, "mode") == Mode.SERVOING,
        done_below,
        LEAST_SHARE * settings.servo.gain_far * settings.clock.control_period_s,
        lost,
    )
    return lost, error >= done_below


@compiled
def _lose(
    error: NDArray[np.float64],  # (n,)
    servoing: NDArray[np.bool_],  # (n,)
    done_below: float,
    least_share: float,  # of the error, in one tick
    lost: NDArray[np.int64],  # (n,), written
) -> None:
    best = error[0]
    for k in range(1, error.shape[0]):
        if error[k] < done_below:
            best, lost[k] = done_below, 0
        elif error[k] < best - LEAST_GAIN_M:
            best, lost[k] = error[k], 0
        else:
            on = servoing[k] and error[k - 1] - error[k] >= least_share * error[k]
            lost[k] = lost[k - 1] + (not on)


NEVER_STARVED = CatalogueEntry(
    example="task never starved longer than 10 s",
    pattern=r"task never starved longer than (.+)",
    make=lambda match, _, place: NeverStarved(longest_s=quantity(match[1], TIME, place)),
    unit=Unit.TIME,
    rationale="an arm that stays away for good is safe and of no use, and people will switch its safety off",
    source="the paper, section 5: servoing is taken up again and converges after giving way",
    margin="the limit less the longest time lost, above eq. 15's threshold, without servoing towards the "
    "desired pose, since the TCP was last nearer to it than before",
    parameters="the time allowed; the gain switch and the far gain of the settings",
    exercised="the TCP is farther off than the gain switch, in a run that is longer than the limit",
    inconclusive="the run is not longer than the limit, or ends while the task is starved",
    scenario="hand-visits-and-leaves",
    broken_by="a controller that does nothing",
)
