"""Define the signals of a trace: their values at the ticks, and what is known between the ticks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.extension_points import ExtensionPoint, Registry
from safety_harness.claims.formulas.measures import Flag, Measure
from safety_harness.claims.signals.bounds import lipschitz_bounds
from safety_harness.claims.signals.hand_distance import ends_between, followed_hands, joint_bend_m
from safety_harness.claims.signals.occasions import NEAR_M, no_decision, no_hand, no_predicted_hand
from safety_harness.claims.signals.poses import pose_errors
from safety_harness.claims.signals.predictions import tracked_errors_m
from safety_harness.claims.signals.signal import (
    Interpolation,
    Sampled,
    Signal,
    absent,
    at_ticks,
    bounded,
)
from safety_harness.claims.signals.speeds import sample_joint_speed, sample_tcp_speed, tcp_way_m, turned_rad
from safety_harness.claims.signals.true_motion import (
    TOLERANCE,
    arm_of,
    finer_paths,
    hand_bend_m,
)
from safety_harness.claims.signals.uncertainty import (
    HANDS,
    TCP,
    TCP_SPEED,
    by_uncertainty_of,
    gaps_of,
    lost,
    lost_of_hands,
    of_hand_distance,
    of_nearest_hand,
    of_place,
    of_speed,
    or_next,
)
from safety_harness.scenario.units import ANGLE, ANGULAR_SPEED, LENGTH, NUMBER, SPEED, TIME, Dimension
from safety_harness.trace.known import PRESENCE
from safety_harness.trace.records import DecisionOutcome, Mode
from safety_harness.trace.trace import Trace

Sample = Callable[[Trace], Sampled]
Listed = TypeVar("Listed", bound=Signal)
SIGNALS = Registry[Signal]((), ExtensionPoint.SIGNALS, Signal)  # in the order of the pages


def measure(
    phrase: str,
    dimension: Dimension,
    meaning: str,
    interpolation: Interpolation = Interpolation.BOUNDED,
    *,
    reads: Sequence[str],
    **more: Any,
) -> Callable[[Sample], Measure]:
    """Return a decorator that makes a function of a trace a measure, and adds the measure to ``SIGNALS``."""
    make = partial(Measure, words=phrase, dimension=dimension, meaning=meaning, between=interpolation, **more)
    make = partial(make, reads=tuple(reads))
    return lambda sample: _listed(make(sample=sample))


def flag(phrase: str, meaning: str, *, reads: Sequence[str]) -> Callable[[Sample], Flag]:
    """Return a decorator like ``measure`` for a signal that is true or false."""
    return lambda sample: _listed(Flag(words=phrase, meaning=meaning, sample=sample, reads=tuple(reads)))


def _listed(signal: Listed) -> Listed:
    SIGNALS.append(signal)
    return signal


def in_force(trace: Trace) -> NDArray[np.int64]:
    """Return the number of the latest decision at each tick, shape (n,).

    The number is -1 before the first decision.
    """
    return np.maximum.accumulate(trace.ticks["decision"])


def out_of_knowledge(trace: Trace, signal: Signal) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which a ``signal`` of the latest decision is unknown, shape (n,).

    After a gap, the signal is unknown until the next decision.
    """
    gone = lost(trace, signal.reads)
    if gone.any():
        ticks, made = np.arange(len(gone)), trace.ticks["decision"] >= 0
        unsure = np.where(lost(trace, ["decision"]), ticks, -1)
        gone |= np.maximum.accumulate(unsure) > np.maximum.accumulate(np.where(made, ticks, -1))
    return gone


def in_mode(mode: Mode) -> Sample:
    """Return a function that samples whether the controller is in ``mode``.

    If a gap lists the possible modes and ``mode`` is not in the list, the controller certainly is not in
    ``mode``.
    """

    def sample(trace: Trace) -> Sampled:
        is_mode, gone = truth(trace.ticks["mode"] == mode), lost(trace, ["mode"])
        if not gone.any():
            return is_mode
        value = is_mode.value.copy()
        for gap in trace.known.column("mode").gaps:
            if gap.either and mode not in gap.either:
                value[gap.first : gap.after], gone[gap.first : gap.after] = 0.0, False
        return replace(at_ticks(np.where(gone, np.nan, value)), lost=gone)

    return sample


def truth(true: NDArray[np.bool_] | np.bool_) -> Sampled:
    """Return a sampled signal whose truth value ``true`` (n,) lasts until the next tick."""
    return at_ticks(np.asarray(true, np.float64))


@measure(
    "hand distance",
    LENGTH,
    "of any hand or forearm from any link of the robot, surface to surface; negative inside",
    least=-np.inf,
    lowest=-0.3,  # a hand and a link are no thicker
    reads=[
        "joint_position_rad",
        "joint_velocity_radps",
        TCP,
        HANDS,
        "elbow_position_in_base_m",
        "hand_distance_m",
        PRESENCE,
    ],
    off=of_hand_distance,
    finer=lambda trace: _from_hands(trace, finely=True),
)
@lru_cache(maxsize=4)
def hand_distance(trace: Trace) -> Sampled:
    """Sample the distance from any hand or forearm to any link, from surface to surface.

    Its bounds are computed like those of the catalogue's claim on the hand distance. A run exercises this
    signal when a hand comes near the arm's surface.
    """
    return _from_hands(trace)


@measure(
    "nearest hand to TCP",
    LENGTH,
    "from the TCP to the centre of the nearest true hand",
    reads=["joint_position_rad", "joint_velocity_radps", TCP, TCP_SPEED, HANDS, PRESENCE],
    off=of_nearest_hand,
    finer=lambda trace: _from_hands(trace, from_tcp=True, finely=True),
)
@lru_cache(maxsize=4)
def nearest_hand_to_tcp(trace: Trace) -> Sampled:
    """Sample the distance from the TCP to the nearest hand's centre, with bounds as for hand distance."""
    return _from_hands(trace, from_tcp=True)


def _from_hands(trace: Trace, *, from_tcp: bool = False, finely: bool = False) -> Sampled:
    """Sample the distance of the nearest hand.

    If ``finely`` is True, each tick is divided into parts and the hands are followed from part to part, which
    gives closer bounds. Between two ticks, the least distance lies between the two bounds of
    ``ends_between``. The upper bound follows from the distances at both ticks, and from how far arm and hand
    move between the ticks.
    """
    paths, why = followed_hands(trace)
    if paths is None:
        return replace(absent(trace, why), lost=np.full(len(trace.ticks), bool(trace.scenario.hands)))
    paths = finer_paths(trace) if finely else paths
    hands = len(trace.scenario.hands)
    if from_tcp:
        value = np.linalg.norm(trace.ticks[HANDS][:, :hands] - trace.ticks[TCP][:, None, :3, 3], axis=2)
    else:
        value, present = trace.ticks["hand_distance_m"][:, :hands], trace.ticks["hand_present"][:, :hands]
        value = np.where(present & np.isinf(value), np.nan, value)  # else the other hand would hide it
    low, high, surely = value.copy(), value.copy(), value.copy()
    turned_rad = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0))
    arm_m = tcp_way_m(trace) if from_tcp else product(turned_rad, arm_of(trace).reach_m)
    for hand in range(hands):
        ends_m, (hand_m, elbow_m) = ends_between(trace, paths, hand, from_tcp=from_tcp)
        for side, least_m in zip((low, surely), ends_m, strict=True):
            side[:-1, hand] = np.minimum(side[:-1, hand], least_m)
        bend_m = hand_bend_m(trace, paths, hand, centre=from_tcp)
        bend_m = bend_m if from_tcp else joint_bend_m(trace) + bend_m
        way_m = arm_m + np.maximum(hand_m, elbow_m)
        high[:-1, hand] = lipschitz_bounds(value[:-1, hand], value[1:, hand], way_m, bend_m)[1]
    signal, target = (nearest_hand_to_tcp, "the TCP") if from_tcp else (hand_distance, "the arm's surface")
    return replace(_nearest(signal, trace, value, low, high, target), surely=surely.min(axis=1))


tcp_speed = measure(
    "TCP speed",
    SPEED,
    "of the TCP; between ticks the mean speed counts too",
    reads=[TCP_SPEED, TCP],
    off=of_speed(TCP_SPEED, TCP),
    place=TCP,
)(sample_tcp_speed)


@measure(
    "TCP height",
    LENGTH,
    "of the TCP above the origin of the robot's base frame",
    least=-np.inf,
    lowest=-LENGTH.most,
    reads=[TCP, TCP_SPEED],
    off=of_place,
)
def tcp_height(trace: Trace) -> Sampled:
    """Sample the TCP's height above the base frame's origin."""
    return bounded(trace.ticks["transform_tcp_to_base"][:, 2, 3], tcp_way_m(trace))


@measure(
    "distance to desired pose",
    LENGTH,
    "of the TCP from where servoing wants it",
    reads=[TCP, TCP_SPEED],
    off=of_place,
)
def distance_to_desired_pose(trace: Trace) -> Sampled:
    """Sample the distance from the TCP to the pose at which servoing aims."""
    return bounded(pose_errors(trace)[0], tcp_way_m(trace))


@measure(
    "angle to desired pose",
    ANGLE,
    "by which the TCP is turned away from how servoing wants it",
    reads=[TCP, "joint_position_rad", "joint_velocity_radps"],
)
def angle_to_desired_pose(trace: Trace) -> Sampled:
    """Sample the TCP's angle from the desired pose, which is infinite if a transform is not a pose."""
    none = np.abs(trace.ticks["transform_tcp_to_base"][:, :3, :3]).max(axis=(1, 2)) > 1.0 + TOLERANCE
    return bounded(np.where(none, np.inf, pose_errors(trace)[1]), turned_rad(trace))


joint_speed = measure(
    "joint speed",
    ANGULAR_SPEED,
    "of the fastest joint; between ticks the mean speed counts too",
    reads=["joint_velocity_radps", "joint_position_rad"],
    off=of_speed("joint_velocity_radps", "joint_position_rad"),
    place="joint_position_rad",
)(sample_joint_speed)


@measure(
    "image error",
    NUMBER,
    "eq. 15 of the paper as the controller has it; unknown while the object is not seen",
    Interpolation.HELD,
    reads=["sse"],
    off=by_uncertainty_of("sse"),
)
def image_error(trace: Trace) -> Sampled:
    """Sample the error of eq. 15 that the controller computes.

    The value is unknown while the camera does not see the object.
    """
    sse = trace.ticks["sse"]
    if not np.any(np.isfinite(sse)):
        return absent(trace, "the object is never seen")
    return at_ticks(sse)


@measure(
    "spread",
    LENGTH,
    "of the latest decision's proposal, largest of the three axes; unknown before the first decision",
    Interpolation.HELD,
    reads=["decision", "decision.proposed_spread_m"],
    off=by_uncertainty_of("decision.proposed_spread_m"),
)
def spread(trace: Trace) -> Sampled:
    """Sample the largest spread of the three axes, which the gate compares with its threshold."""
    if len(trace.decisions) == 0:
        return _untried(trace, no_decision, "nothing was decided")
    spread_m = trace.decisions["proposed_spread_m"].max(axis=1)
    if not np.any(np.isfinite(spread_m)):
        return absent(trace, "the avoider says no spread")
    number, gone = in_force(trace), out_of_knowledge(trace, spread)
    return replace(at_ticks(np.where((number >= 0) & ~gone, spread_m[number], np.nan)), lost=gone)


@measure(
    "predicted hand distance",
    LENGTH,
    "from the TCP to the nearest hand that the controller predicts; endless where it predicts none",
    Interpolation.HELD,
    endless=True,
    reads=["predicted_distance_m"],
    off=by_uncertainty_of("predicted_distance_m"),
)
def predicted_hand_distance(trace: Trace) -> Sampled:
    """Sample the distance from the TCP to the nearest predicted hand, which is inf if no hand is predicted.

    A run exercises this signal when a predicted hand comes near.
    """
    distance_m = trace.ticks["predicted_distance_m"]
    if not np.any(np.isfinite(distance_m)):
        return _untried(trace, no_predicted_hand, "no hand was predicted")
    return _coming_near(at_ticks(distance_m), "predicted hand", "the TCP")


@measure(
    "prediction error",
    LENGTH,
    "of each prediction made now from the nearest true hand at the time that it is for, the largest; "
    "unknown where none is made, or that time is after the run",
    Interpolation.TICKS_ONLY,
    reads=["track_valid", "predicted_hand_in_base_m", HANDS, PRESENCE],
    off=by_uncertainty_of("predicted_hand_in_base_m", HANDS),
)
def prediction_error(trace: Trace) -> Sampled:
    """Sample the prediction error that ``HandPredictions`` judges.

    The value at a tick is the error of the prediction that was made at this tick. The error is unknown if the
    predicted time lies after the run.
    """
    valid, hands = trace.ticks["track_valid"], len(trace.scenario.hands)
    if hands == 0 or not valid.any():
        return _untried(trace, no_predicted_hand if hands else no_hand, "no hand was predicted")
    errors_m, value = tracked_errors_m(trace), np.full(len(valid), np.nan)
    value[: len(errors_m)] = errors_m.max(axis=1)
    value[np.isneginf(value)] = np.nan  # nothing is tracked
    gone, then = lost(trace, ["track_valid", "predicted_hand_in_base_m"]), lost(trace, [HANDS, PRESENCE])
    if then.any():
        for later in (-1, 0, 1):  # the ticks about the time that it is for
            ticks = np.arange(len(errors_m)) + len(valid) - len(errors_m) + later
            gone[: len(errors_m)] |= then[np.clip(ticks, 0, len(valid) - 1)]
    return replace(at_ticks(np.where(gone, np.nan, value)), lost=gone)


@measure("elapsed time", TIME, "since the run began", reads=[])
def elapsed_time(trace: Trace) -> Sampled:
    """Sample the time since the run began.

    The values are the floats nearest to whole control periods, so that limits are met exactly.
    """
    period = Fraction(repr(trace.scenario.settings.clock.control_period_s))  # as it is written, in decimals
    ticks: NDArray[np.float64] = np.arange(len(trace.ticks), dtype=np.float64)
    time_s = ticks * float(period.numerator) / float(period.denominator)
    later = np.append(time_s[1:], time_s[-1:])
    return Sampled(value=time_s, low=time_s, high=later)


object_visible = flag("object visible", "the controller's image shows the object", reads=["object_visible"])(
    lambda trace: truth(trace.ticks["object_visible"])
)
servoing = flag("servoing", "the controller servoes", reads=["mode"])(in_mode(Mode.SERVOING))
repulsing = flag("repulsing", "the controller gives way", reads=["mode"])(in_mode(Mode.REPULSING))
stopped = flag("stopped", "a protective stop", reads=["mode"])(in_mode(Mode.PROTECTIVE_STOP))
object_lost = flag("object lost", "the controller waits for the object to be seen", reads=["mode"])(
    in_mode(Mode.OBJECT_LOST)
)
MODES: dict[Signal, Mode] = {
    servoing: Mode.SERVOING,
    repulsing: Mode.REPULSING,
    stopped: Mode.PROTECTIVE_STOP,
    object_lost: Mode.OBJECT_LOST,
}
deciding = flag("deciding", "a decision is made at this tick", reads=["decision"])(
    lambda trace: truth(trace.ticks["decision"] >= 0)
)


@flag(
    "falling back",
    "it gives way to the opposite pose, or stops, since the latest proposal was refused",
    reads=["mode", "decision", "decision.outcome"],
)
def falling_back(trace: Trace) -> Sampled:
    """Sample whether the arm retreats to the opposite pose or stops because of its latest decision."""
    if len(trace.decisions) == 0:
        return _untried(trace, no_decision, "nothing was decided")
    number, gone = in_force(trace), out_of_knowledge(trace, falling_back)
    gives_way = np.isin(trace.ticks["mode"], (Mode.REPULSING, Mode.PROTECTIVE_STOP))
    refused = trace.decisions["outcome"][number] != DecisionOutcome.PROPOSED
    return replace(at_ticks(np.where(gone, np.nan, gives_way & (number >= 0) & refused)), lost=gone)


hand_tracked = flag("hand tracked", "the controller predicts a hand at least", reads=["track_valid"])(
    lambda trace: truth(trace.ticks["track_valid"].any(axis=1))
)


@flag("fault acting", "one of the scenario's faults acts", reads=["faults"])
def fault_acting(trace: Trace) -> Sampled:
    """Sample whether at least one fault of the scenario is active."""
    if not trace.scenario.faults:
        return absent(trace, "there is no fault in this scenario")
    return truth(trace.ticks["faults"] != 0)


def _untried(trace: Trace, lacked: Callable[[Trace], str], reason: str) -> Sampled:
    """Return a signal that the run does not have.

    If the trace is completely known, the function ``lacked`` returns the reason; otherwise ``reason`` is
    used.
    """
    return absent(trace, f"never exercised: {lacked(trace) if trace.known.whole else reason}")


def _nearest(
    signal: Signal,
    trace: Trace,
    value: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    target: str,
) -> Sampled:
    """Return the signal of the nearest measured hand.

    The arguments ``value``, ``low`` and ``high`` are distances and their bounds, each of shape (n, hands).
    """
    gone = None
    if gaps_of(trace, signal.reads):
        gone = lost(trace, signal.reads)
        own = lost_of_hands(trace, signal.reads)[:, : value.shape[1]]
        sides = ((value, own), (low, or_next(own)), (high, or_next(own)))
        value, low, high = (
            np.where(unknown.all(axis=1, keepdims=True), np.nan, np.where(unknown, np.inf, side))
            for side, unknown in sides
        )
    nearest = Sampled(value=value.min(axis=1), low=low.min(axis=1), high=high.min(axis=1), lost=gone)
    return _coming_near(nearest, "hand", target)


def _coming_near(distance: Sampled, body: str, target: str) -> Sampled:
    """Return the signal ``distance``, described as the distance from ``body`` to ``target``.

    A run exercises this signal each time that the distance falls below NEAR_M.
    """
    margin_m = NEAR_M - distance.value
    return replace(distance, tried=(margin_m, margin_m), comes=(body, target))
