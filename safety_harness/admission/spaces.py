"""Draws of a scenario space that can be tried: what admission refuses is drawn again, and counted.

Whether the arm reaches a start and sees the object from there is no matter of the space's own making, so
here, and only here, draws are rejected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from safety_harness.admission.admit import Looker
from safety_harness.base.exceptions import InadmissibleError, InputError, ModelError, refuse_other_type
from safety_harness.scenario.model import Scenario
from safety_harness.space.space import ScenarioSpace

MAX_REJECTION_RATIO = 200  # draws of which not one was admitted; later, of which less than one in as many was


@dataclass(frozen=True)
class AdmittedDraws:
    """Scenarios of a space that can be tried, and how many draws it took.

    ``refused`` counts the others by the reason, the most frequent first: "field: expected ...".
    """

    scenarios: tuple[Scenario, ...]
    drawn: int
    refused: dict[str, int]

    @property
    def acceptance_rate(self) -> float:
        """Admitted scenarios a draw."""
        return len(self.scenarios) / self.drawn

    def __str__(self) -> str:
        words = f"{len(self.scenarios)} of {self.drawn} draws can be tried ({self.acceptance_rate:.0%})"
        return "; ".join([words, *(f"{count} refused: {reason}" for reason, count in self.refused.items())])


def draw_admissible(
    space: ScenarioSpace, seed: int, count: int, *, on_draw: Callable[[int], None] | None = None
) -> AdmittedDraws:
    """The first ``count`` draws of the stream ``seed`` that admission lets through.

    Their distribution is the space's own, given that the scenario can be tried.  InadmissibleError with the
    most frequent reason when fewer than one draw in HOPELESS is admitted: at most HOPELESS * (count + 1)
    draws are made.  ``on_draw`` is told how many draws have been made.  ValueError for a count below 1.
    Nothing of a user's is executed.
    """
    refuse_other_type("draw_admissible(space)", space, ScenarioSpace)
    if count < 1:
        raise ValueError(f"expected a count of at least 1; got {count}")
    refused: Counter[str] = Counter()
    scenarios: list[Scenario] = []
    looker = Looker()
    drawn = 0
    last: InputError | None = None
    while len(scenarios) < count:
        if drawn >= MAX_REJECTION_RATIO * (len(scenarios) + 1):
            assert last is not None
            raise _hopeless(space, len(scenarios), drawn, refused) from last
        try:
            scenario = space.draw(seed, drawn)
            looker.look(scenario)
            scenarios.append(scenario)
        except InputError as error:
            refused[why_refused(error)] += 1
            last = error
        drawn += 1
        if on_draw is not None:
            on_draw(drawn)
    return AdmittedDraws(tuple(scenarios), drawn, dict(refused.most_common()))


def _hopeless(space: ScenarioSpace, admitted: int, drawn: int, refused: Counter[str]) -> InadmissibleError:
    reason, count = refused.most_common(1)[0]
    simplest = space.simplest
    expected = f"a space of which at least one draw in {MAX_REJECTION_RATIO} can be tried"
    hint = f"{count} times it was {reason}"
    got = f"{admitted} of {drawn} draws"
    return simplest.inadmissible(expected, got, reason.partition(":")[0], hint=hint)


def why_refused(error: InputError) -> str:
    """The reason, the same for points that are refused alike: "field: expected ...".

    Raises ``error`` where the text is to blame: an avoider that is missing, a claim that nobody knows.
    """
    field = error.place.field or ""
    if isinstance(error, ModelError) or field.startswith(("avoider", "claims", "--avoider", "--against")):
        raise error
    return f"{error.place.field}: expected {error.expected}"
