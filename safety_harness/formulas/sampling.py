"""From a trace to each signal: its value at the ticks and what is known of it between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from safety_harness.formulas.cells import absent, at_ticks, bounded, rises, speeds, tcp_way_m, turned_rad
from safety_harness.formulas.signal import Sampled
from safety_harness.properties.consistency import TOLERANCE
from safety_harness.properties.hand_prediction import prediction_errors_m
from safety_harness.properties.servoing import pose_errors
from safety_harness.trace.records import DecisionOutcome, Mode
from safety_harness.trace.trace import Trace


def elapsed_time_of(trace: Trace) -> Sampled:
    """Since the run began: the floats nearest to whole control periods, so that none is beside its limit."""
    period = Fraction(repr(trace.scenario.settings.clock.control_period_s))  # as it is written, in decimals
    ticks: NDArray[np.float64] = np.arange(len(trace.ticks), dtype=np.float64)
    time_s = ticks * float(period.numerator) / float(period.denominator)
    later = np.append(time_s[1:], time_s[-1:])
    return Sampled(value=time_s, low=time_s, high=later)


def tcp_speed_of(trace: Trace) -> Sampled:
    """Of the TCP; between ticks the mean speed counts too."""
    at_tick = trace.ticks["tcp_speed_mps"]
    steps = np.linalg.norm(np.diff(trace.ticks["transform_tcp_to_base"][:, :3, 3], axis=0), axis=1)
    mean = steps / np.diff(trace.time_s)
    return speeds(at_tick, mean, of="the TCP")


def joint_speed_of(trace: Trace) -> Sampled:
    """Of the fastest joint, likewise."""
    at_tick = np.abs(trace.ticks["joint_velocity_radps"])
    mean = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0)) / np.diff(trace.time_s)[:, None]
    return speeds(at_tick, mean, of="the arm")


def tcp_height_of(trace: Trace) -> Sampled:
    """Above the base frame's origin."""
    return bounded(trace.ticks["transform_tcp_to_base"][:, 2, 3], tcp_way_m(trace))


def distance_to_desired_pose_of(trace: Trace) -> Sampled:
    """Of the TCP from where servoing wants it."""
    return bounded(pose_errors(trace)[0], tcp_way_m(trace))


def angle_to_desired_pose_of(trace: Trace) -> Sampled:
    """By which the TCP would have to turn; endless, which it never is, for a pose that is none."""
    none = np.abs(trace.ticks["transform_tcp_to_base"][:, :3, :3]).max(axis=(1, 2)) > 1.0 + TOLERANCE
    return bounded(np.where(none, np.inf, pose_errors(trace)[1]), turned_rad(trace))


def image_error_of(trace: Trace) -> Sampled:
    """Eq. 15 as the controller has it; unknown while the object is not seen."""
    sse = trace.ticks["sse"]
    if not np.any(np.isfinite(sse)):
        return absent(trace, "the object is never seen")
    return at_ticks(sse)


def predicted_hand_distance_of(trace: Trace) -> Sampled:
    """From the TCP to the nearest predicted hand, inf where none is.  Occasions: one comes near."""
    distance_m = trace.ticks["predicted_distance_m"]
    if not np.any(np.isfinite(distance_m)):
        return absent(trace, "no hand is ever predicted")
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    return replace(
        at_ticks(distance_m),
        occasions=rises(distance_m < critical_m),
        untried=f"no predicted hand comes within {critical_m * 1e3:g} mm",
    )


def prediction_error_of(trace: Trace) -> Sampled:
    """What ``HandPredictions`` judges, at the tick of the prediction; unknown if it is for after the run."""
    valid, hands = trace.ticks["track_valid"], len(trace.scenario.hands)
    if hands == 0 or not valid.any():
        return absent(trace, "no hand is ever predicted" if hands else "there is no hand in this scenario")
    errors_m = prediction_errors_m(trace)
    tracked = valid[: len(errors_m)]
    value = np.full(len(valid), np.nan)
    value[: len(errors_m)] = np.where(tracked, errors_m, -np.inf).max(axis=1)
    value[np.isneginf(value)] = np.nan  # nothing is tracked
    return at_ticks(value)


def in_force(trace: Trace) -> NDArray[np.int64]:
    """(n,) the latest decision at each tick, -1 before the first."""
    return np.maximum.accumulate(trace.ticks["decision"])


def spread_of(trace: Trace) -> Sampled:
    """The largest of the three axes, as the gate takes it."""
    if len(trace.decisions) == 0:
        return absent(trace, "no decision was made")
    spread_m = trace.decisions["proposed_spread_m"].max(axis=1)
    if not np.any(np.isfinite(spread_m)):
        return absent(trace, "the avoider says no spread")
    number = in_force(trace)
    return at_ticks(np.where(number >= 0, spread_m[number], np.nan))


def falling_back_of(trace: Trace) -> Sampled:
    """While it gives way to the opposite pose, or stops, because of its latest decision."""
    if len(trace.decisions) == 0:
        return absent(trace, "no decision was made")
    number = in_force(trace)
    gives_way = np.isin(trace.ticks["mode"], (Mode.REPULSING, Mode.PROTECTIVE_STOP))
    refused = trace.decisions["outcome"][number] != DecisionOutcome.PROPOSED
    return truth(gives_way & (number >= 0) & refused)


def in_mode(*modes: Mode) -> Callable[[Trace], Sampled]:
    """Whether the controller is in one of ``modes``."""
    return lambda trace: truth(np.isin(trace.ticks["mode"], modes))


def truth(true: NDArray[np.bool_] | np.bool_) -> Sampled:
    """Something (n,) that is true or false until the next tick."""
    return at_ticks(np.asarray(true, np.float64))


def deciding_of(trace: Trace) -> Sampled:
    """A decision was made at this tick."""
    return truth(trace.ticks["decision"] >= 0)


def object_visible_of(trace: Trace) -> Sampled:
    """The controller's image shows the object."""
    return truth(trace.ticks["object_visible"])


def hand_tracked_of(trace: Trace) -> Sampled:
    """At least one hand is predicted."""
    return truth(trace.ticks["track_valid"].any(axis=1))


def fault_acting_of(trace: Trace) -> Sampled:
    """At least one of the scenario's faults acts."""
    if not trace.scenario.faults:
        return absent(trace, "there is no fault in this scenario")
    return truth(trace.ticks["faults"] != 0)
