"""Estimate how far the hands' clock is ahead of the joints' clock, from a body that both streams show.

Such a body moves with the tool: a marker on the flange, or a hand that holds on to the tool. Its position in
the base frame is p(t + d) = R(t) c + x(t), where d is the lead. The joints determine the rotation R and the
position x of the tool. The position c of the body in the tool's frame is constant but unknown. A
least-squares fit estimates d and c.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import sqrt

import numpy as np
import scipy
from numpy.typing import NDArray

from safety_harness.base.exceptions import LogError
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.extensions.field.logs.model import Body, CellLog

Floats = NDArray[np.float64]
GRID_S = 0.01  # the step of the search for peaks, before the least squares
NEAR_S = 0.1  # the distance from a peak within which the least squares search
PEAKS = 16  # the number of peaks that are tried, the best correlated first
ALIKE = 2.0  # two offsets fit alike if their root mean square errors differ by at most this factor
PARTS, LEVEL = 8, 0.99  # parts of the recording with an estimate each; level of the estimates' interval
LEAST_S, FEWEST = 4.0, 100  # the shortest time of joints and body; the fewest samples of the body
LEAST_EXPLAINED = 0.95  # the least share of the body's variance that the arm's motion explains
LEAST_MOVED_M = 0.05  # the least root mean square of the body's places about their mean


@dataclass(frozen=True, kw_only=True)
class Offset:
    """The offset between two clocks: the hands' clock is ahead of the joints' clock by ``hands_ahead_s``.

    The uncertainty of this offset is ``known_to_s``. It covers each of the estimates ``parts_s`` and their
    confidence interval. Each part of the recording provides one estimate. ``off_m`` is the root mean square
    error that remains after the fit. ``explained`` is the fraction of the variance of the body's position
    that the arm's motion explains.
    """

    hands_ahead_s: float
    known_to_s: float
    parts_s: tuple[float, ...]
    off_m: float
    explained: float


def align(log: CellLog, body: Body) -> Offset:
    """Return the lead of the hands' clock over the joints' clock.

    Args:
        log: The log.
        body: The body that moves with the tool.

    Raises:
        LogError: The body does not move with the tool, the recording is too short, or the motion repeats
            itself.

    """
    joints_s, count = log.seconds(log.joints), log.joints.values.shape[1] // 2
    arm = arm_model(log.robot)
    tools = np.array([links_in_base(arm, row[:count].copy())[-1] for row in log.joints.values])
    body_s, places = log.seconds(body.hand), body.hand.values
    if len(body_s) < FEWEST or body_s[-1] - body_s[0] < LEAST_S or joints_s[-1] - joints_s[0] < LEAST_S:
        got = f"{len(body_s)} of the body in {body_s[-1] - body_s[0]:.4g} s, "
        got += f"{len(joints_s)} of the joints in {joints_s[-1] - joints_s[0]:.4g} s"
        raise _refused(body, f"{FEWEST} samples at least, in {LEAST_S:g} s or more, of body and joints", got)
    moved_m = float(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if moved_m < LEAST_MOVED_M:
        expected = f"a body that moves with the tool, by {LEAST_MOVED_M * 1e3:g} mm at least"
        raise _refused(body, expected, f"one that moves by {moved_m * 1e3:.3g} mm")
    fit = _Fit(joints_s, tools, body_s, places)
    every = np.ones(len(body_s), bool)
    peaks_s = _peaks_s(joints_s, tools[:, :3, 3], body_s, places)
    # Correlated speeds only suggest offsets; the least squares of positions decide among them.
    fits = [(near_s, *fit.best(near_s, every)) for near_s in peaks_s]
    _, ahead_s, residual = min(fits, key=lambda peak: peak[2])
    there = fit.there(ahead_s, every)
    centred = places[there] - places[there].mean(axis=0)
    explained = 1.0 - residual / float((centred**2).sum())
    if explained < LEAST_EXPLAINED or there.sum() < FEWEST:
        got = f"a body of whose motion the joints explain {max(explained, 0.0):.0%}"
        hint = "a marker on the tool, or a hand that holds on to it; in the base frame, by the key frame"
        raise _refused(body, "a body that moves with the tool", got, hint)
    # an offset at the edge of its search range is no minimum, since the error falls beyond the edge
    own = [(peak, left) for start_s, peak, left in fits if abs(peak - start_s) < NEAR_S - GRID_S]
    alike = [peak for peak, left in own if left < ALIKE**2 * residual and abs(peak - ahead_s) > NEAR_S]
    if alike:
        them = ", ".join(f"{peak * 1e3:.0f}" for peak in sorted([ahead_s, *alike]))
        hint = "a motion that does not repeat itself, or the part that has one: log: {from: ..., to: ...}"
        raise _refused(
            body,
            "a motion that only a single offset explains",
            f"ahead by {them} ms, which explain it alike",
            hint,
        )
    edges = np.linspace(body_s[there][0], body_s[there][-1], PARTS + 1)
    parts = []
    for begin, end in itertools.pairwise(edges):
        inside = (body_s >= begin) & (body_s <= end)
        parts.append(fit.best(ahead_s, inside)[0])
    spread_s = float(np.std(parts, ddof=1))
    half_s = float(scipy.stats.t.ppf(0.5 + LEVEL / 2.0, PARTS - 1)) * spread_s
    return Offset(
        hands_ahead_s=ahead_s,
        # The largest deviation of a part, plus the half width of Student's interval of their mean.
        known_to_s=float(np.abs(np.array(parts) - ahead_s).max()) + half_s / sqrt(PARTS),
        parts_s=tuple(parts),
        off_m=float(np.sqrt(residual / there.sum())),
        explained=explained,
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    joints_s: Floats
    tools: Floats  # (n, 4, 4) tool to base
    body_s: Floats
    places: Floats  # (m, 3)

    def there(self, ahead_s: float, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which ``chosen`` samples lie within the time of the joints' samples, shape (m,)."""
        at = self.body_s - ahead_s
        return np.asarray(chosen & (at >= self.joints_s[0]) & (at <= self.joints_s[-1]))

    def residual(self, ahead_s: float, chosen: NDArray[np.bool_]) -> float:
        """Return the sum of squared errors [m2] if the body is assumed to be fixed to the tool.

        The position of the body in the tool's frame is fitted by least squares. The result is infinite if
        there are fewer than 10 samples. If only some of the chosen samples are used, the sum is scaled to all
        of them.
        """
        there = self.there(ahead_s, chosen)
        if there.sum() < 10:
            return float("inf")
        at = self.body_s[there] - ahead_s
        poses = np.empty((len(at), 3, 4))
        for i in range(3):
            for j in range(4):
                poses[:, i, j] = np.interp(at, self.joints_s, self.tools[:, i, j])
        turned, beside = poses[:, :, :3].reshape(-1, 3), (self.places[there] - poses[:, :, 3]).reshape(-1)
        # The body is fixed to the tool: place = position + R offset is linear in the offset, for all samples
        # together.
        offset_m = np.linalg.lstsq(turned, beside, rcond=None)[0]
        return float(((beside - turned @ offset_m) ** 2).sum() / there.sum() * chosen.sum())

    def best(self, near_s: float, chosen: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the offset with the least residual within ``NEAR_S`` of ``near_s``, and this residual."""
        tried = near_s + np.arange(-NEAR_S, NEAR_S + 1e-9, GRID_S / 2.0)
        first = float(tried[int(np.argmin([self.residual(ahead_s, chosen) for ahead_s in tried]))])
        bounds = first - GRID_S, first + GRID_S
        least = scipy.optimize.minimize_scalar(
            self.residual, bounds=bounds, args=(chosen,), method="bounded", options={"xatol": 1e-6}
        )
        return float(least.x), float(least.fun)


def _peaks_s(joints_s: Floats, tool_m: Floats, body_s: Floats, places: Floats) -> list[float]:
    """Return the offsets [s] at which tool speed and body speed correlate best, the best offset first.

    At each offset the two series overlap by at least half of the shorter one.
    """
    tool, body = _speed(joints_s, tool_m), _speed(body_s, places)
    products = scipy.signal.correlate(body, tool, method="fft")
    overlap = scipy.signal.correlate(np.ones(len(body)), np.ones(len(tool)), method="fft")
    power = np.sqrt(
        np.maximum(scipy.signal.correlate(body**2, np.ones(len(tool)), method="fft"), 1e-12)
        * np.maximum(scipy.signal.correlate(np.ones(len(body)), tool**2, method="fft"), 1e-12)
    )
    # The normalised correlation; with a short overlap, it would be high by chance.
    alike = np.where(overlap >= 0.5 * min(len(body), len(tool)), products / power, -np.inf)
    padded = np.pad(alike, 1, constant_values=-np.inf)  # for peaks at the ends
    peaks = scipy.signal.find_peaks(padded, distance=NEAR_S / GRID_S)[0] - 1
    steps = peaks[np.argsort(-alike[peaks])][:PEAKS] - (len(tool) - 1)
    return [float(body_s[0] - joints_s[0] + step * GRID_S) for step in steps]


def _speed(time_s: Floats, places: Floats) -> Floats:
    """Return the speed of the positions ``places`` on a regular time grid, minus the mean speed."""
    grid_s = np.arange(time_s[0], time_s[-1], GRID_S)
    path = np.column_stack([np.interp(grid_s, time_s, column) for column in places.T])
    window = np.ones(9) / 9.0  # a mean over 90 ms, since single differences would show only noise
    smooth = np.column_stack([np.convolve(column, window, mode="same") for column in path.T])
    speed = np.linalg.norm(np.gradient(smooth, GRID_S, axis=0), axis=1)
    speed[:9] = speed[-9:] = np.median(speed)  # the window reaches over the ends
    return np.asarray(speed - speed.mean())


def _refused(body: Body, expected: str, got: str, hint: str = "") -> LogError:
    source = body.hand.source
    return LogError(place=source.place, expected=f"{expected}, in {source.name}", got=got, hint=hint)


def clock_line(offset: Offset) -> str:
    """Return the line ``clock`` for LOG.yaml, with the uncertainty rounded up."""
    known_ms = np.ceil(offset.known_to_s * 1e4) / 10.0 + 0.1  # 0.1 ms for the rounding of the offset
    return f"clock: {{hands are ahead by: {offset.hands_ahead_s * 1e3:.1f} ms, known to: {known_ms:.1f} ms}}"
