"""What asking an avoider directly gives: figures with their intervals, by region; no logic.

Lengths are metres, angles radians, times seconds, positions in the base frame.  A figure that cannot be
had (no answer at all, no spread) is None, never a number that looks good.
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
    """A number with the interval that contains the true one with 95 % at least; of a maximum: NaN, NaN.

    Of quantiles it is exact, from order statistics; of ranks and means it is from the normal distribution.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ScoredQuestion:
    """One question and what came: for lists of the worst.

    ``off_m``: from the closed-form optimum; ``gained_m``: away from the hand (negative: towards it);
    ``spread_m``: the largest of the three.  NaN without an answer, for which ``fault`` says why.
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
    """What the declared spreads are worth; only of an avoider that declares any.

    ``within[k - 1][axis]``: the share of errors within k spreads.  ``error_to_spread``: rms error over rms
    spread, all axes together, and ``by_axis``: above 1 the avoider is too sure.  ``rank``: Spearman's
    correlation of the largest spread with the error, None where one of them is constant; ``honest_rank``:
    what it would be if the errors were normal with just these spreads, simulated once.
    """

    within: tuple[tuple[Proportion, Proportion, Proportion], ...]
    error_to_spread: Figure
    by_axis: Vector3
    rank: Figure | None
    honest_rank: float
    rms_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RegionScore:
    """One avoider in one region; the proportions are of the questions, but for those named otherwise.

    Where the region holds no pair that can be asked, ``about`` says so and every figure is None.
    ``asked_in_runs``: can a run ask these questions?  ``in_reach``: reachable, and above the table by the
    clearance.  ``gained_m``: away from the hand; ``angle_rad``: between the way and the direction away from
    the hand.  ``off``: the distance to the closed-form optimum, ``bias_in_base_m`` the mean error.  ``pull``:
    how the error grows with the hand's position at a fixed TCP, (3, 3) metres a metre by least squares, and
    ``scale`` with the TCP's: rows are the axes of the error.  Of the optimum both are 0; of what takes no
    notice of the hand the pull is 0.05 on the diagonal.  ``wrong_and_sure``: more than ``WRONG_M`` off, with
    no spread above the avoider's own threshold; ``sure_and_unsafe``: so, and towards the hand or out of
    reach.  ``stuck``: the largest share of answers with the very same coordinate: those of an avoider
    that clips or has collapsed.  Where answers are rounded, twice as many as at the next coordinates are not
    counted.
    ``step_m``: what two answers in the number format of these differ by at most, 0 in double precision.
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
    """What is moved between two near questions."""

    HAND = "the hand"
    TCP = "the TCP"


@dataclass(frozen=True, eq=False)
class AnswerChange:
    """Two near questions, alike but for one position, and how far apart their answers are."""

    moved: Moved
    before: Question
    after: Question
    change_m: float
    apart_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Jumps:
    """The answers along straight segments with one seed each; the hand or the TCP is moved.

    ``jumped``: the share of segments with a change of more than ``limit_m`` left between two questions that
    are ``NEAR_M`` apart; only the most uneven segments are followed that far, so that it is a lower bound.
    ``largest``: the largest such jump, None without any.  ``steepest``: the largest change over about 1 mm.
    ``limit_m``: half a millimetre, or two steps (``step_m``) of the number format of the answers, or of an
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
        """The largest change that is no jump."""
        return max(JUMP_M, 2.0 * self.step_m)


class WayOfAsking(Enum):
    """How the same questions are asked a second time."""

    AGAIN = "asked again"
    ORDER = "asked in another order"
    ALONE = "asked alone instead of together"
    FRESH = "asked of a fresh one"
    AFTER_OTHERS = "asked after other questions"
    INTERLEAVED = "asked while a second instance is asked other questions in between"
    LATER = "asked at a later time"


@dataclass(frozen=True, eq=False, kw_only=True)
class AskedAgain:
    """Whether the answers have the same bits: ``differ`` counts the questions of which they do not.

    ``largest_m``: of the position or the spread; infinite where one of the two is no answer.  ``apart``: was
    the second time in another process?  Only files that are executed are asked there.
    """

    way: WayOfAsking
    questions: int
    differ: int
    largest_m: float
    first: Question | None
    apart: bool = False


@dataclass(frozen=True)
class AnswerTimes:
    """How long answers took here, one question at a time; what nothing else depends on, or repeats."""

    questions: int
    median_s: float
    p99_s: float
    most_s: float
    late: int  # how many took longer than the deadline
    declared_s: float
    deadline_s: float


@dataclass(frozen=True, eq=False)
class Scorecard:
    """Everything about one avoider; a yardstick has neither repeats nor times."""

    avoider: str  # as its reference says
    name: str  # as it calls itself
    seed: int
    seen: str  # whose seen space the regions are about
    regions: tuple[RegionScore, ...]
    jumps: tuple[Jumps, ...]
    repeats: tuple[AskedAgain, ...] = ()
    times: AnswerTimes | None = None


class Kind(Enum):
    """What is wrong; the value is how pages and files call it."""

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


_ASKED = {Kind.NO_ANSWER, Kind.LEADS_TOWARDS, Kind.OUT_OF_REACH, Kind.SURE_AND_UNSAFE}
UNSAFE = frozenset(_ASKED | {Kind.JUMPS, Kind.NOT_REPEATED, Kind.SLOW})
"""Kinds that are wrong whatever an avoider is meant to answer; others say that it is unlike yardsticks."""
UNSAFE_OF_NETWORK = UNSAFE | {Kind.WRONG_AND_SURE, Kind.SPREAD_MISSES}
"""Those of a network trained here: the closed-form optimum is what it was trained to answer."""


@dataclass(frozen=True, eq=False)
class ScoreFinding:
    """One limit that an avoider exceeds: ``words`` has figure, unit and limit.

    ``region`` is empty where none is concerned; ``questions`` show it, the clearest first.
    """

    kind: Kind
    region: str
    words: str
    questions: tuple[Question, ...] = ()
