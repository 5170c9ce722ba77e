"""The data of an avoider's direct evaluation: figures with intervals for each region, without logic.

Lengths are in metres, angles in radians, times in seconds, and positions in the base frame.  A figure is None
if it is unavailable (without any answer, or without a spread), so that it never looks good.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from safety_harness.base.proportions import Proportion
from safety_harness.base.settings import Vector3
from safety_harness.cell.avoidance.asking import Question
from safety_harness.extensions.lab.scoring.questions import Answers, Questions

JUMP_M = 0.0005


@dataclass(frozen=True)
class Figure:
    """A number with an interval that contains the true value with a probability of at least 95 %.

    For quantiles, order statistics give the exact interval.  For ranks and means, the interval comes from the
    normal distribution.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ScoredQuestion:
    """One question with its answer, for lists of the worst questions.

    ``off_m`` is the distance to the closed-form optimum.  ``gained_m`` is the component of the step away from
    the hand; it is negative towards the hand.  ``spread_m`` is the largest of the three spreads.  The three
    are NaN if the answer is missing; ``fault`` then states the reason.
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

    ``within[k - 1][axis]`` is the share of errors within k spreads.  ``error_to_spread`` is the rms error
    divided by the rms spread over all axes together; above 1 the avoider is too sure.  ``by_axis`` is the
    same ratio for each axis.  ``rank`` is Spearman's correlation of the largest spread with the error; None
    if one of the two is constant.  ``honest_rank`` is the same correlation for simulated errors.  These
    errors are normally distributed with exactly the declared spreads.
    """

    within: tuple[tuple[Proportion, Proportion, Proportion], ...]
    error_to_spread: Figure
    by_axis: Vector3
    rank: Figure | None
    honest_rank: float
    rms_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RegionScore:
    """The figures of one avoider in one region.

    ``answered`` is a share of the questions.  All other proportions are shares of the given answers.
    ``asked_in_runs`` tells whether a run can ask these questions.  If the region has no pair about which a
    run can ask, ``about`` says so and every figure is None.

    ``in_reach`` is the share that the arm reaches, at least the clearance above the table.  ``gained_m`` is
    the component of the step away from the hand.  ``angle_rad`` is the angle between the step and that
    direction.  Names with ``off`` refer to the distance to the closed-form optimum.  ``bias_in_base_m`` is
    the mean error.

    ``pull`` is the growth of the error with the hand's position at a fixed TCP, by least squares.  It is a
    matrix (3, 3) in metres per metre, whose rows are the axes of the error.  ``scale`` is the growth of the
    error with the TCP's position.  Both are 0 for the optimum.  An avoider that ignores the hand has a pull
    of 0.05 on the diagonal.

    An answer is sure if no spread exceeds the avoider's own threshold.  ``wrong_and_sure`` is the share of
    sure answers more than ``WRONG_M`` off.  ``sure_and_unsafe`` is the share of sure answers towards the hand
    or out of reach.  ``stuck`` is the largest share of answers with the very same coordinate, which an
    avoider gives if it clips or has collapsed.  If answers are rounded, ``stuck`` is lowered by twice the
    number at the next coordinates.  ``step_m`` is the largest difference between two neighbours in the
    answers' number format, 0 in double precision.
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
    """The position that moves between two near questions."""

    HAND = "the hand"
    TCP = "the TCP"


@dataclass(frozen=True, eq=False)
class AnswerChange:
    """Two near questions that differ in one position, and the distance between their answers."""

    moved: Moved
    before: Question
    after: Question
    change_m: float
    apart_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Jumps:
    """The jumps of answers along straight segments, on which the hand or the TCP moves and the seed stays.

    ``jumped`` is the share of segments where the answers to two questions ``NEAR_M`` apart differ by more
    than ``limit_m``.  It is a lower bound, because the search divides only the most uneven segments so far.
    ``largest`` is the largest such jump; None without a jump.  ``steepest`` is the change with the steepest
    slope over about 1 mm.  ``step_m`` is a step of the answers' number format, or the assumed step of an
    avoider that answers in steps.
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
        """The largest change [m] that is no jump: half a millimetre, or two steps if these are longer."""
        return max(JUMP_M, 2.0 * self.step_m)


class WayOfAsking(Enum):
    """The ways of asking the same questions a second time."""

    AGAIN = "asked again"
    ORDER = "asked in another order"
    ALONE = "asked alone instead of together"
    FRESH = "asked of a fresh one"
    AFTER_OTHERS = "asked after other questions"
    INTERLEAVED = "asked while a second instance is asked other questions in between"
    LATER = "asked at a later time"


@dataclass(frozen=True, eq=False, kw_only=True)
class AskedAgain:
    """A comparison, by bits, of the answers to the same questions, asked twice.

    ``differ`` is the number of questions with different answers.  ``largest_m`` is the largest difference of
    a position, a spread or a threshold; infinite if one of two answers is missing.  ``apart`` tells whether
    another process gave the second answers; only avoiders from executed files have one.
    """

    way: WayOfAsking
    questions: int
    differ: int
    largest_m: float
    first: Question | None
    apart: bool = False


@dataclass(frozen=True)
class AnswerTimes:
    """The answer times on this machine, measured one question at a time; they vary between sessions.

    No other figure depends on these times.
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
    """All figures of one avoider; the card of a yardstick has neither repeats nor times."""

    avoider: str  # its reference
    name: str  # its own name
    seed: int
    seen: str  # the source of the regions' seen space
    regions: tuple[RegionScore, ...]
    jumps: tuple[Jumps, ...]
    repeats: tuple[AskedAgain, ...] = ()
    times: AnswerTimes | None = None


class Kind(Enum):
    """The kinds of findings; the value is the name on pages and in files."""

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
    """One limit that an avoider exceeds; ``words`` states the figure, its unit and the limit.

    ``region`` is empty if the finding belongs to no region.  ``questions`` are examples of the finding, the
    clearest first.
    """

    kind: Kind
    region: str
    words: str
    questions: tuple[Question, ...] = ()
