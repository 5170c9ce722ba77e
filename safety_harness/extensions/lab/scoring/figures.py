"""The figures of one region, with intervals, which describe the quality of an avoider's answers."""

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
NORMAL = 1.959964


def quantile(values: ArrayN, share: float) -> Figure:
    """Return the ``share`` quantile of ``values`` (n,); order statistics are the ends of its interval.

    The interval is exact for any distribution.  An end is infinite if no value bounds it.
    """
    n, ordered = len(values), np.sort(values)
    below, above = np.nan_to_num(scipy.special.bdtrik([TAIL, 1.0 - TAIL], n, share), nan=-1.0)
    low, high = int(np.floor(below)), int(np.ceil(above))  # 0-based: the order statistics low and high
    return Figure(
        float(np.quantile(ordered, share)),
        float(ordered[low]) if low >= 0 else -np.inf,
        float(ordered[high]) if 0 <= high < n else np.inf,
    )


def mean(values: ArrayN) -> Figure:
    """Return the mean of ``values`` (n,), with an interval from the normal distribution."""
    centre = float(values.mean())
    half = NORMAL * float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else np.inf
    return Figure(centre, centre - half, centre + half)


def root_mean_square(values: ArrayN) -> Figure:
    """Return the root mean square of ``values`` (n,), with the roots of the mean square's interval."""
    squares = mean(values**2)
    return Figure(*(float(np.sqrt(max(end, 0.0))) for end in (squares.value, squares.low, squares.high)))


def rank_correlation(first: ArrayN, second: ArrayN) -> Figure | None:
    """Return Spearman's rank correlation of ``first`` and ``second`` (n,), with Fisher's interval.

    The result is None if one array is constant or if n is below 10.
    """
    if len(first) < 10 or np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return None
    rho = float(np.corrcoef(_ranks(first), _ranks(second))[0, 1])
    z, half = np.arctanh(np.clip(rho, -1.0 + 1e-12, 1.0 - 1e-12)), NORMAL * 1.06 / np.sqrt(len(first) - 3)
    return Figure(rho, float(np.tanh(z - half)), float(np.tanh(z + half)))


def _ranks(values: Floats) -> Floats:
    """Return the ranks (n,) of ``values``; equal values share their average rank."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - 0.5 * (counts - 1))[inverse])


def region_score(
    region: QuestionRegion, questions: Questions, answers: Answers, settings: Settings
) -> RegionScore:
    """Return all figures of one region; the figures of answers are None if there is no answer.

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
    """Return the figures of ``_NAMES`` for the existing answers ``kept`` to the questions ``posed``."""
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
    """Return the largest step [m] of the number format of ``positions`` (n, 3).

    The result is 0 for double precision.  It is also 0 for a step above ``COARSEST_M``, which no number
    format has.
    """
    largest = np.abs(positions).max(initial=0.0)
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
    """Return the share of answers with the most frequent coordinate, less the share due to rounding."""
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
    """Return whether (n,) the arm reaches each position, at least the clearance above the table.

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
    """Return the growth of ``error`` (n, 3) with the hand and the TCP, (3, 3) each; 0 for a single row."""
    inputs = np.hstack([hands - hands.mean(axis=0), tcps - tcps.mean(axis=0)])
    slopes = np.linalg.lstsq(inputs, error - error.mean(axis=0), rcond=1e-9)[0].T  # (3, 6)
    return slopes[:, :3], slopes[:, 3:]


def _matrix(rows: Floats) -> Matrix:
    """Return the matrix ``rows`` (3, 3) as nested tuples."""
    first, second, third = ((float(x), float(y), float(z)) for x, y, z in rows)
    return first, second, third


def _spreads(error: ArrayNx3, posed: Questions, spreads: ArrayNx3) -> Spreads:
    """Return the figures of ``spreads`` (n, 3) beside the errors ``error`` (n, 3)."""
    off_by, largest = np.linalg.norm(error, axis=1), spreads.max(axis=1)
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
    """Return the rms error divided by the rms spread for each axis; 1 if both are zero."""
    squares = (spreads**2).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sqrt((error**2).mean(axis=0) / squares)
    x, y, z = np.where(np.isnan(ratios), 1.0, ratios).tolist()  # no error and no spread
    return x, y, z


def asked_row(
    region: str, questions: Questions, answers: Answers, row: int, settings: Settings
) -> ScoredQuestion:
    """Return the question in ``row``, with its answer and the figures of the answer.

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
    """Return the ``WORST`` questions with the worst answers; a missing answer is worse than a given one."""
    hands, tcps, proposed = questions.hands_in_base_m, questions.tcps_in_base_m, answers.positions_in_base_m
    if by_gained:
        badness = -gained_m(hands, tcps, proposed)
    else:
        badness = off_m(proposed, optimum_in_base_m(settings, hands, tcps))
    order = np.argsort(-np.where(np.isfinite(badness), badness, np.inf), kind="stable")[:WORST]
    return tuple(asked_row(region, questions, answers, int(row), settings) for row in order)
