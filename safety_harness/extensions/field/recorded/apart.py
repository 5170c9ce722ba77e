"""How far one motion lies from another: differences with intervals, and a delay and offsets between them.

Differences of one run follow each other closely, so that they are no independent sample.  Intervals are by
the delete-a-block jackknife (Künsch, 1989): the run is cut into BLOCKS stretches, the estimate is made
without each in turn, and Student's t with BLOCKS - 1 degrees of freedom stands for so few.  They are
approximate, and of this recording: what another would show, they do not say.
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
LONGEST_S, STEP_S = 0.25, 0.004  # of delays that are tried
LEAST_RADPS = 0.01  # root mean square of the joints' speeds about their means; with less no delay shows


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """``low`` to ``high`` with CONFIDENCE, approximately; None where too little is known for an interval."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Simulated minus recorded of one quantity, in ``unit`` (rad, m), over ``samples`` ticks.

    Its size is ``usually`` at most so much, in USUALLY of the time; ``largest`` at ``at_s``.  What was
    recorded is itself known to ``recorded_within``, so that the true largest lies that much about it.
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
    """recorded(t) = simulated(t - late) + offset of each joint, by least squares.

    ``late`` [s] is None where the joints cannot show it, and ``why`` says so; ``offsets`` [rad] in the order
    of the joints.  ``before`` and ``left`` are the root mean square of all joints' differences without it and
    after.
    """

    late: Estimate | None
    why: str
    offsets: tuple[Estimate, ...]
    before: float
    left: float


def difference_of(
    what: str, unit: str, time_s: Floats, apart: Floats, recorded_within: Floats
) -> Difference | None:
    """Of ``apart`` (n,), simulated minus recorded at ``time_s`` (n,); None for too few to say anything of.

    ``recorded_within`` (n,) is how closely the recorded is known.
    """
    if len(apart) < FEWEST:
        return None
    sums = np.column_stack([np.ones(len(apart)), apart])
    value, half = _jackknife(sums, lambda total: np.array([total[1] / total[0]]))
    worst = int(np.argmax(np.abs(apart)))
    return Difference(
        what=what,
        unit=unit,
        samples=len(apart),
        mean=_estimate(value[0], half[0]),
        usually=float(np.quantile(np.abs(apart), USUALLY, method="higher")),
        largest=float(abs(apart[worst])),
        at_s=float(time_s[worst]),
        recorded_within=float(recorded_within.max()),
    )


def fit_of(time_s: Floats, recorded: Floats, simulated_s: Floats, simulated: Floats) -> DelayFit | None:
    """Joints ``recorded`` (n, j) at ``time_s`` (n,) against ``simulated`` (m, j) at ``simulated_s`` (m,).

    None for too few samples.  Before its beginning the simulated arm stands.
    """
    most_s = min(LONGEST_S, float(simulated_s[-1]) / 8.0)
    there = time_s <= simulated_s[-1] - most_s
    time_s, recorded = time_s[there], recorded[there]
    if len(time_s) < FEWEST:
        return None

    def off(late_s: float) -> Floats:
        return recorded - _at(time_s - late_s, simulated_s, simulated)

    def left(late_s: float) -> float:
        return float(off(late_s).var(axis=0).sum())

    tried = np.arange(-most_s, most_s + STEP_S / 2.0, STEP_S)
    first = float(tried[int(np.argmin([left(one) for one in tried]))])
    bounds = max(first - STEP_S, -most_s), min(first + STEP_S, most_s)
    late_s = float(
        scipy.optimize.minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-7}).x
    )
    late_s = min((0.0, late_s, first), key=left)  # an exact one is not missed by a rounding
    rates = _at(time_s - late_s, simulated_s, np.gradient(simulated, simulated_s, axis=0))
    varied_radps = float(np.sqrt(rates.var(axis=0).sum()))
    why = ""
    if varied_radps < LEAST_RADPS:
        why = f"the joints hardly change their speed, {varied_radps:.3g} rad/s about its mean"
    elif abs(abs(late_s) - most_s) < STEP_S:
        why = f"no delay within {most_s * 1e3:.0f} ms fits better than those beyond"
    if why:
        late_s, rates = 0.0, np.zeros_like(rates)
    apart, joints = off(late_s), recorded.shape[1]
    sums = np.column_stack([np.ones(len(apart)), apart, rates, rates * apart, rates * rates])
    value, half = _jackknife(sums, lambda total: _normal(total, joints))
    return DelayFit(
        late=None if why else _estimate(late_s + value[0], half[0]),
        why=why,
        offsets=tuple(map(_estimate, value[1:], half[1:])),
        before=float(np.sqrt((off(0.0) ** 2).mean())),
        left=float(np.sqrt(((apart - value[1:] + value[0] * rates) ** 2).mean())),
    )


def _at(time_s: Floats, known_s: Floats, values: Floats) -> Floats:
    """(n, j) straight between ``values`` (m, j), and the first of them before."""
    return np.column_stack([np.interp(time_s, known_s, column) for column in values.T])


def _normal(total: Floats, joints: int) -> Floats:
    """(1 + j,) a further delay d and offsets o: the least squares of apart = o - d rate, from their sums."""
    n, (apart, rate, both, square) = total[0], total[1:].reshape(4, joints)
    slope = (square - rate**2 / n).sum()
    more = 0.0 if slope <= 0.0 else -(both - rate * apart / n).sum() / slope
    return np.concatenate([[more], (apart + more * rate) / n])


def _jackknife(rows: Floats, of: Callable[[Floats], Floats]) -> tuple[Floats, Floats]:
    """An estimate from sums of ``rows`` (n, k), and half of its interval's length."""
    blocks = np.array([part.sum(axis=0) for part in np.array_split(rows, BLOCKS)])
    total = blocks.sum(axis=0)
    without = np.array([of(total - block) for block in blocks])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return of(total), float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2.0, BLOCKS - 1)) * spread


def _estimate(value: float, half: float) -> Estimate:
    return Estimate(value=float(value), low=float(value - half), high=float(value + half))
