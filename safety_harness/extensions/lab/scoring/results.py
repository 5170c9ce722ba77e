"""What a session of scoring has for its files and its page: cards, findings, and the searches beside them."""

from __future__ import annotations

from dataclasses import dataclass, field

from safety_harness.base.settings import Settings
from safety_harness.extensions.lab.scoring.question_file import QuestionFile
from safety_harness.extensions.lab.scoring.scorecard import Scorecard, ScoreFinding
from safety_harness.extensions.lab.scoring.worst import Objective, QuestionSearch, Tried


@dataclass(frozen=True, eq=False)
class ShownQuestion:
    """One of the worst questions of the search, and the file that asks it."""

    objective: Objective
    tried: Tried
    file: QuestionFile


@dataclass(eq=False)
class ScoredAvoider:
    """One avoider beside ``yardsticks``, which were asked the same (a reference first, if there is one).

    ``searches`` and ``worst`` are of a ledger of their own and enter no figure of the card; ``left_out``
    says of other worst questions why no run begins with them.

    ``findings`` decide whether the avoider passes; ``unlike`` says beside them where it is unlike the
    yardsticks, which is no fault of an avoider that is meant to answer otherwise.

    ``reference`` is as the user named it; ``sha256`` of its file, empty for one without; ``settings`` are
    those of the regions, in their order.
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
    """All of a session; ``budget`` is of each avoider's search, ``failed`` says who did not answer at all.

    ``against`` is the reference, as the user named it; empty without one.
    """

    seed: int
    budget: int
    against: str = ""
    avoiders: list[ScoredAvoider] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    interrupted: bool = False

    @property
    def findings(self) -> int:
        """How many there are of all avoiders."""
        return sum(len(one.findings) for one in self.avoiders)
