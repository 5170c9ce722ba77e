"""Find the causes of violations in the declared runs.

The first violations of each claim are drawn and run again.
"""

from __future__ import annotations

from safety_harness.extensions.assurance.campaign.attributed import ViolatedEpisodes, violated_episodes
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import WhoseFault
from safety_harness.extensions.attribution.attribute import attribute
from safety_harness.extensions.attribution.tally import AttributionTally

MOST = 20  # the first violations of each claim


def whose_fault(plan: Plan, ledger: Ledger) -> WhoseFault:
    """Find the causes of the violations in ``ledger`` by replays in the kinematic world.

    Like the runs of the plan, the replays execute the programs to which ``plan`` refers.
    """
    violated = ViolatedEpisodes.first(ledger, MOST)
    tally = AttributionTally.from_attributions(
        attribution
        for admitted, claims in violated_episodes(plan, violated, programs=True)
        for attribution in attribute(admitted, claims)
    )
    return WhoseFault(
        about=f"{violated.summary}, the first {MOST} of each claim" if violated.of else "",
        groups=tuple(tally.groups.items()),
        would_help=tuple((change, count) for change, count in tally.would_help.items() if count),
    )
