"""The results of a session of scoring, for its files and its page: cards, findings and searches."""

from __future__ import annotations

from dataclasses import dataclass, field

from safety_harness.base.settings import Settings
from safety_harness.extensions.lab.scoring.question_file import QuestionFile
from safety_harness.extensions.lab.scoring.scorecard import Scorecard, ScoreFinding
from safety_harness.extensions.lab.scoring.worst import Objective, QuestionSearch, Tried


@dataclass(frozen=True, eq=False)
class ShownQuestion:
    """A worst question that the search found, with the scenario file that asks it."""

    objective: Objective
    tried: Tried
    file: QuestionFile


@dataclass(eq=False)
class ScoredAvoider:
    """The results of one avoider: its ``card``, and the cards of ``yardsticks`` on the same questions.

    If there is a reference avoider, its card is the first of the yardsticks.  ``searches`` and ``worst`` have
    their own ledger and enter no figure of the card.  ``left_out`` states why no run begins with further
    worst questions.

    ``findings`` decide whether the avoider passes.  ``unlike`` lists differences from the yardsticks that are
    no fault if the avoider has another purpose.

    ``reference`` is the user's name of the avoider.  ``sha256`` is the hash of its file, empty without a
    file.  ``settings`` has the settings of each region, in the regions' order.
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
    """The results of a session; ``budget`` is the number of questions in each avoider's search.

    ``failed`` lists each avoider that has no score, with the reason.  ``remarks`` lists warnings.
    ``against`` is the user's name of the reference avoider, empty without one.
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
        """The number of findings on all avoiders."""
        return sum(len(avoider.findings) for avoider in self.avoiders)
