"""The difference between two motions: statistics with intervals, and a delay and offsets between them.

Successive differences in a run are almost equal, so they are no independent sample. Intervals come from the
delete-a-block jackknife (Künsch, 1989). It cuts the run into BLOCKS blocks, and repeats the estimate with one
block left out at a time. Because the blocks are few, the interval uses Student's t with BLOCKS - 1 degrees of
freedom. The intervals are approximate, and apply to this recording only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BLOCKS, CONFIDENCE, USUALLY = 10, 0.95, 0.95
FEWEST = 10 * BLOCKS  # samples
LONGEST_S, STEP_S = 0.25, 0.004  # the longest delay that the fit tries, and the step between delays
LEAST_RADPS = 0.01  # least root mean square of the joints' speeds about their means that shows a delay


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A value with its interval ``low`` to ``high`` at about CONFIDENCE; both are None if there is none."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Statistics of simulated minus recorded values of one quantity, in ``unit`` (rad, m).

    At a share USUALLY of the ``samples`` ticks, the absolute difference is at most ``usually``. The largest
    difference is ``largest``, at ``at_s``. It is uncertain by ``recorded_within``, as the recording is.
    """

    what: str
    unit: str
    samples: int
    mean: Estimate
    usually: float
    largest: float
    at_s: float
    recorded_within: float


@dataclass(frozen=True, kw_only=True)
class DelayFit:
    """The least-squares fit of recorded(t) = simulated(t - late) + offset to the motion of all joints.

    ``late`` [s] is None if the motion shows no delay, for the reason ``why``. ``offsets`` [rad] are in the
    order of the joints. ``before`` [rad] is the root mean square of all joints' differences. ``left`` [rad]
    is the root mean square that remains after the fit.
    """

    late: Estimate | None
    why: str
    offsets: tuple[Estimate, ...]
    before: float
    left: float


def difference_of(
    quantity: str, unit: str, time_s: Floats, differences: Floats, recorded_within: Floats
) -> Difference | None:
    """Return the statistics of a difference; None for fewer than FEWEST samples.

    Args:
        quantity: The name of the quantity.
        unit: Its unit.
        time_s: The times (n,) [s].
        differences: Simulated minus recorded (n,), in ``unit``.
        recorded_within: The uncertainty (n,) of the recorded values, in ``unit``.

    """
    if len(differences) < FEWEST:
        return None
    sums = np.column_stack([np.ones(len(differences)), differences])
    value, half = _jackknife(sums, lambda total: np.array([total[1] / total[0]]))
    worst = int(np.argmax(np.abs(differences)))
    return Difference(
        what=quantity,
        unit=unit,
        samples=len(differences),
        mean=_estimate(value[0], half[0]),
        usually=float(np.quantile(np.abs(differences), USUALLY, method="higher")),
        largest=float(abs(differences[worst])),
        at_s=float(time_s[worst]),
        recorded_within=float(recorded_within.max()),
    )


def fit_of(time_s: Floats, recorded: Floats, simulated_s: Floats, simulated: Floats) -> DelayFit | None:
    """Return the delay and offsets of recorded joints against simulated joints; None for too few samples.

    The fit assumes that the simulated arm stands still before its first sample.

    Args:
        time_s: The times (n,) of the recording [s].
        recorded: The recorded joints (n, j) [rad].
        simulated_s: The times (m,) of the simulation [s].
        simulated: The simulated joints (m, j) [rad].

    """
    most_s = min(LONGEST_S, float(simulated_s[-1]) / 8.0)
    there = time_s <= simulated_s[-1] - most_s
    time_s, recorded = time_s[there], recorded[there]
    if len(time_s) < FEWEST:
        return None

    def differences(late_s: float) -> Floats:
        return recorded - _at(time_s - late_s, simulated_s, simulated)

    def left(late_s: float) -> float:
        return float(differences(late_s).var(axis=0).sum())

    tried = np.arange(-most_s, most_s + STEP_S / 2.0, STEP_S)
    first = float(tried[int(np.argmin([left(delay) for delay in tried]))])
    bounds = max(first - STEP_S, -most_s), min(first + STEP_S, most_s)
    late_s = float(
        scipy.optimize.minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-7}).x
    )
    late_s = min((0.0, late_s, first), key=left)  # so that rounding does not miss an exact delay
    rates = _at(time_s - late_s, simulated_s, np.gradient(simulated, simulated_s, axis=0))
    varied_radps = float(np.sqrt(rates.var(axis=0).sum()))
    why = ""
    if varied_radps < LEAST_RADPS:
        why = f"the joints hardly change their speed, {varied_radps:.3g} rad/s about its mean"
    elif abs(abs(late_s) - most_s) < STEP_S:
        why = f"no delay within {most_s * 1e3:.0f} ms fits better than those beyond"
    if why:
        late_s, rates = 0.0, np.zeros_like(rates)
    rest, joints = differences(late_s), recorded.shape[1]
    sums = np.column_stack([np.ones(len(rest)), rest, rates, rates * rest, rates * rates])
    value, half = _jackknife(sums, lambda total: _normal(total, joints))
    return DelayFit(
        late=None if why else _estimate(late_s + value[0], half[0]),
        why=why,
        offsets=tuple(map(_estimate, value[1:], half[1:])),
        before=float(np.sqrt((differences(0.0) ** 2).mean())),
        left=float(np.sqrt(((rest - value[1:] + value[0] * rates) ** 2).mean())),
    )


def _at(time_s: Floats, known_s: Floats, values: Floats) -> Floats:
    """Return (n, j) ``values`` (m, j) interpolated linearly at ``time_s`` (n,), constant beyond the ends."""
    return np.column_stack([np.interp(time_s, known_s, column) for column in values.T])


def _normal(total: Floats, joints: int) -> Floats:
    """Return (1 + j,) a further delay d and offsets o, from the least squares of difference = o - d rate.

    ``total`` has the sums of differences, rates and their products over the samples.
    """
    n, (difference, rate, both, square) = total[0], total[1:].reshape(4, joints)
    slope = (square - rate**2 / n).sum()
    more = 0.0 if slope <= 0.0 else -(both - rate * difference / n).sum() / slope
    return np.concatenate([[more], (difference + more * rate) / n])


def _jackknife(rows: Floats, estimate: Callable[[Floats], Floats]) -> tuple[Floats, Floats]:
    """Return the ``estimate`` from the sums of ``rows`` (n, k), and half of its interval's length."""
    blocks = np.array([part.sum(axis=0) for part in np.array_split(rows, BLOCKS)])
    total = blocks.sum(axis=0)
    without = np.array([estimate(total - block) for block in blocks])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return estimate(total), float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2.0, BLOCKS - 1)) * spread


def _estimate(value: float, half: float) -> Estimate:
    return Estimate(value=float(value), low=float(value - half), high=float(value + half))
