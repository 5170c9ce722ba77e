"""Search for jumps of an avoider's answers between neighbouring questions, along straight segments.

On a segment, one position moves, either of the hand or of the TCP. The remaining position and the seed are
constant. Each segment passes through a random question, and some pass through the questions with the worst
answers. For example, only a few in a thousand segments of the region pass through a given ball of hand
positions with a radius of 15 mm. The search follows the segments on which the answers change most unevenly.
On such a segment, it finds the step whose change differs most from the median change, and divides this step
into eight parts. It repeats this with the most uneven part until the ends of a part are at most ``NEAR_M``
apart. If the answers at these ends differ by more than half a millimetre, the difference is a jump and not a
steep slope.

An avoider that rounds its inputs gives equal answers within a rounding cell.  If its answers also change
steeply, they differ much between neighbouring cells.  A change is therefore no jump if two conditions are
true.  First, the answers are constant on both sides of the change.  Second, they change by at least half as
much at the borders of the next cells.  A network in int8 answers in steps.  The module assumes such steps if
it finds jumps on at least the fraction ``STEPPED`` of the followed segments.  It then ignores jumps of up to
``STEPPED_M``, which is twice the error of a predicted hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.proportions import Proportion
from safety_harness.cell.avoidance.measures import gained_m, off_m, optimum_in_base_m
from safety_harness.extensions.lab.scoring.figures import number_step_m
from safety_harness.extensions.lab.scoring.questions import Answers, Questions
from safety_harness.extensions.lab.scoring.regions import QuestionRegion
from safety_harness.extensions.lab.scoring.scorecard import AnswerChange, Jumps, Moved

Ask = Callable[[Questions], Answers]
Floats = NDArray[np.float64]

NEAR_M = 2e-9  # the length at which division ends: only a slope of 250,000 would look like a jump there
STEEP_M = (0.0003, 0.003)  # the least and largest distance of questions, about 1 mm, for the steepest change
POINTS = 13  # questions on a segment
LENGTHS_M = {Moved.HAND: 0.300, Moved.TCP: 0.120}
ANCHOR_LENGTH_M = 0.060  # of segments through the worst questions
ANCHORS = 64  # worst questions by each of three measures
FOLLOWED = 128  # followed segments that do not pass through the worst questions
PARTS = 8
CELLS_M = 2e-6 * 8.0 ** np.arange(4)  # distances from a jump; rounding to cells above 1 mm is harmful
STEPPED, STEPPED_M = 0.9, 0.020  # share of followed segments; twice the 10 mm error of a predicted hand
SAME_M = 1e-9  # if a question moves by 2 um, an avoider that does not round moves its answer farther


@dataclass(frozen=True, eq=False)
class _Segments:
    """Straight segments, on which either the hand or the TCP moves.

    A segment extends by ``half_m`` on both sides of its centre in ``middles``.  ``directions`` contains the
    unit vectors along the segments, shape (n, 3).
    """

    moved: Moved
    middles: Questions
    directions: ArrayNx3
    half_m: Floats

    def at(self, rows: NDArray[np.int64], along_m: Floats) -> Questions:
        """Return k questions on the segments ``rows``, shape (k,).

        ``along_m`` contains their distances from the centres of the segments, shape (k,).
        """
        return moved_by(self.middles[rows], self.moved, along_m[:, None] * self.directions[rows])


def moved_by(questions: Questions, moved: Moved, shifts_m: ArrayNx3) -> Questions:
    """Return copies of questions in which either the hands or the TCPs are shifted.

    Args:
        questions: The questions.
        moved: Whether to shift the hands or the TCPs.
        shifts_m: (n, 3) the shifts.

    """
    if moved is Moved.HAND:
        return Questions(questions.hands_in_base_m + shifts_m, questions.tcps_in_base_m, questions.seeds)
    return Questions(questions.hands_in_base_m, questions.tcps_in_base_m + shifts_m, questions.seeds)


def jumps_of(
    ask: Ask,
    region: QuestionRegion,
    moved: Moved,
    questions: Questions,
    answers: Answers,
    rng: np.random.Generator,
    count: int,
) -> Jumps:
    """Return the jumps on segments through the first ``count`` questions and through the worst questions.

    Args:
        ask: A function that returns the answers to questions.
        region: The region of the questions.
        moved: Whether the hand or the TCP moves.
        questions: Questions of the region.
        answers: The answers to ``questions``.
        rng: The random generator for the directions of the segments.
        count: The number of segments that do not depend on the answers; they pass through the first
            questions.

    """
    segments = _segments(region, moved, questions, answers, rng, count)
    total, per = len(segments.middles), POINTS
    grid = np.linspace(-1.0, 1.0, per)
    rows = np.repeat(np.arange(total), per)
    along_m = (segments.half_m[:, None] * grid).ravel()
    points = segments.at(rows, along_m)
    inside = region.holds(points.hands_in_base_m, points.tcps_in_base_m)
    values = np.full((total * per, 6), np.nan)
    values[inside] = _values(ask(points[inside]))
    step_m = number_step_m(values[np.isfinite(values).all(axis=1), :3])
    jumps = Jumps(region=region.name, moved=moved, step_m=step_m)
    steps = np.diff(values.reshape(total, per, 6), axis=1)
    uneven_m = _uneven_m(steps)  # (n, per - 1)
    at, best = np.argmax(uneven_m, axis=1), uneven_m.max(axis=1)
    # Follow every segment through a worst question, and only the most uneven of the others.
    first = len(segments.middles) - count  # anchors come first
    random = first + np.argsort(-best[first:], kind="stable")[:FOLLOWED]
    chosen = np.concatenate([np.arange(first), random])
    chosen = chosen[best[chosen] > 0.0]
    length_m = 2.0 * segments.half_m[chosen] / (per - 1)
    start_m = -segments.half_m[chosen] + length_m * at[chosen]
    return _followed(ask, jumps, segments, chosen, start_m, length_m)


def _segments(
    region: QuestionRegion,
    moved: Moved,
    questions: Questions,
    answers: Answers,
    rng: np.random.Generator,
    count: int,
) -> _Segments:
    """Return segments through the worst questions, then segments through the first ``count`` questions."""
    anchors = questions[_anchors(questions, answers, region)]
    middles = Questions.joined([anchors, questions[:count]])
    directions = rng.normal(size=(len(anchors) + count, 3))[: len(middles)]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    half_m = np.full(len(middles), LENGTHS_M[moved] / 2.0)
    half_m[: len(anchors)] = ANCHOR_LENGTH_M / 2.0
    return _Segments(moved, middles, directions, half_m)


def _anchors(questions: Questions, answers: Answers, region: QuestionRegion) -> NDArray[np.int64]:
    """Return the rows of the questions that are worst by at least one of three measures.

    The measures are the distance from the optimum, the component of the step towards the hand, and the ratio
    of the distance to the spread.
    """
    hands, tcps, proposed = questions.hands_in_base_m, questions.tcps_in_base_m, answers.positions_in_base_m
    off_by = off_m(proposed, optimum_in_base_m(region.settings, hands, tcps))
    badness = [off_by, -gained_m(hands, tcps, proposed), off_by / (answers.spreads_m.max(axis=1) + 1e-3)]
    # Rounding keeps equal values equal; otherwise, noise would decide their order.
    known = [np.nan_to_num(values, nan=-np.inf).round(9) for values in badness]
    worst = [np.argsort(-values, kind="stable")[:ANCHORS] for values in known]
    return np.unique(np.concatenate(worst))


def _values(answers: Answers) -> Floats:
    """Return an array with the positions and the spreads as columns, shape (n, 6)."""
    return np.hstack([answers.positions_in_base_m, answers.spreads_m])


def _size_m(changes: Floats) -> Floats:
    """Return the size of each change, shape (...).

    The size is the larger of the changes of the position and of the spread.
    """
    position, spread = np.linalg.norm(changes[..., :3], axis=-1), np.linalg.norm(changes[..., 3:], axis=-1)
    return np.asarray(np.maximum(position, spread))


def _uneven_m(steps: Floats) -> Floats:
    """Return how far each step differs from the median step of its segment, shape (n, k).

    ``steps`` has the shape (n, k, 6).  The result is 0 for a step without both answers.
    """
    known = np.isfinite(steps).all(axis=2, keepdims=True)
    with np.errstate(all="ignore"):
        filled = np.where(known, steps, np.nan)
        usual = np.nan_to_num(_nanmedian(filled))
    return np.asarray(np.nan_to_num(_size_m(filled - usual[:, None])))


def _nanmedian(values: Floats) -> Floats:
    """Return the medians over the second axis, without NaN, shape (n, 6).

    ``values`` has the shape (n, k, 6).  The function replaces ``numpy.nanmedian``, which warns if all values
    are NaN.
    """
    ordered = np.sort(values, axis=1)  # NaN last
    counts = np.isfinite(values).sum(axis=1)
    middle = np.maximum((counts - 1) // 2, 0)[:, None]
    return np.asarray(np.take_along_axis(ordered, middle, axis=1)[:, 0])


def _followed(
    ask: Ask, jumps: Jumps, segments: _Segments, rows: NDArray[np.int64], start_m: Floats, step_m: Floats
) -> Jumps:
    """Divide uneven steps, and return a copy of ``jumps`` with the jumps and the steepest change.

    The function divides one step of each of the k segments ``rows``.  The steps begin at ``start_m`` and have
    the lengths ``step_m``, shape (k,) each.  A change is a jump if it exceeds ``jumps.limit_m``.
    """
    largest: AnswerChange | None = None
    steepest: AnswerChange | None = None
    count = len(segments.middles)
    jumped_m = np.zeros(count)
    followed = stepped = len(rows)
    while len(rows):
        parts = np.arange(PARTS + 1) / PARTS
        points_m = start_m[:, None] + step_m[:, None] * parts
        points = segments.at(np.repeat(rows, PARTS + 1), points_m.ravel())
        values = _values(ask(points)).reshape(len(rows), PARTS + 1, 6)
        steps = np.diff(values, axis=1)
        best = np.argmax(_uneven_m(steps), axis=1)
        every = np.arange(len(rows))
        change_m, step_m = np.nan_to_num(_size_m(steps[every, best])), step_m / PARTS
        start_m = points_m[every, best]

        def change(k: int) -> AnswerChange:
            ends = points[np.array([k * (PARTS + 1) + best[k], k * (PARTS + 1) + best[k] + 1])]  # noqa: B023
            sizes_m = float(change_m[k]), float(step_m[k])  # noqa: B023
            return AnswerChange(segments.moved, ends.single(0), ends.single(1), *sizes_m)

        slopes = np.where((step_m >= STEEP_M[0]) & (step_m < STEEP_M[1]), change_m / step_m, 0.0)
        k = int(np.argmax(slopes))
        if slopes[k] > 0.0 and (steepest is None or slopes[k] > steepest.change_m / steepest.apart_m):
            steepest = change(k)
        done = (step_m <= NEAR_M) & (change_m > jumps.limit_m)
        stepped -= int(np.count_nonzero((change_m <= jumps.limit_m) & (step_m <= STEEP_M[1])))
        ends = (every[done] * (PARTS + 1) + best[done])[:, None] + [0, 1]
        # An avoider that rounds its inputs jumps at every cell.  Only a change beyond two such steps is a
        # jump.
        done[done] = change_m[done] > 2.0 * _beside_m(ask, segments.moved, points[ends.ravel()])
        jumped_m[rows[done]] = change_m[done]
        k = int(np.argmax(np.where(done, change_m, 0.0)))
        if done[k] and (largest is None or change_m[k] > largest.change_m):
            largest = change(k)
        kept = (step_m > NEAR_M) & ((change_m > jumps.limit_m) | (step_m > STEEP_M[1]))
        rows, start_m, step_m = rows[kept], start_m[kept], step_m[kept]
    if followed and stepped >= STEPPED * followed:
        jumps = replace(jumps, step_m=max(jumps.step_m, STEPPED_M / 2.0))
    largest = largest if largest and largest.change_m > jumps.limit_m else None
    share = Proportion.from_rows(jumped_m > jumps.limit_m) if count else None
    return replace(jumps, segments=count, jumped=share, largest=largest, steepest=steepest)


def _beside_m(ask: Ask, moved: Moved, ends: Questions) -> Floats:
    """Return how much the answer changes from each jump's ends to the next rounding cells, shape (k,) [m].

    ``ends`` contains the two ends of k jumps.

    The result is the smaller of the changes at the two ends.  It is 0 if the answers change within
    ``CELLS_M[0]``, because the avoider then does not round its inputs.
    """
    ways_m = CELLS_M[:, None, None] * np.vstack([np.eye(3), -np.eye(3)])  # (c, 6, 3)
    count, per = len(ends), ways_m.size // 3
    rows = np.repeat(np.arange(count), per)
    around = moved_by(ends[rows], moved, np.tile(ways_m.reshape(-1, 3), (count, 1)))
    own, beside = _values(ask(ends)), _values(ask(around)).reshape(count, *ways_m.shape[:2], 6)
    sizes_m = np.nan_to_num(_size_m(beside - own[:, None, None]))  # (2k, c, 6)
    # The nearest distance at which the answer changes.  If it is CELLS_M[0], the inputs are not rounded.
    first = np.argmax(sizes_m > SAME_M, axis=1)[:, None]
    moves_m = np.where(first > 0, np.take_along_axis(sizes_m, first, axis=1), 0.0)
    return np.asarray(moves_m.max(axis=(1, 2)).reshape(-1, 2).min(axis=1))
