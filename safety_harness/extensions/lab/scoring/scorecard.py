"""The data of a direct evaluation of an avoider: figures with intervals, by region; without logic.

Lengths are metres, angles radians, times seconds, positions in the base frame.  An unavailable figure (no
answer at all, no spread) is None, never a number that looks good.
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
    """A number with an interval that contains the true value with at least 95 %; NaN, NaN for a maximum.

    It is exact for quantiles (order statistics), and from the normal distribution for ranks and means.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ScoredQuestion:
    """One question with its answer, for lists of the worst.

    ``off_m`` is the distance to the closed-form optimum, ``gained_m`` the gain away from the hand (negative:
    towards it), and ``spread_m`` the largest of the three spreads.  They are NaN for a missing answer, whose
    reason is ``fault``.
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
    """The quality of the declared spreads, for an avoider that declares any.

    ``within[k - 1][axis]`` is the share of errors within k spreads.  ``error_to_spread`` is rms error over
    rms spread, all axes together, and ``by_axis`` by axis; above 1 the avoider is too sure.  ``rank`` is
    Spearman's correlation of the largest spread with the error, None if one is constant.  ``honest_rank`` is
    the same for normal errors with just these spreads, simulated once.
    """

    within: tuple[tuple[Proportion, Proportion, Proportion], ...]
    error_to_spread: Figure
    by_axis: Vector3
    rank: Figure | None
    honest_rank: float
    rms_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RegionScore:
    """The figures of one avoider in one region; proportions count questions unless stated otherwise.

    If the region has no pair about which a run can ask, ``about`` says so and every figure is None.
    ``asked_in_runs`` tells whether a run can ask these questions.

    ``in_reach`` counts answers that the arm reaches, above the table by the clearance.  ``gained_m`` is the
    gain away from the hand.  ``angle_rad`` is the angle between the step and the direction away from the
    hand.  ``off`` is the distance to the closed-form optimum, and ``bias_in_base_m`` the mean error.

    ``pull`` is the growth of the error with the hand's position at a fixed TCP, (3, 3) metres a metre by
    least squares. ``scale`` is its growth with the TCP's position.  Rows are the axes of the error.  Both are
    0 for the optimum.  An avoider that ignores the hand has a pull of 0.05 on the diagonal.

    ``wrong_and_sure`` counts answers more than ``WRONG_M`` off, with no spread above the avoider's own
    threshold. ``sure_and_unsafe`` counts sure answers towards the hand or out of reach.  ``stuck`` is the
    largest share of answers with the very same coordinate, as of an avoider that clips or has collapsed.  If
    answers are rounded, twice the number at the next coordinates does not count.  ``step_m`` is the largest
    difference of two neighbours in the answers' number format, 0 in double precision.
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
    """Two near questions that differ in one position, and the distance of their answers."""

    moved: Moved
    before: Question
    after: Question
    change_m: float
    apart_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Jumps:
    """The answers along straight segments with one seed each, on which the hand or the TCP moves.

    ``jumped`` is the share of segments with a change of more than ``limit_m`` between two questions
    ``NEAR_M`` apart.  It is a lower bound, because the search follows only the most uneven segments that far.
    ``largest`` is the largest such jump; None without any.  ``steepest`` is the largest change over about 1
    mm.  ``limit_m`` is half a millimetre, or two steps (``step_m``) of the answers' number format, or of an
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
        """The largest change that is no jump [m]."""
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
    """A comparison of answers by their bits; ``differ`` counts the questions whose answers differ.

    ``largest_m`` is the largest difference of position or spread, infinite if an answer is missing.
    ``apart`` tells whether the second time was in another process.  Only executed files run there.
    """

    way: WayOfAsking
    questions: int
    differ: int
    largest_m: float
    first: Question | None
    apart: bool = False


@dataclass(frozen=True)
class AnswerTimes:
    """Answer times on this machine, one question at a time; they do not repeat.

    Other figures are independent of them.
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
    """All figures of one avoider; a yardstick has neither repeats nor times."""

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
    """One limit that an avoider exceeds; ``words`` has figure, unit and limit.

    ``region`` is empty for a finding without a region.  ``questions`` show it, the clearest first.
    """

    kind: Kind
    region: str
    words: str
    questions: tuple[Question, ...] = ()
