"""Whether one scenario shows what a search found, in a world, and for how many draws of the avoider's own.

What one world shows and the other does not is a finding of its own, with the run of either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import InputError, described
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.cell.avoidance.avoider import AvoiderAround, Proposal, Vector
from safety_harness.claims.properties.answered import fault_of, without_numbers
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.search.against import Reference
from safety_harness.search.findings import RUN_FAILED, Group
from safety_harness.search.trials import ScenarioRunner
from safety_harness.trace.trace import Trace


@dataclass(frozen=True)
class Complaint:
    """What is wrong: a claim is violated, or, without one, a run fails.

    ``kind`` is in which words it fails, or what the avoider did instead of answering.  With a
    ``reference`` it is that the claim is violated, and is not with that avoider in the same scenario.
    """

    claim: Claim | None
    kind: str = ""
    reference: Reference | None = None

    @property
    def sentence(self) -> str:
        """For people."""
        return self.kind if self.claim is None else self.claim.sentence

    @property
    def words(self) -> str:
        """With what the avoider did instead of answering."""
        return f"{self.sentence}: {self.kind}" if self.claim is not None and self.kind else self.sentence

    def is_in(self, run: Trace | Exception) -> bool:
        """Whether a run shows it."""
        return failure_of(run) == self.kind if self.claim is None else self.margin_in(run) is not None

    def margin_in(self, run: Trace | Exception) -> float | None:
        """The margin by which the claim is violated [SI]; None if it is not."""
        if self.claim is None or isinstance(run, Exception):
            return None
        if self.kind and self.kind != without_numbers(fault_of(run)):
            return None
        evaluation = property_of(self.claim, run.scenario).evaluate(run)
        if evaluation.verdict is not Verdict.VIOLATED:
            return None
        new = self.reference is None or self.reference.keeps(self.claim, run)
        return evaluation.margin if new else None

    def reference_words(self, run: Trace | Exception) -> str:
        """What becomes of the claim with the reference; empty without one."""
        if self.claim is None or self.reference is None or isinstance(run, Exception):
            return ""
        return self.reference.words(self.claim, run)


def failure_of(run: Trace | Exception) -> str:
    """Why there is no run, without its numbers; empty if there is one."""
    return f"{RUN_FAILED}{without_numbers(described(run))}" if isinstance(run, Exception) else ""


@dataclass(frozen=True)
class Confirm:
    """Runs one scenario at a time, with everything made anew; True if the complaint is in the run.

    A claim has to be violated by at least ``by`` [SI].
    """

    complaint: Complaint
    world: ScenarioRunner
    by: float = 0.0

    def __call__(self, scenario: Scenario) -> bool:
        """False as well for what admission refuses."""
        try:
            run = self.world([admit(scenario)])[0]
        except InputError:
            return False
        margin = self.complaint.margin_in(run)
        return self.complaint.is_in(run) and (margin is None or -margin >= self.by)

    def share_of_draws(self, scenario: Scenario, draws: int) -> int:
        """In how many of ``draws`` of the avoider's own randomness it is violated, all else the same."""
        admitted = admit(scenario)
        others = (replace(admitted, avoider=OtherDraws(admitted.avoider, k)) for k in range(draws))
        return sum(self.complaint.is_in(self.world([one])[0]) for one in others)


@dataclass(frozen=True, eq=False)
class OtherDraws(AvoiderAround):
    """An avoider with other seeds: the k-th stream of its own randomness."""

    stream: int

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int, **seen: Any
    ) -> Proposal:
        """What the avoider says with another seed."""
        return self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=leaf(seed, Branch.SEARCH, 5, self.stream),
            **seen,
        )


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
    return Disagreement(
        group, complaint, in_one_world(searched, admitted), in_one_world(confirming, admitted)
    )


def in_one_world(world: ScenarioRunner, admitted: Admitted) -> InOneWorld:
    """Run and judge a scenario."""
    run = world([admitted])[0]
    found = tuple(prop.evaluate(run) for prop in admitted.properties) if isinstance(run, Trace) else ()
    return InOneWorld(run, found)
