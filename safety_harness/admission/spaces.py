"""Draw admissible scenarios from a space.

If a draw is refused, the next draw replaces it. The functions count both kinds of draws.  A space does not
know whether the arm can reach a start, or whether the camera sees the object from that start.  Therefore this
module is the only place that rejects draws.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from safety_harness.admission.admit import Checker
from safety_harness.base.exceptions import InadmissibleError, InputError, ModelError, refuse_other_type
from safety_harness.scenario.fields import one_mistake
from safety_harness.scenario.model import Scenario
from safety_harness.space.space import ScenarioSpace

MAX_REJECTION_RATIO = 200  # draws before the first admitted draw, and then for each admitted draw


@dataclass(frozen=True)
class AdmittedDraws:
    """The admissible scenarios of a space, and the number of draws that were necessary.

    Args:
        scenarios: The scenarios.
        drawn: The number of draws.
        refused: The number of refused draws for each reason, the most frequent first.  A reason has the form
            "field: expected ...".

    """

    scenarios: tuple[Scenario, ...]
    drawn: int
    refused: dict[str, int]

    @property
    def acceptance_rate(self) -> float:
        """The number of admitted draws divided by the number of all draws."""
        return len(self.scenarios) / self.drawn

    def __str__(self) -> str:
        summary = f"{len(self.scenarios)} of {self.drawn} draws can run ({self.acceptance_rate:.0%})"
        return "; ".join([summary, *(f"{count} refused: {reason}" for reason, count in self.refused.items())])


@one_mistake()  # a draw that is refused is drawn again
def draw_admissible(
    space: ScenarioSpace, seed: int, count: int, *, on_draw: Callable[[int], None] | None = None
) -> AdmittedDraws:
    """Return the first ``count`` admissible draws of a stream, without executing user code.

    The scenarios follow the space's distribution, restricted to admissible scenarios.

    Args:
        space: The space.
        seed: The stream.
        count: The number of scenarios, at least 1.
        on_draw: A function that is called after each draw with the number of draws so far.

    Raises:
        InadmissibleError: Too few draws were admissible.  The limit is MAX_REJECTION_RATIO draws for the next
            admissible draw and for each earlier one.  The hint states the most frequent reason.
        ValueError: ``count`` is below 1.

    """
    refuse_other_type("draw_admissible(space)", space, ScenarioSpace)
    if count < 1:
        raise ValueError(f"expected a count of at least 1; got {count}")
    refused: Counter[str] = Counter()
    scenarios: list[Scenario] = []
    checker = Checker()  # which executes no user code
    drawn = 0
    last: InputError | None = None
    while len(scenarios) < count:
        if drawn >= MAX_REJECTION_RATIO * (len(scenarios) + 1):
            assert last is not None
            raise _hopeless(space, len(scenarios), drawn, refused) from last
        try:
            scenario = space.draw(seed, drawn)
            checker.check(scenario)
            scenarios.append(scenario)
        except InputError as error:
            refused[why_refused(error)] += 1
            last = error
        drawn += 1
        if on_draw is not None:
            on_draw(drawn)
    return AdmittedDraws(tuple(scenarios), drawn, dict(refused.most_common()))


def _hopeless(space: ScenarioSpace, admitted: int, drawn: int, refused: Counter[str]) -> InadmissibleError:
    """Return the error for a space with too few admissible draws."""
    reason, count = refused.most_common(1)[0]
    simplest = space.simplest
    expected = f"a space in which at least one draw in {MAX_REJECTION_RATIO} can run"
    hint = f"{count} times it was {reason}"
    got = f"{admitted} of {drawn} draws"
    return simplest.inadmissible(expected, got, reason.partition(":")[0], hint=hint)


def why_refused(error: InputError) -> str:
    """Return the reason of a refusal as "field: expected ...".

    Equal problems have equal texts. The function raises ``error`` itself if every draw of the space would
    fail for the same reason, such as a missing avoider or an unknown claim.
    """
    field = error.place.field or ""
    if isinstance(error, ModelError) or field.startswith(("avoider", "claims", "--avoider", "--against")):
        raise error
    return f"{error.place.field}: expected {error.expected}"
