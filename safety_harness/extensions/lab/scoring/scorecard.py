"""The data classes for the results of scoring an avoider.

Lengths are in metres, angles in radians, and times in seconds.  Positions are in the base frame.  A statistic
that is unavailable is None, so that it cannot look like a good value.  For example, there may be no answer or
no spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from safety_harness.base.proportions import Proportion
from safety_harness.base.settings import Vector3
from safety_harness.cell.avoidance.asking import Question
from safety_harness.extensions.lab.scoring.questions import Answers, Questions

JUMP_M = 0.0005  # half a millimetre; a choice


@dataclass(frozen=True)
class Figure:
    """An estimate with a 95 % confidence interval.

    The interval of a quantile is exact, and its ends are order statistics.  The intervals of a mean and of a
    rank correlation are approximations by the normal distribution.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ScoredQuestion:
    """One question with its answer, for lists of the worst questions.

    ``off_m`` is the distance to the closed-form optimum.  ``gained_m`` is the component of the step in the
    direction away from the hand, so it is negative for a step towards the hand.  ``spread_m`` is the largest
    of the spreads on the three axes.  If the answer is missing, these three values are NaN, and ``fault``
    states the reason.
    """

    region: str
    question: Question
    position_in_base_m: Vector3
    spread_m: float
    off_m: float
    gained_m: float
    fault: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Spreads:
    """The quality of the spreads that an avoider declares.

    ``within[k - 1][axis]`` is the fraction of errors within k spreads.  ``error_to_spread`` is the RMS error
    divided by the RMS spread, over all axes.  A ratio above 1 means that the spreads are too small.
    ``by_axis`` contains the same ratio for each axis.  ``rank`` is Spearman's correlation between the largest
    spread and the error, or None if all spreads or all errors are equal.  ``honest_rank`` is the same
    correlation for simulated errors, whose standard deviations are the declared spreads.
    """

    within: tuple[tuple[Proportion, Proportion, Proportion], ...]
    error_to_spread: Figure
    by_axis: Vector3
    rank: Figure | None
    honest_rank: float
    rms_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RegionScore:
    """The statistics of one avoider's answers in one region.

    ``answered`` is a fraction of the questions, and all other proportions are fractions of the given answers.
    ``asked_in_runs`` is True if these questions can occur in a run.  If no pair in the region can occur in a
    run, ``about`` states this, and every statistic is None.

    ``in_reach`` is the fraction of answers that the arm can reach and whose height above the table is at
    least the clearance.  ``gained_m`` is the component of the step in the direction away from the hand.
    ``angle_rad`` is the angle between the step and this direction.  Fields with ``off`` in their names are
    distances to the closed-form optimum.  ``bias_in_base_m`` is the mean error.

    ``pull`` is the slope of the error with respect to the hand's position at a fixed TCP, fitted by least
    squares.  It is a matrix of shape (3, 3) in metres per metre, whose rows are the axes of the error.
    ``scale`` is the slope of the error with respect to the TCP's position.  For the optimum, ``pull`` and
    ``scale`` are 0.  If an avoider ignores the hand, the diagonal of ``pull`` is 0.05.

    An answer is sure if no spread exceeds the avoider's own threshold.  ``wrong_and_sure`` is the fraction of
    answers that are sure and more than ``WRONG_M`` from the optimum.  ``sure_and_unsafe`` is the fraction of
    answers that are sure and lead towards the hand or out of reach.  ``stuck`` is the largest fraction of
    answers with an identical coordinate, which occurs if the avoider clips its answers or its training has
    collapsed.  If the answers are rounded, ``stuck`` is reduced by twice the number of answers at
    neighbouring coordinates.  ``step_m`` is the largest difference between neighbouring numbers in the
    answers' number format, or 0 for double precision.
    """

    region: str
    about: str
    asked_in_runs: bool
    questions: Questions
    answers: Answers
    answered: Proportion | None
    leads_away: Proportion | None
    in_reach: Proportion | None
    gained_m: tuple[Figure, Figure] | None  # 50 %, 5 %
    least_gained_m: float | None
    angle_rad: tuple[Figure, Figure] | None  # 50 %, 95 %
    off_rms_m: Figure | None
    off_m: tuple[Figure, Figure, Figure] | None  # 50 %, 95 %, 99 %
    off_most_m: float | None
    bias_in_base_m: tuple[Figure, Figure, Figure] | None
    pull: tuple[Vector3, Vector3, Vector3] | None  # rows: axes of the proposal
    scale: tuple[Vector3, Vector3, Vector3] | None
    spreads: Spreads | None
    wrong_and_sure: Proportion | None
    above_threshold: Proportion | None  # None: the avoider has no threshold
    worst_off: tuple[ScoredQuestion, ...]  # ten at most, the worst first
    worst_gained: tuple[ScoredQuestion, ...]
    stuck: Proportion | None = None
    sure_and_unsafe: Proportion | None = None
    step_m: float = 0.0


class Moved(Enum):
    """The position that differs between two neighbouring questions."""

    HAND = "the hand"
    TCP = "the TCP"


@dataclass(frozen=True, eq=False)
class AnswerChange:
    """Two neighbouring questions that differ in one position, and the distance between their answers."""

    moved: Moved
    before: Question
    after: Question
    change_m: float
    apart_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Jumps:
    """The jumps of answers on straight segments, on which the hand or the TCP moves and the seed is constant.

    ``jumped`` is the fraction of segments on which the answers to two questions with the distance ``NEAR_M``
    differ by more than ``limit_m``.  This is a lower bound, because the search divides only the most uneven
    segments into such small parts.  ``largest`` is the largest such jump, or None if there is no jump.
    ``steepest`` is the change with the steepest slope over a distance of about 1 mm.  ``step_m`` is a step of
    the answers' number format, or the assumed step of an avoider that answers in steps.
    """

    region: str
    moved: Moved
    segments: int = 0
    jumped: Proportion | None = None  # None without a segment
    largest: AnswerChange | None = None
    steepest: AnswerChange | None = None
    step_m: float = 0.0

    @property
    def limit_m(self) -> float:
        """The largest change [m] that is no jump: half a millimetre or two steps, whichever is larger."""
        return max(JUMP_M, 2.0 * self.step_m)


class WayOfAsking(Enum):
    """The ways of asking the same questions again."""

    AGAIN = "asked again"
    ORDER = "asked in another order"
    ALONE = "asked alone instead of together"
    FRESH = "asked of a fresh one"
    AFTER_OTHERS = "asked after other questions"
    INTERLEAVED = "asked while a second instance is asked other questions in between"
    LATER = "asked at a later time"


@dataclass(frozen=True, eq=False, kw_only=True)
class AskedAgain:
    """A bitwise comparison of first and second answers to the same questions.

    ``differ`` is the number of questions with different answers.  ``largest_m`` is the largest difference of
    a position, a spread or a threshold.  It is infinite if only one of two answers is missing.  ``apart`` is
    True if another process gave the second answers.  This is possible only for an avoider from an executed
    file.
    """

    way: WayOfAsking
    questions: int
    differ: int
    largest_m: float
    first: Question | None
    apart: bool = False


@dataclass(frozen=True)
class AnswerTimes:
    """The answer times on this machine, measured one question at a time.

    The times vary between sessions, and no other result depends on them.
    """

    questions: int
    median_s: float
    p99_s: float
    most_s: float
    late: int  # answers after the deadline
    declared_s: float
    deadline_s: float


@dataclass(frozen=True, eq=False)
class Scorecard:
    """All results of scoring one avoider; the card of a yardstick has no repeats and no times."""

    avoider: str  # its reference
    name: str  # its own name
    seed: int
    seen: str  # the source of the regions' seen space
    regions: tuple[RegionScore, ...]
    jumps: tuple[Jumps, ...]
    repeats: tuple[AskedAgain, ...] = ()
    times: AnswerTimes | None = None


class Kind(Enum):
    """The kinds of findings; the value is the name of a kind on pages and in files."""

    NO_ANSWER = "no answer"
    LEADS_TOWARDS = "leads towards the hand"
    OUT_OF_REACH = "out of reach or into the table"
    FAR_OFF = "far from the optimum"
    WORST_CASE = "far off in places"
    BIASED = "biased"
    HAND_PULL = "follows the hand wrongly"
    SCALE = "error grows with the TCP's position"
    JUMPS = "jumps between near questions"
    STEEP = "changes too fast between near questions"
    SPREAD_MISSES = "too sure: the spread is too small"
    SPREAD_WIDE = "too unsure: the spread is too large"
    SPREAD_UNRANKED = "the spread does not rank the errors"
    STUCK = "the same answer to many questions"
    WRONG_AND_SURE = "wrong and sure"
    SURE_AND_UNSAFE = "sure, though it leads towards the hand or out of reach"
    UNSURE = "above its own threshold too often"
    NOT_REPEATED = "does not repeat"
    SLOW = "slow"


_WRONG_ANSWERS = {Kind.NO_ANSWER, Kind.LEADS_TOWARDS, Kind.OUT_OF_REACH, Kind.SURE_AND_UNSAFE}
UNSAFE = frozenset(_WRONG_ANSWERS | {Kind.JUMPS, Kind.NOT_REPEATED, Kind.SLOW})
"""Kinds that are wrong for every avoider; the rest say that it is unlike yardsticks."""
UNSAFE_OF_NETWORK = UNSAFE | {Kind.WRONG_AND_SURE, Kind.SPREAD_MISSES}
"""Kinds that are wrong for a network trained here, which learned the closed-form optimum."""


@dataclass(frozen=True, eq=False)
class ScoreFinding:
    """A finding: an avoider exceeds a limit.

    ``words`` states the value, its unit and the limit.

    ``region`` is empty if the finding does not refer to a region.  ``questions`` contains examples of the
    finding, beginning with the clearest.
    """

    kind: Kind
    region: str
    words: str
    questions: tuple[Question, ...] = ()
