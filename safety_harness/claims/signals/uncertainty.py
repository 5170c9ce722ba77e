"""Compute bounds of a signal in a trace with gaps or with uncertain measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.signals.bounds import place_between, speed_between
from safety_harness.claims.signals.hand_distance import distance_moved_m
from safety_harness.claims.signals.signal import Interpolation, Sampled, Signal
from safety_harness.claims.signals.true_motion import follows_unknown, tcp_of, tcp_velocity_moved_mps
from safety_harness.trace.trace import Trace, once_a_trace
from safety_harness.trace.unmeasured import as_measured

Bound = float | NDArray[np.float64]  # everywhere, or (n,) at each tick and from it to the next
ErrorOf = Callable[[Trace], tuple[Bound, Bound, Bound]]
Truths = NDArray[np.bool_]
TCP, TCP_SPEED, HANDS = "transform_tcp_to_base", "tcp_speed_mps", "hand_position_in_base_m"


blanked = once_a_trace(as_measured)


def gaps_of(trace: Trace, columns: Iterable[str], tick: int | None = None) -> tuple[str, ...]:
    """Return the names in ``columns`` whose columns have a gap at ``tick``.

    If ``tick`` is None, a gap at any tick is sufficient.
    """
    known = trace.known
    return tuple(
        name
        for name in columns
        if any(tick is None or g.first <= tick < g.after for g in known.column(name).gaps)
    )


def lost_of_hands(trace: Trace, columns: Iterable[str]) -> Truths:
    """Return a mask of the ticks and hands for which a column in ``columns`` was not measured, (n, hands)."""
    lost_rows = np.zeros((len(trace.ticks), *trace.ticks.dtype["hand_present"].shape), np.bool_)
    for name in columns:
        for gap in trace.known.column(name).gaps:
            lost_rows[gap.first : gap.after, ... if gap.hand is None else gap.hand] = True
    return lost_rows


def lost(trace: Trace, columns: Iterable[str]) -> Truths:
    """Return a mask (n,) of the ticks at which a column in ``columns`` was not measured for some hand."""
    if trace.known.whole:
        return np.zeros(len(trace.ticks), np.bool_)
    return np.asarray(lost_of_hands(trace, columns).any(axis=1))


def or_next(state: Truths) -> Truths:
    """Return a mask that is True where ``state`` (n, ...) is True at the tick or at the next tick."""
    either = state.copy()
    either[:-1] |= state[1:]
    return either


def as_known(signal: Signal, measured: Sampled, trace: Trace) -> Sampled:
    """Return the samples of ``signal`` with bounds.

    The bounds cover every value that is possible if parts of ``measured`` are unknown or uncertain. The
    signal is unknown at lost ticks and in the cells on both sides of these ticks. If the values at a lost
    tick come from the measured hands only, they are upper bounds of the signal.
    """
    columns = [name for name in signal.reads if trace.known.column(name).limited]
    if not columns or measured.absent:
        return measured
    at, below, above = signal.off(trace) if signal.off else (0.0, 0.0, 0.0)
    value, low, high = measured.value, measured.low, measured.high
    gone = lost(trace, columns) if measured.lost is None else measured.lost
    # A held signal has its tick's value until the next tick. The bounds of other signals also depend on the
    # next tick, so a gap affects the cells on both sides.
    held = signal.between is not Interpolation.BOUNDED
    cells = gone if held else or_next(gone)
    if measured.lost is None:
        value = np.where(gone, np.nan, value)
        low, high = (np.where(cells, np.nan, side) for side in (low, high))
    value_low, value_high = np.where(gone, -np.inf, value - at), value + at
    tried = measured.tried
    if tried is not None:
        error, untold = (at, gone) if measured.comes else (above, cells)
        least, most = tried[0] - error, tried[1] + error
        tried = np.where(np.isnan(least), -np.inf, least), np.where(untold | np.isnan(most), np.inf, most)
    return replace(
        measured,
        value=value,
        low=value_low if held else np.where(cells, -np.inf, low - below),
        high=value_high if held else high + above,
        value_low=value_low,
        value_high=value_high,
        lost=gone,
        tried=tried,
    )


# The functions below return the errors (at, below, above) [SI] of a signal by its uncertain columns: at the
# ticks, and below and above its bounds between them.


def by_uncertainty_of(*columns: str) -> ErrorOf:
    """Return a function that computes the errors of a signal.

    Each error is the sum of the uncertainties of ``columns``.
    """

    def errors(trace: Trace) -> tuple[float, float, float]:
        together = sum(trace.known.column(name).uncertainty for name in columns)
        return together, together, together

    return errors


def of_change(column: str) -> ErrorOf:
    """Return a function for the errors of the mean rate of ``column`` between ticks.

    The errors are in the unit of the column per second.
    """

    def errors(trace: Trace) -> tuple[float, float, float]:
        error = 2.0 * trace.known.column(column).uncertainty / trace.scenario.settings.clock.control_period_s
        return error, error, error

    return errors


def of_tcp_acceleration(trace: Trace) -> tuple[float, float, float]:
    """Return the errors of the TCP's mean acceleration between ticks.

    They follow from the errors of the joints and of their speeds.
    """
    off_mps = float(tcp_velocity_moved_mps(trace).max())
    acceleration_error = 2.0 * off_mps / trace.scenario.settings.clock.control_period_s
    return acceleration_error, acceleration_error, acceleration_error


def of_speed(speed: str, position: str) -> ErrorOf:
    """Return a function for the errors of ``speed``.

    Between ticks, they also allow for the error of ``position``.
    """

    def errors(trace: Trace) -> tuple[float, float, float]:
        at, place = (trace.known.column(name).uncertainty for name in (speed, position))
        between_ticks = float(speed_between(at, place, trace.scenario.settings.clock.control_period_s))
        return at, between_ticks, between_ticks

    return errors


def of_place(trace: Trace) -> tuple[float, float, float]:
    """Return the errors of the TCP's position.

    Between ticks, they include half of the error of the distance that it moves.
    """
    at, speed = (trace.known.column(name).uncertainty for name in (TCP, TCP_SPEED))
    between_ticks = float(place_between(at, speed, trace.scenario.settings.clock.control_period_s))
    return at, between_ticks, between_ticks


def of_nearest_hand(trace: Trace) -> tuple[float, float, float]:
    """Return the errors of the TCP's distance from the nearest hand.

    At the ticks, the error is the sum of the errors of the TCP's and the hand's position. The error of the
    lower bound also includes the joints and their deviation from linear motion. The error of the upper bound
    also includes half of the errors of the TCP's and the hand's displacements.
    """
    if follows_unknown(trace):
        return np.inf, np.inf, np.inf
    tcp, between_ticks, _ = of_place(trace)
    columns = ("joint_position_rad", "joint_velocity_radps", HANDS)
    turned_rad, faster_radps, hand = (trace.known.column(name).uncertainty for name in columns)
    turned_rad += 0.5 * trace.scenario.settings.clock.control_period_s * faster_radps
    low = max(tcp, turned_rad * float(tcp_of(trace).reach_m.sum()))
    return tcp + hand, low + hand, between_ticks + 2.0 * hand


def of_hand_distance(trace: Trace) -> tuple[Bound, Bound, Bound]:
    """Return the errors of the hand distance.

    The lower bound has the same error as the catalogue's bound. For the upper bound, the error at the ticks
    is added.
    """
    at, moved = distance_moved_m(trace)
    between_ticks, beside = np.maximum(at, moved), at + moved
    return at, np.maximum(between_ticks, _next(between_ticks)), np.maximum(beside, _next(beside))


def _next(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the value of the next tick for each tick, shape (n,)."""
    return np.append(value[1:], value[-1:])
