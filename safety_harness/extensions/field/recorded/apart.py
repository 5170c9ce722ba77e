"""Compare two motions: estimate the delay, the offsets, and statistics of the difference.

Each estimate has an interval. Differences at successive ticks are almost equal, so they are not independent
samples. The intervals are therefore computed with the delete-a-block jackknife (Künsch, 1989). It cuts the
run into BLOCKS blocks, and repeats the estimate once without each of the blocks. Because the blocks are few,
the interval uses Student's t with BLOCKS - 1 degrees of freedom. The intervals are approximate, and apply to
this recording only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BLOCKS, CONFIDENCE, USUALLY = 10, 0.95, 0.95  # the number of blocks is a choice; see the module's docstring
FEWEST = 10 * BLOCKS  # samples
LONGEST_S, STEP_S = 0.25, 0.004  # the longest delay that the fit tries, and the step between delays
LEAST_RADPS = 0.01  # least root mean square of the joints' speeds about their means that shows a delay


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """An estimate with its confidence interval from ``low`` to ``high``.

    The confidence is about CONFIDENCE. Without an interval, ``low`` and ``high`` are None.
    """

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Statistics of a difference, that is, the simulated minus the recorded value of one quantity.

    The unit is ``unit``, which is rad or m. At the fraction USUALLY of the ``samples`` ticks, the absolute
    difference is at most ``usually``. The largest absolute difference is ``largest``, at the time ``at_s``.
    ``recorded_within`` is the largest uncertainty of the recorded values.
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
    """The delay and the offsets that a least-squares fit to the motion of all joints gives.

    The model of the fit is recorded(t) = simulated(t - late) + offset. ``late`` [s] is None if the motion
    shows no delay; ``why`` then states the reason. ``offsets`` [rad] are in the order of the joints.
    ``before`` [rad] is the root mean square of all joints' differences. ``left`` [rad] is the root mean
    square that remains after the fit.
    """

    late: Estimate | None
    why: str
    offsets: tuple[Estimate, ...]
    before: float
    left: float


def difference_of(
    quantity: str, unit: str, time_s: Floats, differences: Floats, recorded_within: Floats
) -> Difference | None:
    """Return the statistics of a difference, or None if there are fewer than FEWEST samples.

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
    """Return the delay and the offsets of the recorded joints relative to the simulated joints.

    Return None if there are too few samples. The fit assumes that the simulated arm stands still before its
    first sample.

    Args:
        time_s: The times (n,) of the recording [s].
        recorded: The recorded joints (n, j) [rad].
        simulated_s: The times (m,) of the simulation [s].
        simulated: The simulated joints (m, j) [rad].

    """
    most_s = min(LONGEST_S, float(simulated_s[-1]) / 8.0)
    # Every tried delay then uses the same samples, so the residuals can be compared.
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
    # The fit is linear in a small further delay, so sums over blocks suffice for the jackknife.
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
    """Return ``values`` (m, j) interpolated linearly at ``time_s`` (n,), and constant beyond the ends."""
    return np.column_stack([np.interp(time_s, known_s, column) for column in values.T])


def _normal(total: Floats, joints: int) -> Floats:
    """Return a further delay d, followed by the offsets o of the j joints, shape (1 + j,).

    They are the least-squares solution of the equation difference = o - d rate. ``total`` has the number of
    samples, and the sums of differences, rates and their products.
    """
    n, (difference, rate, both, square) = total[0], total[1:].reshape(4, joints)
    slope = (square - rate**2 / n).sum()
    more = 0.0 if slope <= 0.0 else -(both - rate * difference / n).sum() / slope
    return np.concatenate([[more], (difference + more * rate) / n])


def _jackknife(rows: Floats, estimate: Callable[[Floats], Floats]) -> tuple[Floats, Floats]:
    """Return an estimate and half the width of its interval.

    The function ``estimate`` computes the estimate from the sums of ``rows`` (n, k).
    """
    blocks = np.array([part.sum(axis=0) for part in np.array_split(rows, BLOCKS)])
    total = blocks.sum(axis=0)
    without = np.array([estimate(total - block) for block in blocks])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return estimate(total), float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2.0, BLOCKS - 1)) * spread


def _estimate(value: float, half: float) -> Estimate:
    return Estimate(value=float(value), low=float(value - half), high=float(value + half))
