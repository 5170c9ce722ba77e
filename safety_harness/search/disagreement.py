"""What one world shows and the other does not: a finding of its own, with the run of either."""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.admission.admit import Admitted, admit
from safety_harness.exceptions import InputError
from safety_harness.properties.base import Evaluation
from safety_harness.scenario.model import Scenario
from safety_harness.search.confirm import Complaint
from safety_harness.search.findings import Group
from safety_harness.search.trials import ScenarioRunner
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, eq=False)
class InOneWorld:
    """A run, judged by its scenario's claims; an exception where there is none."""

    run: Trace | Exception
    evaluations: tuple[Evaluation, ...] = ()


@dataclass(frozen=True, eq=False)
class Disagreement:
    """A finding that PyBullet does not show, in the world that was searched and there; None where not run."""

    group: Group
    complaint: Complaint
    searched: InOneWorld | None = None
    confirming: InOneWorld | None = None


def disagreement_of(
    group: Group, complaint: Complaint, found: Scenario, searched: ScenarioRunner, confirming: ScenarioRunner
) -> Disagreement:
    """Run ``found`` in both worlds, judged by what is complained about alone, if that is a claim."""
    claims = found.claims if complaint.claim is None else (complaint.claim,)
    try:
        admitted = admit(replace(found, claims=claims))
    except InputError as error:
        return Disagreement(group, complaint, InOneWorld(error), InOneWorld(error))
    return Disagreement(group, complaint, _in(searched, admitted), _in(confirming, admitted))


def _in(world: ScenarioRunner, admitted: Admitted) -> InOneWorld:
    run = world([admitted])[0]
    if isinstance(run, Exception):
        return InOneWorld(run)
    return InOneWorld(run, tuple(prop.evaluate(run) for prop in admitted.properties))
