"""Judge whether the arm keeps the protective separation distance of ``separation``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.settings import Settings
from safety_harness.cell.controller.stack import STANDSTILL_RADPS
from safety_harness.claims.properties.base import (
    OF_HANDS,
    Evaluation,
    Unit,
    Worded,
    judged,
    runs_of,
    times_begun,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import OFF_THE_GOAL, nearest_of, no_hand
from safety_harness.claims.signals.separation import (
    REACHING_MPS,
    Separation,
    farthest_steps,
    least_separation,
    lengths,
)
from safety_harness.claims.signals.speeds import arm_speeds_mps
from safety_harness.claims.signals.true_motion import JOINTS, arm_of, capsules_of, true_motion
from safety_harness.trace.known import UNMEASURED
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace, history, once_a_trace

GRACE_TICKS = 2  # by which the drives may come to rest after the end of their ramp


def _ends(prop: ProtectiveSeparation, trace: Trace, margin_m: float) -> tuple[float, float, bool]:
    """Return the margin's bounds for ``reads``.

    The bounds use the true distances at the ticks, and allow for every possible speed. The speeds between the
    nearest points may change abruptly, because other points may become the nearest. If it is unknown when the
    arm brakes, the upper bound excuses as many successive ticks as a stop may last.
    """
    known, true, settings = trace.known, true_motion(trace), trace.scenario.settings
    braking, period_s, reach_m = settings.braking, settings.clock.control_period_s, arm_of(trace).reach_m
    distance_m, rate_radps = (
        known.uncertainty_of(name, len(trace.ticks)) for name in ("hand_distance_m", "joint_velocity_radps")
    )
    speed_mps, faster_radps = known.column("tcp_speed_mps").uncertainty, rate_radps[:, None]
    per_speed_s2pm, grace_s = braking.stop_time_per_speed_s2pm, GRACE_TICKS * period_s
    stopped_mps = prop.stopped_from_mps(trace)
    reaction_s, stop_s = _times_s(trace, stopped_mps)
    longest_s = braking.stop_time_base_s + grace_s
    longest_s += per_speed_s2pm * float(stopped_mps.max() + speed_mps)
    turns_radps = np.abs(true.rates_radps)
    # Joint speeds are uncertain, so the arm surely moves at some ticks and may move at others.
    sure = turns_radps.max(axis=1) >= STANDSTILL_RADPS + rate_radps
    maybe = turns_radps.max(axis=1) >= STANDSTILL_RADPS - rate_radps
    # A hand's speed is a difference of two positions. The trace may also limit the speed.
    off_mps = 2.0 / period_s * max(known.column(name).uncertainty for name in OF_HANDS[:2])
    hand_mps = np.minimum(_steps_m(trace)[1] / period_s + off_mps, _fastest_mps(trace))
    most_mps = hand_mps if prop.own_speeds else np.full_like(hand_mps, prop.assumed_mps)
    least_mps = 0.0 if prop.own_speeds else prop.assumed_mps

    stopping = _may_be_stopping(trace)
    in_doubt = known.column("limits").limited or (bool(stopping.any()) and speed_mps > 0.0)
    whole_s = per_speed_s2pm * stopped_mps + braking.stop_time_base_s
    left_s = (
        whole_s + braking.reaction_time_s if in_doubt else reaction_s + stop_s
    ) - per_speed_s2pm * speed_mps
    high_m = np.where(sure, true.nearest_m + distance_m - least_mps * left_s, np.inf)
    # In doubt, the arm may have been stopping for this many ticks, so only a violation of all of them is
    # certain.
    ticks = ceil((braking.reaction_time_s + longest_s) / period_s) + 1 if in_doubt else 1
    high = min(float(high_m[0]), float(np.where(stopping, np.inf, high_m).min()))
    if len(high_m) >= ticks:
        high = min(high, float(sliding_window_view(high_m, ticks).max(axis=1).min()))

    low = margin_m if braking.reaction_time_s >= longest_s - braking.stop_time_base_s else -np.inf
    if known.uncertain((*JOINTS, "tcp_speed_mps", *OF_HANDS)):
        reaction_s, stop_s = _times_left_s(trace, stopped_mps, per_speed_s2pm * speed_mps, longest_s)
        # No point of the arm is faster than the sum of joint speeds times the lengths of their chains.
        arm_mps = product(turns_radps + faster_radps, reach_m)
        needed_m = most_mps * (reaction_s + stop_s) + arm_mps * (reaction_s + 0.5 * stop_s)
        needed_m += 0.5 * period_s * (hand_mps + arm_mps)
        low = float(np.where(maybe, true.nearest_m - distance_m - needed_m, np.inf).min())
    is_near = sure & (true.nearest_m + distance_m < prop.largest_m(settings))
    return low, high, bool(is_near.any())


def _may_be_stopping(trace: Trace) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which a protective stop is or may be under way, shape (n,)."""
    braking: NDArray[np.bool_] = trace.ticks["limits"] & int(Limit.BRAKING) != 0
    return braking | ~trace.known.measured("limits", trace.ticks)


def _fastest_mps(trace: Trace) -> float:
    """Return the largest speed [m/s] that the trace allows for hands and elbows, or inf without a limit."""
    rates = [trace.known.column(name).at_most_per_s for name in OF_HANDS[:2]]
    return max(np.inf if rate is None else rate for rate in rates)


@dataclass(frozen=True, kw_only=True)
class ProtectiveSeparation(Worded):
    """The claim that every hand is at least S_p away from every link while the arm moves.

    The margin is the least d - S_p over time, hands and links. The arm moves if any joint turns faster than 1
    mrad/s. Here d is the distance between hand and link. S_p is the protective separation distance for the
    human's speed v_h and the robot's speed v_r.

    ``hand_speed_mps`` is the speed v_h of every human towards the arm; None means ``default_mps``. If
    ``own_speeds`` is True, v_h is the speed of the nearest point of each hand or forearm at the tick. The
    robot's speed v_r is the speed of the link's nearest point towards the human, and is never below zero. The
    claim judges every link separately, because a slow link may come nearer to the human than a fast link.

    The settings give the reaction time T_r and the stop time T_s. At each tick, T_s is the stop time for the
    TCP's speed or for the speed of the arm's fastest point, whichever is larger. All joints brake together,
    so no link stops sooner than the fastest link. If ``tcp_alone`` is True or the joints are uncertain, T_s
    is the stop time for the TCP's speed. During a protective stop, only the remaining parts of T_r and T_s
    are used. So a stop that begins in time does not become a violation.

    A hand exercises the claim if its distance from the moving arm is less than the S_p that would apply at
    the arm's speed limit.
    """

    hand_speed_mps: float | None = None
    default_mps: float = REACHING_MPS
    own_speeds: bool = False
    tcp_alone: bool = False  # as editions 1 and 2 of the claims have it
    unit: Unit = Unit.LENGTH

    @property
    def wording(self) -> str:
        """Return the wording of the sentence, which contains the hands' speed if it is not the default."""
        if self.own_speeds:
            return "protective separation kept from hands at their own speeds"
        return "protective separation kept" + " at {hand_speed_mps:m/s}" * (self.hand_speed_mps is not None)

    @property
    def assumed_mps(self) -> float:
        """Return the speed v_h [m/s] that replaces the hands' own speeds."""
        return self.default_mps if self.hand_speed_mps is None else self.hand_speed_mps

    def stopped_from_mps(self, trace: Trace) -> NDArray[np.float64]:
        """Return the speed (n,) [m/s] for which the stop time T_s is computed."""
        tcp_mps: NDArray[np.float64] = trace.ticks["tcp_speed_mps"]
        alone = self.tcp_alone or trace.known.uncertain(JOINTS)
        return tcp_mps if alone else np.maximum(tcp_mps, arm_speeds_mps(trace)[:, 0])

    @reads(*JOINTS, "tcp_speed_mps", *OF_HANDS, bounded=["limits"], of_each_hand=True, ends=_ends)
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the hand and the link with the least margin."""
        if not trace.scenario.hands:
            return unexercised(self, no_hand(trace))
        worst = self.worst(trace)
        if worst is None:
            stood = "the arm did not move while a hand was there; one that moves exercises it"
            return unexercised(self, f"{stood}: {OFF_THE_GOAL}")
        nearest_m = np.where(moving(trace), true_motion(trace).nearest_m, np.inf)
        near_m = self.largest_m(trace.scenario.settings)

        def lacked() -> str:
            return nearest_of(trace, nearest_m, near_m, "hand", "the moving arm's surface")

        reason, times = described(trace, worst), times_begun(nearest_m < near_m)
        if not self.tcp_alone and trace.known.uncertain(JOINTS):
            reason += "; T_s is by the TCP's speed alone, as joints are known to within some uncertainty only"
        return judged(self, trace, worst.margin_m, trace.time_s[worst.tick], reason, times, lacked)

    def worst(self, trace: Trace) -> Separation | None:
        """Return the pair and tick with the least margin.

        The result is None if the arm never moved while a hand was present.
        """
        settings, true, turns = trace.scenario.settings, true_motion(trace), moving(trace)
        if trace.ended == UNMEASURED:  # speeds at the last tick differ from those of the whole run
            turns = turns & (np.arange(len(turns)) < len(turns) - 1)
        reaction_s, stop_s = _times_s(trace, self.stopped_from_mps(trace))
        indices, values = least_separation(
            arm_of(trace),
            turns,
            true.joints_rad,
            true.rates_radps,
            true.present,
            true.hands_m,
            reaction_s,
            stop_s,
            np.array([settings.hand.radius_m, settings.hand.forearm_radius_m]),
            np.nan if self.own_speeds else self.assumed_mps,
            settings.clock.control_period_s,
            *_steps_m(trace),
            int(np.argmin(np.where(turns, true.nearest_m, np.inf))),
        )
        tick, hand, capsule, body = (int(value) for value in indices)
        if tick < 0:
            return None
        distance_m, robot_mps, hand_mps, hand_moves_m, robot_moves_m = (float(value) for value in values)
        return Separation(
            tick=tick,
            hand=hand,
            capsule=capsule,
            forearm=body == 1,
            distance_m=distance_m,
            robot_speed_mps=robot_mps,
            hand_speed_mps=hand_mps,
            reaction_time_s=float(reaction_s[tick]),
            stop_time_s=float(stop_s[tick]),
            hand_moves_m=hand_moves_m,
            robot_moves_m=robot_moves_m,
        )

    def largest_m(self, settings: Settings) -> float:
        """Return S_p [m] for an arm at its speed limit towards a human.

        A hand that is nearer exercises the claim.
        """
        fastest_mps = max(settings.motion.max_tcp_speed_mps, settings.avoidance.repulsion_speed_mps)
        braking = settings.braking
        stop_s = braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * fastest_mps
        return sum(lengths(self.assumed_mps, fastest_mps, braking.reaction_time_s, stop_s, 0.0, 0.0))


@once_a_trace
def _steps_m(trace: Trace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both results of ``farthest_steps`` for the trace, each of shape (n,)."""
    true = true_motion(trace)
    return farthest_steps(arm_of(trace), true.joints_rad, true.hands_m, true.present)


@once_a_trace
def moving(trace: Trace) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which a joint turns faster than at a standstill, shape (n,).

    The controller's bound for a standstill is used.
    """
    turns: NDArray[np.bool_] = (np.abs(history(trace, JOINTS[1])) >= STANDSTILL_RADPS).any(axis=1)
    return turns


@once_a_trace
def times_left_s(trace: Trace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the reaction time (n,) and the stop time (n,) that the arm still needs at each tick.

    Both are full times, except during a protective stop, which the drives' BRAKING flag marks. Both are full
    times again if the arm still moves two ticks after the end of its braking ramp. Both are always full times
    if the trace does not know all flags.
    """
    return _times_s(trace, trace.ticks["tcp_speed_mps"])


def _times_s(trace: Trace, speed_mps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the remaining reaction time and stop time for stops from the speeds ``speed_mps`` (n,).

    If the trace does not know all flags, the results are the full times. These speeds are never below the
    TCP's speed.
    """
    known = not trace.known.column("limits").limited
    return (_times_left_s if known else _full_times_s)(trace, speed_mps, 0.0)


def _full_times_s(
    trace: Trace, speed_mps: NDArray[np.float64], off_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the full reaction time (n,) and the full stop time (n,) for stops from ``speed_mps`` (n,).

    ``off_s`` is added to the stop time.
    """
    braking = trace.scenario.settings.braking
    stop_s = braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * speed_mps + off_s
    return np.full(len(speed_mps), braking.reaction_time_s), stop_s


def _times_left_s(
    trace: Trace, speed_mps: NDArray[np.float64], off_s: float, longest_s: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return upper bounds (n,) of the remaining reaction time and stop time.

    ``off_s`` is the uncertainty of the stop time that belongs to a speed. The bounds are below the full times
    only during a stop whose beginning is known. Once the braking ramp may be over, they are the full times
    again. ``longest_s`` is the stop time at ticks at which it is unknown whether the arm stops.
    """
    period_s, time_s = trace.scenario.settings.clock.control_period_s, trace.time_s
    reaction_s, stop_s = _full_times_s(trace, speed_mps, off_s)
    known = trace.known.measured("limits", trace.ticks)
    stopping = known & _may_be_stopping(trace)
    whole_s, by_tcp_s = stop_s.copy(), _full_times_s(trace, trace.ticks["tcp_speed_mps"], off_s)[1]
    stop_s[~known] = longest_s
    for first, end in zip(*runs_of(stopping), strict=True):
        if first > 0 and not known[first - 1]:
            stop_s[first:end] = longest_s
            continue
        run = slice(first, end)
        left_s = reaction_s[run] - (time_s[run] - time_s[first])
        braked = left_s <= 1e-9
        begun = first + int(np.argmax(braked))
        late_s = left_s + (whole_s[begun] if braked.any() else 0.0) + GRACE_TICKS * period_s
        ramped = braked & (late_s - (whole_s - by_tcp_s)[begun] > 2.0 * off_s)  # the drives ramp by the TCP
        reaction_s[run] = np.where(ramped, 0.0, np.where(braked, reaction_s[run], left_s))
        stop_s[run] = np.where(ramped, np.maximum(late_s, 0.0), whole_s[run])
    return reaction_s, stop_s


def described(trace: Trace, separation: Separation) -> str:
    """Return a sentence on the hand and the link of ``separation``.

    The terms of S_p are listed on the page of the run.
    """
    part = capsules_of(trace).names[separation.capsule].replace("_", " ")
    body = trace.scenario.hands[separation.hand].name + ("'s forearm" if separation.forearm else "")
    where = "inside" if separation.distance_m < 0.0 else "from"
    return (
        f"{body} {abs(separation.distance_m) * 1e3:.1f} mm {where} {part}, where the hand's speed of "
        f"{separation.hand_speed_mps:.2f} m/s and the arm's speed of {separation.robot_speed_mps * 1e3:.0f} "
        f"mm/s towards it require {separation.required_m * 1e3:.1f} mm"
    )


_TIMES = (
    "reaction time, stop time and hand sizes. The stop time is computed from the larger "
    "of two speeds: the speed of the TCP and the speed of the arm's fastest point. If a "
    "log's joints are uncertain, it is computed from the TCP's speed. C, Z_d and Z_r are "
    "for a sensor without errors; for a real sensor, they are larger"
)
_MARGIN = (
    "the distance between the surfaces minus S_p; the least value over hands, links and "
    "the ticks at which the arm moves"
)

PROTECTIVE_SEPARATION = CatalogueEntry(
    prop=ProtectiveSeparation(),
    rationale=(
        "a constant distance does not consider how long the arm takes to stop, or how fast "
        "arm and hand approach. S_p is the least distance at which the arm can still stop in "
        "time"
    ),
    source="S_p = S_h + S_r + S_s + C + Z_d + Z_r, as in NIST's overview (PMC5117641)",
    margin=_MARGIN,
    parameters=f"v_h = {REACHING_MPS:g} m/s, and the settings' {_TIMES}",
    exercised="a hand comes nearer to the moving arm than the largest S_p of an arm at its speed limit",
    inconclusive="the arm did not move while a hand was present",
    broken_by="an avoider that moves towards the hand, behind a gate that accepts every proposal",
)
PROTECTIVE_SEPARATION_AT = replace(
    PROTECTIVE_SEPARATION,
    prop=ProtectiveSeparation(hand_speed_mps=1.6),
    parameters=f"v_h as stated in the claim, instead of {REACHING_MPS:g} m/s, and the settings' {_TIMES}",
)
PROTECTIVE_SEPARATION_OWN = replace(
    PROTECTIVE_SEPARATION,
    prop=ProtectiveSeparation(own_speeds=True),
    margin=f"{_MARGIN}; v_h is the speed of the point of the hand that is nearest to the link",
    parameters=f"each hand's own speed towards the link, never below zero, and the settings' {_TIMES}",
)
