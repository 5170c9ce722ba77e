"""Check that servoing reaches the gain switch, and then its goal, after the hands have left.

Further claims judge that the task does not pause too long, and that the camera sees the object. The claims on
the gain switch and on the goal compare servoing with the closed-form solution of eq. 1 for the correct
interaction matrix. The closed form's error decays as exp(-lambda t) with the gain lambda, so it falls from d
to a threshold c in ln(d/c)/lambda seconds. A run that ends before the allowed time is not evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import exp, hypot, log
from safety_harness.base.settings import CONVERGED_ANGLE_RAD, CONVERGED_POSITION_M
from safety_harness.claims.properties.base import (
    Evaluation,
    Unit,
    Worded,
    inconclusive,
    judged,
    runs_of,
    time_left_s,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import columns_read_by, only_whole, reads
from safety_harness.claims.properties.reaction import nearest_off_m
from safety_harness.claims.signals.occasions import MOVES, OFF_THE_GOAL, millimetres, tcp_stood
from safety_harness.claims.signals.poses import pose_errors, position_errors_m
from safety_harness.claims.signals.true_motion import nearest_hand_m
from safety_harness.scenario.model import Verdict
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace, history, once_a_trace

ALLOWANCE = 1.25  # times the closed form, for the limits and the other five features
GRACE_S = 1.0  # for getting up to speed
ROUNDED_UP_S = 0.1  # ``longer`` prints tenths of a second, and the printed duration must suffice
LEAST_GAIN_M = 1e-3  # a smaller approach is no progress (metres and radians together, as in eq. 15)
CAUSE_REACH = 1.5  # critical distances within which a hand may cause a retreat, which leads beyond one
STANDS_S = 5.0  # without getting on, and it does not converge
LEAST_SHARE = 0.1  # of the closed form's rate: servoing at less is no progress


def retreat_s(trace: Trace) -> float:
    """Return how long [s] the arm may still retreat or stand after the last hand has left."""
    avoidance = trace.scenario.settings.avoidance
    speed_mps, most_mps2 = avoidance.repulsion_speed_mps, avoidance.repulsion_acceleration_mps2
    return avoidance.restart_delay_s + avoidance.radius_m / speed_mps + speed_mps / most_mps2


@once_a_trace
def left_at(trace: Trace) -> int | None:
    """Return the tick from which the arm is free for its task, or None if there is no such tick.

    The tick is found by the motion of arm and hands alone. After this tick, no true hand is within the
    critical distance of the TCP. Also, the TCP does not move away from the desired pose while a hand is
    within CAUSE_REACH times that distance. For a further ``retreat_s``, the arm may stand or retreat. The
    result is the tick of this period at which the TCP is farthest from the desired pose; if there are
    several, it is the last.
    """
    settings, error = trace.scenario.settings, hypot(*pose_errors(trace))
    nearest_m, critical_m = nearest_hand_m(trace), settings.avoidance.critical_distance_m
    period_s = settings.clock.control_period_s
    away = np.diff(error, prepend=error[0]) > 10.0 * MOVES * period_s
    busy = np.flatnonzero((nearest_m < critical_m) | (away & (nearest_m < CAUSE_REACH * critical_m)))
    if len(busy) == 0:
        return 0
    if (first := int(busy[-1]) + 1) == len(error):
        return None
    rest = error[first : first + round(retreat_s(trace) / period_s)]
    return first + int(np.flatnonzero(rest >= rest.max() - LEAST_GAIN_M)[-1])


def busy_to_the_end(trace: Trace) -> str:
    """Return a text about the hand that kept the arm from servoing until the end of the run."""
    critical_m, left_m = trace.scenario.settings.avoidance.critical_distance_m, nearest_hand_m(trace)[-1]
    hand_near = f"a hand is near to the end: {millimetres(left_m, critical_m)} from the TCP"
    # The arm may still retreat from a hand just outside the critical distance.
    beyond_m = critical_m if left_m < critical_m else CAUSE_REACH * critical_m
    return f"{hand_near}; beyond {beyond_m * 1e3:g} mm, or a longer duration, exercises it"


@dataclass(frozen=True, kw_only=True)
class GainSwitchReached(Worded):
    """The claim that the error of eq. 15 falls below the gain switch in time after the last hand left.

    The margin is the allowed time minus the time until the error falls below the switch. If the error stays
    above the switch, the time until the end of the run is used. The allowed time is ``within_s``. By default,
    it is 1.25 times the closed form ln(|e|/sqrt(c))/lambda, plus 1 s. Here e is the error when the last hand
    leaves, c is the gain switch and lambda is the far gain. While the camera does not see the object, the
    error is not below the switch.

    A run exercises the claim if the error is above the switch after the last hand has left. An error that is
    already below the switch at that time is not a result of the servoing that the claim judges.
    """

    within_s: float | None = None
    unit: Unit = Unit.TIME

    @property
    def wording(self) -> str:
        """Return the wording of the sentence, with the allowed time if ``within_s`` is given."""
        return "gain switch reached" + " within {within_s:s}" * (self.within_s is not None)

    @only_whole()
    @reads("transform_tcp_to_base", "hand_position_in_base_m", also=["sse"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the first crossing after the hands have left."""
        first = left_at(trace)
        if first is None:
            return inconclusive(self, busy_to_the_end(trace))
        servo = trace.scenario.settings.servo
        sse = history(trace, "sse")[first:]
        errors = np.where(
            np.isfinite(sse), sse, np.square(position_errors_m(trace)[first:])
        )  # unseen: as if upright
        allowed_s = self.within_s
        if allowed_s is None:
            ratio = max(float(errors[0]) / servo.gain_switch_sse, 1.0)
            allowed_s = ALLOWANCE * 0.5 * float(log(ratio)) / servo.gain_far + GRACE_S
        below = np.flatnonzero(np.isfinite(sse) & (sse < servo.gain_switch_sse))
        above = errors[: below[0] if len(below) else None] >= servo.gain_switch_sse
        took = int(below[0]) if len(below) else len(trace.ticks) - 1 - first  # in ticks
        took_s, left_s = float(trace.time_s[took]), time_left_s(trace, allowed_s, took)
        allowed = f"{allowed_s:.2f} s were allowed"
        if len(below) == 0 and left_s >= 0.0:
            ends = f"the run ends {took_s:.2f} s after the hands have left; {allowed_s:.2f} s are allowed"
            return inconclusive(self, f"{ends}: {longer(trace, left_s)}")
        reason = f"not reached in {took_s:.2f} s; {allowed}"
        if len(below):
            reason = f"reached {took_s:.2f} s after the hands had left; {allowed}"
        if not above.any():
            reason = (
                f"below the switch already when the hands had left: |f - f*|^2 = {errors[0]:.2g}; at least "
            )
            reason += f"{servo.gain_switch_sse:g} then exercises it, with the TCP farther off"
        exercised = int(above.any())
        return judged(self, trace, left_s, trace.time_s[first + took], reason, exercised, revocable=True)


def longer(trace: Trace, lacked_s: float) -> str:
    """Return a text that states how long a run must be to decide the claim."""
    duration_s = trace.scenario.duration_s + lacked_s + ROUNDED_UP_S
    return f"a duration of {duration_s:.1f} s exercises it if no hand comes near again"


@dataclass(frozen=True, kw_only=True)
class Converged:
    """The claim that the TCP ends within 1 mm and 0.1 degree of the desired pose.

    The image features are not considered. The margin is 1 mm minus the distance from the desired pose at the
    end. If the angle is too large, the margin is at most minus the displacement that the excess angle causes
    at the camera's desired depth. A run is inconclusive if it is shorter than the time that the closed form
    needs with both gains. This does not apply if the TCP has already converged, or hardly came nearer in the
    last 5 s. Only the motion is judged, not the reported mode.

    A run exercises the claim if the TCP was outside these limits at any tick, so that servoing has a distance
    to cover. A run whose TCP is within the limits from beginning to end is not evidence.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "converged to the desired pose"

    @only_whole()
    @reads(
        "transform_tcp_to_base",
        "hand_position_in_base_m",
        ends=lambda _, trace, margin: _converged_ends(trace, margin),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the TCP's pose at the last tick."""
        first = left_at(trace)
        if first is None:
            return inconclusive(self, busy_to_the_end(trace))
        (position, angle), settings = pose_errors(trace), trace.scenario.settings
        needed_s = self._needed_s(trace, float(hypot(position[first], angle[first])))
        had_s = float(trace.time_s[-1] - trace.time_s[first])
        margin = CONVERGED_POSITION_M - float(position[-1])
        if angle[-1] > CONVERGED_ANGLE_RAD:
            depth_m = settings.cell.desired_tcp_position_in_base_m[2] - settings.object.position_in_base_m[2]
            margin = min(margin, -float(angle[-1] - CONVERGED_ANGLE_RAD) * depth_m)
        if margin < 0.0 and had_s < needed_s and not _stands(trace, first):
            needed = f"the closed form needs {needed_s:.1f} s; the run leaves {had_s:.1f} s"
            return inconclusive(self, f"{needed}: {longer(trace, needed_s - had_s)}")
        reason = f"ends {position[-1] * 1e3:.2f} mm and {np.degrees(angle[-1]):.3f} deg off"
        far = f"the TCP was {1e3 * position.max():.2g} mm and {np.degrees(angle.max()):.2g} deg off at most"
        limits = f"{CONVERGED_POSITION_M * 1e3:g} mm or {np.degrees(CONVERGED_ANGLE_RAD):g} deg"
        lacked = f"{far}; beyond {limits} exercises it: {OFF_THE_GOAL}"
        unconverged = int(np.any(position > CONVERGED_POSITION_M) or np.any(angle > CONVERGED_ANGLE_RAD))
        return judged(
            self, trace, margin, trace.time_s[-1], reason, unconverged, lambda: lacked, revocable=True
        )

    def _needed_s(self, trace: Trace, distance_m: float) -> float:
        """Return how long [s] servoing should take from ``distance_m`` to 1 mm.

        It is the time of the closed form with both gains, increased by an allowance.
        """
        servo = trace.scenario.settings.servo
        switch_m = float(np.sqrt(servo.gain_switch_sse))
        far_s = log(max(distance_m, switch_m) / switch_m) / servo.gain_far
        near_s = log(max(min(distance_m, switch_m), CONVERGED_POSITION_M) / CONVERGED_POSITION_M)
        return float(ALLOWANCE * (far_s + near_s / servo.gain_near) + GRACE_S)


def _stands(trace: Trace, first: int) -> bool:
    """Return whether the TCP hardly came nearer to the desired pose in the last STANDS_S.

    The result is True only if the rate was less than half the due rate and STANDS_S have passed since
    ``first``.
    """
    begin = len(trace.ticks) - 1 - round(STANDS_S / trace.scenario.settings.clock.control_period_s)
    error = hypot(*pose_errors(trace))
    rate_per_s = 0.5 * trace.scenario.settings.servo.gain_near
    return begin >= first and bool(error[-1] > error[begin] * exp(-rate_per_s * STANDS_S))


def _converged_ends(trace: Trace, margin: float) -> tuple[float, float, bool]:
    """Return the margin's bounds for ``reads``, from the error of the last pose.

    The upper bound is infinite if a hand may have come near again, because a violation is then uncertain.
    """
    off_m, first = trace.known.uncertainty_of("transform_tcp_to_base", len(trace.ticks)), left_at(trace) or 0
    apart_m = (nearest_hand_m(trace) - nearest_off_m(trace))[first:]
    left = bool((apart_m >= trace.scenario.settings.avoidance.critical_distance_m).all())
    unconverged = bool((position_errors_m(trace) - off_m > CONVERGED_POSITION_M).any())
    return margin - float(off_m[-1]), margin + float(off_m[-1]) if left else np.inf, unconverged


GAIN_SWITCH = CatalogueEntry(
    prop=GainSwitchReached(),
    rationale="if an avoider leaves the arm where servoing cannot continue, the task ends",
    source="the paper, eq. 15",
    margin=(
        "the time allowed (1.25 times the closed form, plus 1 s) minus the time from the last "
        "hand's departure until the gain switches"
    ),
    parameters="the gains and the gain switch in the settings",
    exercised="the error is above the gain switch after the last hand has left",
    inconclusive="a hand is near until the end, or the run ends before the time allowed",
    scenario="servoing-alone",
    broken_by="a controller that does nothing",
)

GAIN_SWITCH_WITHIN = replace(
    GAIN_SWITCH,
    prop=GainSwitchReached(within_s=5.0),
    pattern=r"gain switch reached within (?!.* iterations$)(.+)",
    rationale="the same as without a stated time, for a cell with a cycle time",
    margin="the time allowed minus the time from the last hand's departure until the gain switches",
    parameters="the time allowed",
)

CONVERGED = CatalogueEntry(
    prop=Converged(),
    rationale="a small image error may belong to another pose of the same triangle",
    source="the P3P ambiguity of a triangle; this claim judges the pose itself",
    margin=(
        "1 mm minus the distance from the desired pose at the end of the run (and 0.1 degree minus the angle)"
    ),
    parameters="the gains in the settings",
    exercised="at some tick the TCP was farther from the desired pose than the limits",
    inconclusive="the run is shorter than the closed form needs, but the TCP comes nearer in the last 5 s",
    scenario="servoing-alone",
    broken_by="a controller that does nothing",
)


@dataclass(frozen=True, kw_only=True)
class GainSwitchIterations(Worded):
    """The claim of ``GainSwitchReached``, except that the time is given as a number of control ticks."""

    within: int
    unit: Unit = Unit.COUNT
    wording: ClassVar[str] = "gain switch reached within {within:} iterations"

    @property
    def reads(self) -> tuple[str, ...] | None:
        """Return the columns that ``GainSwitchReached`` reads."""
        return columns_read_by(GainSwitchReached())

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the first crossing after the hands have left."""
        period_s = trace.scenario.settings.clock.control_period_s
        # half a period more, so that rounding does not decide; the margin is cut to whole ticks
        timed = GainSwitchReached(within_s=(self.within + 0.5) * period_s).evaluate(trace)
        evaluation = replace(timed, sentence=self.sentence, unit=self.unit)
        if timed.margin is None:
            return evaluation
        left = floor(timed.margin / period_s)
        if timed.verdict is Verdict.INCONCLUSIVE:
            return replace(evaluation, margin=float(left))
        how = "not reached in" if timed.reason.startswith("not") else "reached after"
        text = f"{how} {self.within - left} iterations; {self.within} were allowed"
        return replace(evaluation, margin=float(left), reason=text)


GAIN_SWITCH_ITERATIONS = replace(
    GAIN_SWITCH,
    prop=GainSwitchIterations(within=600),
    rationale="the same in iterations, the paper's measure, which does not depend on the control period",
    source="the paper, eq. 15 and section 5: iterations until |f - f*|^2 is below the threshold",
    margin=(
        "the iterations allowed minus the control ticks from the last hand's departure until "
        "the gain switches"
    ),
    parameters="the iterations allowed",
    inconclusive="a hand is near until the end, or the run ends before the iterations allowed",
)


@dataclass(frozen=True, kw_only=True)
class NeverStarved(Worded):
    """The claim that the task never pauses for longer than ``longest_s``.

    The margin is ``longest_s`` minus the longest time for which the task paused. The error is that of eq. 15
    for the true pose: (distance^2 + angle^2)^(1/2) in metres and radians. The task is done while the error is
    below the square root of the gain switch. The task pauses at a tick if it is not done and the controller
    does not servo. It also pauses while the controller servoes too slowly, that is, while the error e falls
    at less than a tenth of the closed form's rate lambda |e|. The pause ends when the error is 1 mm smaller
    than its least value since the task was last done. So the task also pauses if a system alternates between
    servoing and giving way, but does not come nearer.
    """

    longest_s: float
    unit: Unit = Unit.TIME
    wording: ClassVar[str] = "task pauses at most {longest_s:s}"

    @reads("transform_tcp_to_base", also=["mode"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the longest pause of the run."""
        if time_left_s(trace, self.longest_s, len(trace.ticks) - 1) >= 0.0:
            lasts = f"the run lasts {trace.time_s[-1]:g} s"
            return inconclusive(self, f"{lasts}; longer than {self.longest_s:g} s exercises it")
        lost, away = lost_ticks(trace)
        worst, exercised = int(np.argmax(lost)), int(np.count_nonzero(away))
        margin_s = time_left_s(trace, self.longest_s, int(lost[worst]))
        if lost[-1] > 0 and margin_s >= 0.0:
            reason = f"the task has paused for {trace.time_s[lost[-1]]:.2f} s when the run ends"
            return inconclusive(self, reason, exercised=exercised)
        reason = f"longest {trace.time_s[lost[worst]]:.2f} s"

        def lacked() -> str:
            distance_m, angle_rad = (errors.max() for errors in pose_errors(trace))
            done_m = float(np.sqrt(trace.scenario.settings.servo.gain_switch_sse))
            far = f"the TCP was {distance_m * 1e3:.1f} mm and {np.degrees(angle_rad):.1f} deg off at most"
            return f"{far}; beyond {done_m * 1e3:.1f} mm exercises it: {OFF_THE_GOAL}"

        return judged(self, trace, margin_s, trace.time_s[worst], reason, exercised, lacked)


def lost_ticks(trace: Trace) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return for how many ticks the task has paused, and whether it is not done, both (n,)."""
    settings = trace.scenario.settings
    distance_m, angle_rad = pose_errors(trace)
    error = hypot(distance_m, angle_rad)
    done_below = float(np.sqrt(settings.servo.gain_switch_sse))
    least_share = LEAST_SHARE * settings.servo.gain_far * settings.clock.control_period_s
    lost = _lost(error, history(trace, "mode") == Mode.SERVOING, done_below, least_share)
    return lost, error >= done_below


@compiled
def _lost(
    error: NDArray[np.float64],  # (n,)
    servoing: NDArray[np.bool_],  # (n,)
    done_below: float,
    least_share: float,  # of the error, in one tick
) -> NDArray[np.int64]:
    """Return at each tick the number of ticks that were lost up to then, shape (n,).

    It is 0 at a new least error. Otherwise it rises by one, unless the error falls fast enough.
    """
    best, lost = error[0], np.zeros(error.shape[0], np.int64)
    for k in range(1, error.shape[0]):
        if error[k] < done_below:
            # A finished task starts anew: from here on only an error below the switch is progress.
            best, lost[k] = done_below, 0
        elif error[k] < best - LEAST_GAIN_M:
            best, lost[k] = error[k], 0
        else:
            on = servoing[k] and error[k - 1] - error[k] >= least_share * error[k]
            lost[k] = lost[k - 1] + (not on)
    return lost


NEVER_STARVED = CatalogueEntry(
    prop=NeverStarved(longest_s=10.0),
    former=("task never starved longer than {longest_s:s}",),
    rationale="an arm that never returns to its task is of no use, and people will switch its safety off",
    source="the paper, section 5: after a retreat, servoing resumes and converges",
    margin=(
        "the limit minus the longest pause. In a pause, eq. 15's error is above the threshold "
        "and the arm does not servo towards the desired pose. A pause ends when the TCP is "
        "nearer to the pose than at any time since the task was last done"
    ),
    parameters="the time allowed; the gain switch and the far gain in the settings",
    exercised="the TCP is farther off than the gain switch, and the run is longer than the limit",
    inconclusive="the run is not longer than the limit, or ends while the task pauses",
    broken_by="a controller that does nothing",
)


@dataclass(frozen=True, kw_only=True)
class ObjectInView(Worded):
    """The claim that the camera does not lose the object for longer than ``within_s``.

    The margin is ``within_s`` minus the longest time for which the latest image did not show the whole
    object. Before the first image, the object is not in view. A run that is no longer than the limit could
    not violate the claim, so it is not evidence. The claim is inconclusive if the object is out of view at
    the end of the run, but not yet for longer than the limit.
    """

    within_s: float
    unit: Unit = Unit.TIME
    wording: ClassVar[str] = "object in view or recovered within {within_s:s}"

    @reads("tcp_speed_mps", also=["object_visible"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each period in which the object is out of view.

        A period ends at the first tick that shows the object again.
        """
        if time_left_s(trace, self.within_s, trace.scenario.ticks) >= 0.0:
            lasts = f"the run lasts {trace.scenario.duration_s:g} s"
            return inconclusive(self, f"{lasts}; longer than {self.within_s:g} s exercises it")
        lost = ~trace.ticks["object_visible"]
        begins, ends = runs_of(lost)
        times_s = trace.time_s
        lasted = np.minimum(ends, len(lost) - 1) - begins  # in ticks
        worst = int(np.argmax(lasted)) if len(begins) else 0
        longest_s = float(times_s[lasted[worst]]) if len(begins) else 0.0
        margin_s = time_left_s(trace, self.within_s, int(lasted[worst]) if len(begins) else 0)
        begun_s = float(times_s[begins[worst]]) if len(begins) else 0.0
        exercised = int(np.count_nonzero(lost | (trace.ticks["tcp_speed_mps"] > MOVES)))
        if bool(lost[-1]) and margin_s >= 0.0:
            left_s = float(times_s[-1] - times_s[begins[-1]])
            reason = f"the object has been out of view for {left_s:.2f} s when the run ends"
            return inconclusive(self, reason, exercised=exercised)
        worst_time_s = begun_s + min(longest_s, self.within_s)
        often = "once, for" if len(begins) == 1 else f"{len(begins)} times, longest"
        reason = f"out of view {often} {longest_s:.2f} s" if len(begins) else "in view all the time"
        return judged(self, trace, margin_s, worst_time_s, reason, exercised, lambda: tcp_stood(trace))


OBJECT_IN_VIEW = CatalogueEntry(
    prop=ObjectInView(within_s=2.0),
    rationale="servoing is blind without the object, so a retreat must not end the task",
    source="the paper, section 3: the features are of an object that is seen whole",
    margin=(
        "the limit minus the longest time from an image that no longer shows the whole object "
        "to the next image that shows it"
    ),
    parameters="the time allowed",
    exercised="the TCP moves, or the object is out of view",
    inconclusive="the object is out of view at the end of the run, but not yet longer than the limit",
    scenario="fault-camera-hidden-by-a-hand",
    broken_by="an avoider that keeps moving sideways, behind a gate that accepts every proposal",
)
