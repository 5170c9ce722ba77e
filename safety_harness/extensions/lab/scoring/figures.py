"""Compute statistics of an avoider's answers in a region, with confidence intervals."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.proportions import LEVEL, Proportion
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import Settings, Vector3
from safety_harness.cell.avoidance.measures import WRONG_M, gained_m, is_sure, off_m, optimum_in_base_m
from safety_harness.cell.controller.desired import reachable
from safety_harness.extensions.lab.scoring.questions import Answers, Questions
from safety_harness.extensions.lab.scoring.regions import QuestionRegion
from safety_harness.extensions.lab.scoring.scorecard import Figure, RegionScore, ScoredQuestion, Spreads
from safety_harness.scenario.robots import AnyRobot

Floats = NDArray[np.float64]
ArrayN = NDArray[np.float64]  # (n,)
Matrix = tuple[Vector3, Vector3, Vector3]

COARSEST_M = 0.001  # the largest step of a number format: half precision has such steps beyond a metre
SPREAD_COUNTS = (1, 2, 3)  # multiples of the spread
WORST = 10
TAIL = (1.0 - LEVEL) / 2.0
NORMAL = 1.959964  # the 97.5 % quantile of the standard normal distribution


def quantile(values: ArrayN, share: float) -> Figure:
    """Return a quantile of n values, with an interval whose ends are order statistics.

    ``share`` is the probability level of the quantile.

    The interval is exact for any distribution.  If no order statistic bounds the quantile on one side, this
    end of the interval is infinite.
    """
    n, ordered = len(values), np.sort(values)
    # The number of values below the quantile is Bin(n, share), and bdtrik inverts this distribution.
    below, above = np.nan_to_num(scipy.special.bdtrik([TAIL, 1.0 - TAIL], n, share), nan=-1.0)
    low, high = int(np.floor(below)), int(np.ceil(above))  # 0-based: the order statistics low and high
    return Figure(
        float(np.quantile(ordered, share)),
        float(ordered[low]) if low >= 0 else -np.inf,
        float(ordered[high]) if 0 <= high < n else np.inf,
    )


def mean(values: ArrayN) -> Figure:
    """Return the mean of n values, with an interval from the normal distribution."""
    centre = float(values.mean())
    half = NORMAL * float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else np.inf
    return Figure(centre, centre - half, centre + half)


def root_mean_square(values: ArrayN) -> Figure:
    """Return the root mean square of n values.

    Its interval consists of the roots of the ends of the mean square's interval.
    """
    squares = mean(values**2)
    return Figure(*(float(np.sqrt(max(end, 0.0))) for end in (squares.value, squares.low, squares.high)))


def rank_correlation(first: ArrayN, second: ArrayN) -> Figure | None:
    """Return Spearman's rank correlation of ``first`` and ``second``, with Fisher's interval.

    The variance of Fisher's z of a rank correlation is 1.06/(n - 3) (Fieller, Hartley and Pearson, 1957).

    Both arrays contain n values.  The result is None if all values of an array are equal, or if n is below
    10.
    """
    if len(first) < 10 or np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return None
    rho = float(np.corrcoef(_ranks(first), _ranks(second))[0, 1])
    z, half = np.arctanh(np.clip(rho, -1.0 + 1e-12, 1.0 - 1e-12)), NORMAL * np.sqrt(1.06 / (len(first) - 3))
    return Figure(rho, float(np.tanh(z - half)), float(np.tanh(z + half)))


def _ranks(values: Floats) -> Floats:
    """Return the rank of each value, shape (n,); equal values have their average rank."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - 0.5 * (counts - 1))[inverse])


def region_score(
    region: QuestionRegion, questions: Questions, answers: Answers, settings: Settings
) -> RegionScore:
    """Return all statistics of one region.

    If there is no answer, the statistics of the answers are None.

    Args:
        region: The region.
        questions: Its questions.
        answers: The answers to ``questions``.
        settings: The settings of the cell.

    """
    given = answers.given
    posed, kept = questions[given], answers[given]
    step_m = number_step_m(kept.positions_in_base_m)
    figures = _figures(posed, kept, settings, region.robot, step_m) if given.any() else dict.fromkeys(_NAMES)
    return RegionScore(
        region=region.name,
        about=region.about
        if len(questions)
        else f"{region.about}; it holds no pair that a run could ask about",
        asked_in_runs=region.asked_in_runs and len(questions) > 0,
        questions=questions,
        answers=answers,
        answered=Proportion.from_rows(given) if len(questions) else None,
        worst_off=_worst(region.name, questions, answers, settings, by_gained=False),
        worst_gained=_worst(region.name, questions, answers, settings, by_gained=True),
        step_m=step_m,
        **figures,
    )


_NAMES = (
    "leads_away",
    "in_reach",
    "gained_m",
    "least_gained_m",
    "angle_rad",
    "off_rms_m",
    "off_m",
    "off_most_m",
    "bias_in_base_m",
    "pull",
    "scale",
    "spreads",
    "wrong_and_sure",
    "above_threshold",
    "stuck",
    "sure_and_unsafe",
)


def _figures(
    posed: Questions, kept: Answers, settings: Settings, robot: AnyRobot, step_m: float
) -> dict[str, object]:
    """Return the statistics in ``_NAMES`` for the given answers.

    ``kept`` contains no missing answers, and ``posed`` contains the corresponding questions.
    """
    hands, tcps, proposed = posed.hands_in_base_m, posed.tcps_in_base_m, kept.positions_in_base_m
    optimum = optimum_in_base_m(settings, hands, tcps)
    gained, off_by, error = gained_m(hands, tcps, proposed), off_m(proposed, optimum), proposed - optimum
    way_m = np.linalg.norm(proposed - tcps, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.where(way_m > 0.0, np.arccos(np.clip(gained / way_m, -1.0, 1.0)), np.pi)
    pull, scale = _slopes(hands, tcps, error)
    sure, has_threshold = is_sure(kept.spreads_m, kept.thresholds_m), np.isfinite(kept.thresholds_m)
    reached = in_reach(proposed, settings, robot)
    values = (
        Proportion.from_rows(gained >= 0.0),
        Proportion.from_rows(reached),
        (quantile(gained, 0.5), quantile(gained, 0.05)),
        float(gained.min()),
        (quantile(angle, 0.5), quantile(angle, 0.95)),
        root_mean_square(off_by),
        (quantile(off_by, 0.5), quantile(off_by, 0.95), quantile(off_by, 0.99)),
        float(off_by.max()),
        tuple(mean(axis) for axis in error.T),
        _matrix(pull),
        _matrix(scale),
        _spreads(error, posed, kept.spreads_m) if kept.spreads_m.any() else None,
        Proportion.from_rows((off_by > WRONG_M) & sure),
        Proportion.from_rows(~sure) if has_threshold.any() else None,
        _most_alike(proposed, step_m),
        Proportion.from_rows(sure & ~((gained >= 0.0) & reached)),
    )
    return dict(zip(_NAMES, values, strict=True))


def number_step_m(positions: ArrayNx3) -> float:
    """Return the largest step [m] between neighbouring numbers in the number format of ``positions``.

    The result is 0 for double precision.  It is also 0 for a step above ``COARSEST_M``, because such a step
    cannot come from a number format.
    """
    largest = np.abs(positions).max(initial=0.0)
    # The coarser format comes first, because every float16 is a float32 too.
    for kind in (np.float16, np.float32):
        if largest < 1e3 and (positions.astype(kind) == positions).all():
            step_m = float(np.spacing(kind(largest)))
            return step_m if step_m <= COARSEST_M else 0.0
    gaps = np.concatenate([np.diff(np.unique(column)) for column in positions.T])
    gaps = gaps[gaps > 1e-9]  # smaller gaps are rounding errors in multiples of the step
    step_m = float(gaps.min(initial=np.inf))
    if not 1e-8 < step_m <= COARSEST_M:
        return 0.0
    return step_m if (np.abs(gaps / step_m - np.round(gaps / step_m)) < 1e-3).all() else 0.0


def _most_alike(proposed: ArrayNx3, step_m: float) -> Proportion:
    """Return the fraction of answers with the most frequent coordinate.

    The function subtracts the fraction that rounding explains.
    """
    most = 0
    for column in proposed.T:
        _, counts = np.unique(column, return_counts=True)
        usual = np.zeros_like(counts)
        if step_m > 0.0:  # rounding explains twice the largest count of the two neighbours on either side
            around = np.pad(counts, 2)
            usual = 2 * np.max([around[k : k + len(counts)] for k in (0, 1, 3, 4)], axis=0)
        most = max(most, int((counts - usual).max()))
    return Proportion.from_rows(np.arange(len(proposed)) < most)


def in_reach(positions_in_base_m: ArrayNx3, settings: Settings, robot: AnyRobot) -> NDArray[np.bool_]:
    """Return whether each position is reachable and high enough above the table, shape (n,).

    The height must be at least the clearance of the settings.

    Args:
        positions_in_base_m: (n, 3) the positions.
        settings: The settings of the cell.
        robot: The arm.

    """
    lowest_m = settings.cell.table_height_m + settings.avoidance.table_clearance_m
    reached: NDArray[np.bool_] = reachable(positions_in_base_m, settings, robot) & (
        positions_in_base_m[:, 2] >= lowest_m
    )
    return reached


def _slopes(hands: ArrayNx3, tcps: ArrayNx3, error: ArrayNx3) -> tuple[Floats, Floats]:
    """Return the slopes of the error with respect to the hand and to the TCP, shape (3, 3) each.

    ``error`` has the shape (n, 3).  The slopes are 0 for a single row.
    """
    inputs = np.hstack([hands - hands.mean(axis=0), tcps - tcps.mean(axis=0)])
    # With this rcond, a coordinate that does not vary has the slope 0 instead of noise.
    slopes = np.linalg.lstsq(inputs, error - error.mean(axis=0), rcond=1e-9)[0].T  # (3, 6)
    return slopes[:, :3], slopes[:, 3:]


def _matrix(rows: Floats) -> Matrix:
    """Convert the matrix ``rows``, shape (3, 3), to nested tuples."""
    first, second, third = ((float(x), float(y), float(z)) for x, y, z in rows)
    return first, second, third


def _spreads(error: ArrayNx3, posed: Questions, spreads: ArrayNx3) -> Spreads:
    """Return statistics that compare ``spreads`` with the errors ``error``, shape (n, 3) each."""
    off_by, largest = np.linalg.norm(error, axis=1), spreads.max(axis=1)
    # Errors as the spreads promise them: their rank correlation is what honest spreads of this kind would
    # have.
    drawn = spreads * generator(int(posed.seeds[0]), Branch.SCORING).standard_normal(spreads.shape)
    honest = rank_correlation(largest, np.linalg.norm(drawn, axis=1))
    rms_m = float(np.sqrt((spreads**2).sum(axis=1).mean()))
    errors_m = root_mean_square(off_by)
    return Spreads(
        within=tuple(
            tuple(Proportion.from_rows(np.abs(error[:, axis]) <= k * spreads[:, axis]) for axis in range(3))  # type: ignore[misc]
            for k in SPREAD_COUNTS
        ),
        error_to_spread=Figure(errors_m.value / rms_m, errors_m.low / rms_m, errors_m.high / rms_m),
        by_axis=_by_axis(error, spreads),
        rank=rank_correlation(largest, off_by),
        honest_rank=honest.value if honest else 0.0,
        rms_m=rms_m,
    )


def _by_axis(error: ArrayNx3, spreads: ArrayNx3) -> Vector3:
    """Return the ratio of the RMS error to the RMS spread for each axis.

    The ratio is 1 if both are zero.
    """
    squares = (spreads**2).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sqrt((error**2).mean(axis=0) / squares)
    x, y, z = np.where(np.isnan(ratios), 1.0, ratios).tolist()  # no error and no spread
    return x, y, z


def asked_row(
    region: str, questions: Questions, answers: Answers, row: int, settings: Settings
) -> ScoredQuestion:
    """Return the question in ``row``, its answer, and the errors and the spread of the answer.

    Args:
        region: The region's name.
        questions: The questions.
        answers: The answers to ``questions``.
        row: The row of the question.
        settings: The settings of the cell.

    """
    single = questions[row : row + 1]
    proposed = answers.positions_in_base_m[row : row + 1]
    optimum = optimum_in_base_m(settings, single.hands_in_base_m, single.tcps_in_base_m)
    x, y, z = proposed[0].tolist()
    return ScoredQuestion(
        region,
        single.single(0),
        (x, y, z),
        float(answers.spreads_m[row].max()),
        float(off_m(proposed, optimum)[0]),
        float(gained_m(single.hands_in_base_m, single.tcps_in_base_m, proposed)[0]),
        answers.faults.get(row, ""),
    )


def _worst(
    region: str, questions: Questions, answers: Answers, settings: Settings, *, by_gained: bool
) -> tuple[ScoredQuestion, ...]:
    """Return the ``WORST`` questions with the worst answers.

    A missing answer is worse than any given answer.
    """
    hands, tcps, proposed = questions.hands_in_base_m, questions.tcps_in_base_m, answers.positions_in_base_m
    if by_gained:
        badness = -gained_m(hands, tcps, proposed)
    else:
        badness = off_m(proposed, optimum_in_base_m(settings, hands, tcps))
    order = np.argsort(-np.where(np.isfinite(badness), badness, np.inf), kind="stable")[:WORST]
    return tuple(asked_row(region, questions, answers, int(row), settings) for row in order)
