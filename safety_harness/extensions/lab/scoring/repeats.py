"""Does an avoider answer the same questions alike, however they are asked?

Its answers are compared by their bits with those of the very first time (of what differs by less than a
nanometre findings say nothing: the order of a sum may hang on the size of a batch).  What remembers, looks
at the clock, mixes the questions of a batch or is made otherwise in every process differs somewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.avoiders import is_executed, resolve_avoider, scenario_of_avoider
from safety_harness.base.exceptions import Place
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.isolation.isolated import processes_apart
from safety_harness.extensions.lab.scoring.asking import asked_alone, asked_together
from safety_harness.extensions.lab.scoring.questions import Answers, Questions
from safety_harness.extensions.lab.scoring.scorecard import AskedAgain, WayOfAsking

NEAR_M = 0.002  # a question that is nearly the same
INTERLEAVED = 200  # questions at most: both instances are asked alone


@dataclass(frozen=True, eq=False)
class Subject:
    """Who is asked: a reference as ``--avoider`` takes it, the avoider, and how to make another.

    ``another`` makes one that shares what the first one's process shares; ``apart`` one that shares as little
    as can be, in a process of its own where ``in_process`` is False.
    """

    reference: str
    avoider: Avoider
    another: Callable[[], Avoider]
    apart: Callable[[], Avoider]
    in_process: bool = True

    @classmethod
    def of(cls, reference: str, place: Place | None = None) -> Subject:
        """Any avoider by its reference; errors as of ``resolve_avoider``, at ``place``."""
        scenario, at = scenario_of_avoider(reference), place or Place(field="--avoider")

        def apart() -> Avoider:
            with processes_apart():
                return resolve_avoider(scenario, at)

        def another() -> Avoider:
            return resolve_avoider(scenario, at)

        return cls(reference, another(), another, apart, not is_executed(reference))

    @classmethod
    def made_by(cls, make: Callable[[], Avoider], reference: str) -> Subject:
        """One that ``make`` makes in this process."""
        return cls(reference, make(), make, make)


def repeats(subject: Subject, sample: Questions, first: Answers, alone: int) -> Iterator[AskedAgain]:
    """Every way but ``ALONE`` and ``LATER``; ``first`` has the answers of when nothing else had been asked.

    At most ``alone`` questions are asked one at a time.
    """
    avoider, apart = subject.avoider, not subject.in_process
    yield compared(WayOfAsking.AGAIN, sample, first, asked_together(avoider, sample))
    order = np.random.default_rng(len(sample)).permutation(len(sample))
    yield compared(WayOfAsking.ORDER, sample[order], first[order], asked_together(avoider, sample[order]))
    yield compared(WayOfAsking.FRESH, sample, first, asked_together(subject.apart(), sample), apart=apart)
    mixed, own = after_others(sample)
    told = asked_together(subject.apart(), mixed)[own]
    yield compared(WayOfAsking.AFTER_OTHERS, sample, first, told, apart=apart)
    few = min(len(sample), alone, INTERLEAVED)
    yield compared(WayOfAsking.INTERLEAVED, sample[:few], first[:few], _in_turn(subject, sample[:few]))


def _in_turn(subject: Subject, sample: Questions) -> Answers:
    """The answers of one instance, between whose questions another is asked the same from the last on."""
    one, other = subject.another(), subject.another()
    answers = []
    for row in range(len(sample)):
        answers.append(asked_alone(one, sample[row : row + 1])[0])
        asked_alone(other, sample[len(sample) - 1 - row :][:1])
    return Answers.joined(answers)


def compared(
    way: WayOfAsking, sample: Questions, first: Answers, second: Answers, *, apart: bool = False
) -> AskedAgain:
    """Two times the answers to the same questions, by their bits."""
    one, other = _numbers(first), _numbers(second)
    differs = (one.view(np.uint64) != other.view(np.uint64)).any(axis=1)
    differs &= np.isfinite(one[:, :6]).all(axis=1) | np.isfinite(other[:, :6]).all(axis=1)
    faults = [first.faults.get(row) != second.faults.get(row) for row in range(len(sample))]
    differs |= np.array(faults, dtype=np.bool_)
    rows = np.flatnonzero(differs)
    apart_m = np.abs(one[rows] - other[rows])
    apart_m[np.isnan(one[rows, 6]) & np.isnan(other[rows, 6]), 6] = 0.0  # no threshold, both times
    return AskedAgain(
        way=way,
        questions=len(sample),
        differ=len(rows),
        largest_m=float(np.nan_to_num(apart_m, nan=np.inf).max(initial=0.0)),
        first=sample.one(int(rows[0])) if len(rows) else None,
        apart=apart,
    )


def _numbers(answers: Answers) -> NDArray[np.float64]:
    """(n, 7) positions, spreads, thresholds."""
    return np.ascontiguousarray(
        np.column_stack([answers.positions_in_base_m, answers.spreads_m, answers.thresholds_m])
    )


def after_others(sample: Questions) -> tuple[Questions, NDArray[np.int64]]:
    """Each question after another one, and where it stands.

    The other one is, by turns, nearly the same, with another hand, with another TCP, and another altogether.
    """
    n = len(sample)
    rows, by = np.arange(n), np.arange(n) % 4
    next_one = (rows + 1) % n
    near = np.where((by == 0)[:, None], NEAR_M / 2.0, 0.0)
    hands = np.where(
        ((by == 1) | (by == 3))[:, None], sample.hands_in_base_m[next_one], sample.hands_in_base_m
    )
    tcps = np.where((by >= 2)[:, None], sample.tcps_in_base_m[next_one], sample.tcps_in_base_m)
    others = Questions(hands + near, tcps - near, sample.seeds[next_one])
    mixed = Questions.joined([others, sample])
    order = np.stack([rows, rows + n], axis=1).ravel()
    return mixed[order], 2 * rows + 1
