"""The results of a scoring session: cards, findings and searches, for its files and its page."""

from __future__ import annotations

from dataclasses import dataclass, field

from safety_harness.base.settings import Settings
from safety_harness.extensions.lab.scoring.question_file import QuestionFile
from safety_harness.extensions.lab.scoring.scorecard import Scorecard, ScoreFinding
from safety_harness.extensions.lab.scoring.worst import Objective, QuestionSearch, Tried


@dataclass(frozen=True, eq=False)
class ShownQuestion:
    """A question with a very bad answer that a search found, and a scenario file whose run begins with it."""

    objective: Objective
    tried: Tried
    file: QuestionFile


@dataclass(eq=False)
class ScoredAvoider:
    """The results of one avoider.

    ``card`` is the avoider's card, and ``yardsticks`` contains the cards of the yardsticks for the same
    questions.

    If there is a reference avoider, its card is the first in ``yardsticks``. ``searches`` and ``worst`` are
    the results of searches, which do not affect the statistics in the card. A search may find questions for
    which no scenario file can be written. ``left_out`` lists the reasons.

    An avoider passes if ``findings`` is empty.  ``unlike`` lists differences from the yardsticks that are
    acceptable if the avoider has another purpose than the yardsticks.

    ``reference`` is the user's reference to the avoider.  ``sha256`` is the hash of the avoider's file, or
    empty if the avoider has no file.  ``settings`` contains the settings for each region, in the order of the
    regions.
    """

    reference: str
    sha256: str
    settings: tuple[Settings, ...]
    card: Scorecard
    yardsticks: tuple[Scorecard, ...]
    findings: tuple[ScoreFinding, ...] = ()
    unlike: tuple[ScoreFinding, ...] = ()
    searches: list[QuestionSearch] = field(default_factory=list)
    worst: list[ShownQuestion] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


@dataclass(eq=False)
class Scored:
    """The results of a scoring session; ``budget`` is the number of questions in the search for each avoider.

    ``failed`` lists the avoiders without a score, with the reasons.  ``remarks`` lists warnings.  ``against``
    is the user's reference to the reference avoider, or empty if there is no reference avoider.
    """

    seed: int
    budget: int
    against: str = ""
    avoiders: list[ScoredAvoider] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    interrupted: bool = False

    @property
    def findings(self) -> int:
        """The total number of findings on all avoiders."""
        return sum(len(avoider.findings) for avoider in self.avoiders)
