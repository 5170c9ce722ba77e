"""Draw a ledger's violating episodes again from their seeds, so that the violations can be attributed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from safety_harness.admission.admit import Admitted
from safety_harness.base.exceptions import LedgerError, Place
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.model import Claim

_VIOLATED = (
    "SELECT stratum, episode, claim FROM judgement WHERE outcome = "
    f"{int(EpisodeOutcome.VIOLATED)} ORDER BY episode, stratum, claim"
)


@dataclass(frozen=True)
class ViolatedEpisodes:
    """The first violations of each claim in a ledger.

    ``claims`` maps (stratum, episode) to the numbers of the claims that the episode violates. ``of`` is the
    number of all violations in the ledger.
    """

    claims: dict[tuple[int, int], tuple[int, ...]]
    of: int

    @classmethod
    def first(cls, ledger: Ledger, most: int) -> ViolatedEpisodes:
        """Return the first violations of each claim in ``ledger``, at most ``most`` violations per claim."""
        chosen: dict[tuple[int, int], tuple[int, ...]] = {}
        counts = [0] * len(ledger.declared.claims)
        for stratum, episode, claim in ledger.all(_VIOLATED):
            counts[claim] += 1
            if counts[claim] <= most:
                chosen[stratum, episode] = (*chosen.get((stratum, episode), ()), claim)
        return cls(chosen, sum(counts))

    @property
    def summary(self) -> str:
        """A text that states how many of all violations were chosen, and from how many episodes."""
        chosen = sum(map(len, self.claims.values()))
        return f"{chosen} of {self.of} violations, in {len(self.claims)} episodes"


def violated_episodes(
    plan: Plan, violated: ViolatedEpisodes, *, programs: bool
) -> Iterator[tuple[Admitted, list[Claim]]]:
    """Yield each episode of ``violated``, drawn and admitted again, and the claims that the episode violates.

    Raise CampaignError if ``programs`` is False and a draw refers to a program. Raise LedgerError if an
    episode cannot be drawn again.
    """
    runner = EpisodeRunner(plan, programs=programs)
    for (stratum, episode), numbers in violated.claims.items():
        drawn = runner.draw(stratum, episode)
        if isinstance(drawn, Row):
            place = Place(field=f"{plan.strata[stratum].name}, episode {episode}")
            raise LedgerError(place=place, expected="an episode that can be drawn again", got=drawn.failure)
        yield drawn.admitted, [plan.claims[number].claim for number in numbers]
