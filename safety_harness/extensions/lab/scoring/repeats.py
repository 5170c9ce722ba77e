"""Check repeatability: an avoider must always give the same answers to the same questions.

The module repeats the questions in several ways and compares the bits of the answers with the first answers.
Findings ignore differences of less than a nanometre, because the size of a batch may change the order of a
sum.  The answers of a faulty avoider may depend on earlier questions, on the time, on other questions in the
batch, or on the process.  At least one of the ways of asking reveals each of these faults.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.avoiders import is_executed, resolve_avoider, scenario_of_avoider
from safety_harness.base.exceptions import Place
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.isolation.apart import processes_apart
from safety_harness.extensions.lab.scoring.asking import asked_alone, asked_together
from safety_harness.extensions.lab.scoring.questions import Answers, Questions
from safety_harness.extensions.lab.scoring.scorecard import AskedAgain, WayOfAsking

NEAR_M = 0.002  # the difference of a question that is nearly the same
INTERLEAVED = 200  # the most questions to two instances in turn, which answer them one at a time


@dataclass(frozen=True, eq=False)
class Subject:
    """An avoider under test: its reference, an instance, and functions that create further instances.

    ``reference`` has the same form as for ``--avoider``.

    ``another`` creates an instance in the same way as a run does; such instances may share a process.
    ``apart`` creates an instance that shares as little as possible with other instances.  If ``in_process``
    is False, this instance has its own process.
    """

    reference: str
    avoider: Avoider
    another: Callable[[], Avoider]
    apart: Callable[[], Avoider]
    in_process: bool = True

    @classmethod
    def from_reference(cls, reference: str, place: Place | None = None) -> Subject:
        """Return the subject for the avoider ``reference``.

        The errors of ``resolve_avoider`` refer to ``place``.
        """
        scenario, at = scenario_of_avoider(reference), place or Place(field="--avoider")

        def separate() -> Avoider:
            with processes_apart():
                return resolve_avoider(scenario, at)

        def another() -> Avoider:
            return resolve_avoider(scenario, at)

        return cls(reference, another(), another, separate, not is_executed(reference))

    @classmethod
    def made_by(cls, make: Callable[[], Avoider], reference: str) -> Subject:
        """Return a subject whose instances ``make`` creates in this process."""
        return cls(reference, make(), make, make)


def repeats(subject: Subject, sample: Questions, first: Answers, alone: int) -> Iterator[AskedAgain]:
    """Repeat the questions in every way except ``ALONE`` and ``LATER``, and yield the comparisons.

    Args:
        subject: The avoider.
        sample: The questions.
        first: The answers to ``sample`` that the avoider gave before any other question.
        alone: The largest number of questions to ask one at a time.

    """
    avoider, outside = subject.avoider, not subject.in_process
    yield compared(WayOfAsking.AGAIN, sample, first, asked_together(avoider, sample))
    order = np.random.default_rng(len(sample)).permutation(len(sample))
    yield compared(WayOfAsking.ORDER, sample[order], first[order], asked_together(avoider, sample[order]))
    yield compared(WayOfAsking.FRESH, sample, first, asked_together(subject.apart(), sample), outside=outside)
    mixed, own = after_others(sample)
    answers = asked_together(subject.apart(), mixed)[own]
    yield compared(WayOfAsking.AFTER_OTHERS, sample, first, answers, outside=outside)
    few = min(len(sample), alone, INTERLEAVED)
    yield compared(WayOfAsking.INTERLEAVED, sample[:few], first[:few], _in_turn(subject, sample[:few]))


def _in_turn(subject: Subject, sample: Questions) -> Answers:
    """Return the answers of one of two instances that answer alternately.

    The second instance receives the questions in reverse order.
    """
    first, second = subject.another(), subject.another()
    answers = []
    for row in range(len(sample)):
        answers.append(asked_alone(first, sample[row : row + 1])[0])
        asked_alone(second, sample[len(sample) - 1 - row :][:1])
    return Answers.joined(answers)


def compared(
    mode: WayOfAsking, sample: Questions, first: Answers, second: Answers, *, outside: bool = False
) -> AskedAgain:
    """Compare the bits of first and second answers to the same questions.

    Args:
        mode: The way in which the questions were repeated.
        sample: The questions.
        first: The first answers.
        second: The second answers.
        outside: Whether the second answers come from another process.

    """
    mine, theirs = _numbers(first), _numbers(second)
    differs = (mine.view(np.uint64) != theirs.view(np.uint64)).any(axis=1)
    # Two missing answers are equal, whatever bits their NaN have.
    differs &= np.isfinite(mine[:, :6]).all(axis=1) | np.isfinite(theirs[:, :6]).all(axis=1)
    faults = [first.faults.get(row) != second.faults.get(row) for row in range(len(sample))]
    differs |= np.array(faults, dtype=np.bool_)
    rows = np.flatnonzero(differs)
    apart_m = np.abs(mine[rows] - theirs[rows])
    apart_m[np.isnan(mine[rows, 6]) & np.isnan(theirs[rows, 6]), 6] = 0.0  # no threshold, both times
    return AskedAgain(
        way=mode,
        questions=len(sample),
        differ=len(rows),
        largest_m=float(np.nan_to_num(apart_m, nan=np.inf).max(initial=0.0)),
        first=sample.single(int(rows[0])) if len(rows) else None,
        apart=outside,
    )


def _numbers(answers: Answers) -> NDArray[np.float64]:
    """Return an array with the positions, spreads and thresholds as columns, shape (n, 7)."""
    return np.ascontiguousarray(
        np.column_stack([answers.positions_in_base_m, answers.spreads_m, answers.thresholds_m])
    )


def after_others(sample: Questions) -> tuple[Questions, NDArray[np.int64]]:
    """Insert a different question before each question, and return all questions.

    The second result contains the rows of the original questions.

    Four kinds of inserted questions alternate: nearly the same question, another hand, another TCP, and both
    another hand and another TCP.
    """
    n = len(sample)
    rows, turn = np.arange(n), np.arange(n) % 4
    next_one = (rows + 1) % n
    shift = np.where((turn == 0)[:, None], NEAR_M / 2.0, 0.0)
    hands = np.where(
        ((turn == 1) | (turn == 3))[:, None], sample.hands_in_base_m[next_one], sample.hands_in_base_m
    )
    tcps = np.where((turn >= 2)[:, None], sample.tcps_in_base_m[next_one], sample.tcps_in_base_m)
    different = Questions(hands + shift, tcps - shift, sample.seeds[next_one])
    mixed = Questions.joined([different, sample])
    order = np.stack([rows, rows + n], axis=1).ravel()
    return mixed[order], 2 * rows + 1
