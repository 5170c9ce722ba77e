"""What one world shows and the other does not: a finding of its own, with the run of either."""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.admission.admit import admit
from safety_harness.exceptions import InputError
from safety_harness.scenario.model import Scenario
from safety_harness.search.confirm import Complaint
from safety_harness.search.findings import Group
from safety_harness.search.trials import World
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, eq=False)
class Disagreement:
    """A finding that PyBullet does not show.

    ``searched`` is the run of the world that was searched in, ``confirming`` that of PyBullet; each an
    exception where there is no run, and None where none was made.
    """

    group: Group
    complaint: Complaint
    searched: Trace | Exception | None = None
    confirming: Trace | Exception | None = None


def disagreement_of(
    group: Group, complaint: Complaint, found: Scenario, searched: World, confirming: World
) -> Disagreement:
    """Run ``found`` in both worlds, judged by what is complained about alone, if that is a claim."""
    claims = found.claims if complaint.claim is None else (complaint.claim,)
    try:
        admitted = admit(replace(found, claims=claims))
    except InputError as error:
        return Disagreement(group, complaint, error, error)
    return Disagreement(group, complaint, searched([admitted])[0], confirming([admitted])[0])
