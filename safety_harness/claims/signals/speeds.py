"""How fast TCP and joints are, and how far they go and turn from tick to tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safety_harness.cell.simulation.worlds import WORLDS
from safety_harness.claims.signals.occasions import MOVES
from safety_harness.claims.signals.signal import Sampled, Values
from safety_harness.trace.trace import Trace


def speeds(at_tick: Values, mean: Values, *, of: str) -> Sampled:
    """Speeds at the ticks with the mean ones from tick to tick; the largest of each row.

    Within a cell each is taken to lie between its least and its largest value at both ends and in
    the mean.  Occasions: the ticks from which on it moves.

    ``at_tick`` is of shape (n, ...) and ``mean`` of shape (n-1, ...).
    """
    low, high = at_tick.copy(), at_tick.copy()
    low[:-1] = np.minimum(np.minimum(at_tick[:-1], at_tick[1:]), mean)
    high[:-1] = np.maximum(np.maximum(at_tick[:-1], at_tick[1:]), mean)
    within_a_row = tuple(range(1, at_tick.ndim))
    value, low, high, mean = (a.max(axis=within_a_row) for a in (at_tick, low, high, mean))
    moves = value - MOVES
    moves[:-1] = np.fmax(moves[:-1], mean - MOVES)
    return Sampled(value=value, low=low, high=high, tried=(moves, moves), untried=f"{of} never moves")


def tcp_way_m(trace: Trace) -> Values:
    """(n-1,) how far the TCP goes within each tick: its largest speed, at the ends or in the mean."""
    speed = trace.ticks["tcp_speed_mps"]
    steps = np.linalg.norm(np.diff(trace.ticks["transform_tcp_to_base"][:, :3, 3], axis=0), axis=1)
    way: Values = np.maximum(np.maximum(speed[:-1], speed[1:]) * np.diff(trace.time_s), steps)
    return way


def turned_rad(trace: Trace) -> Values:
    """(n-1,) by what angle the TCP can turn within each tick: those of all joints together."""
    speed = np.abs(trace.ticks["joint_velocity_radps"])
    steps = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0))
    most = np.maximum(np.maximum(speed[:-1], speed[1:]) * np.diff(trace.time_s)[:, None], steps)
    turned: Values = most.sum(axis=1)
    return turned


def known_to_radps(trace: Trace) -> float:
    """By how much [rad/s] the recorded speed of a joint may miss the commanded one in the trace's world."""
    return sum(world.known_to_radps for world in WORLDS if world.name == trace.provenance.world)


def sample_tcp_speed(trace: Trace) -> Sampled:
    """Of the TCP; between ticks the mean speed counts too."""
    at_tick = trace.ticks["tcp_speed_mps"]
    steps = np.linalg.norm(np.diff(trace.ticks["transform_tcp_to_base"][:, :3, 3], axis=0), axis=1)
    mean = steps / np.diff(trace.time_s)
    return speeds(at_tick, mean, of="the TCP")


def sample_joint_speed(trace: Trace) -> Sampled:
    """Of the fastest joint, likewise; it may be lower by what motors miss (``known_to_radps``)."""
    at_tick = np.abs(trace.ticks["joint_velocity_radps"])
    mean = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0)) / np.diff(trace.time_s)[:, None]
    found, off_radps = speeds(at_tick, mean, of="the arm"), known_to_radps(trace)
    return replace(
        found, low=found.low - off_radps, value_low=found.value - off_radps, value_high=found.value
    )
