"""Confirm a finding: determine whether it also occurs in a given world, and in how many draws.

A draw repeats the run with other random numbers of the avoider. A finding that appears in only one of two
worlds becomes a ``Disagreement``, which contains the runs of both worlds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

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

SAME_RAD = 1e-3  # PyBullet's Panda, whose motors are strong, is up to 1.5e-4 rad from the kinematic world's


@dataclass(frozen=True)
class Complaint:
    """The defect of a run: a violated claim, or the failure of the run if ``claim`` is None.

    ``kind`` is the message of the failure, or the fault of an avoider that gave no answer. If there is a
    ``reference``, the complaint also requires that the reference keeps the claim in the same scenario.
    """

    claim: Claim | None
    kind: str = ""
    reference: Reference | None = None

    @property
    def sentence(self) -> str:
        """A text that describes the complaint."""
        return self.kind if self.claim is None else self.claim.sentence

    @property
    def summary(self) -> str:
        """A text that describes the complaint.

        If the avoider gave no answer, the text also states the fault of the avoider.
        """
        return f"{self.sentence}: {self.kind}" if self.claim is not None and self.kind else self.sentence

    def is_in(self, run: Trace | Exception) -> bool:
        """Return whether ``run`` shows the complaint."""
        return failure_of(run) == self.kind if self.claim is None else self.margin_in(run) is not None

    def margin_in(self, run: Trace | Exception) -> float | None:
        """Return the margin [SI] of the violation in ``run``.

        The result is None if ``run`` does not violate the claim.
        """
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
        """Return a text with the reference's verdict in the scenario of ``run``.

        If there is no reference, the text is empty.
        """
        if self.claim is None or self.reference is None or isinstance(run, Exception):
            return ""
        return self.reference.verdict_text(self.claim, run)


def failure_of(run: Trace | Exception) -> str:
    """Return the reason why ``run`` failed, without the message's numbers, or an empty text for a trace."""
    return f"{RUN_FAILED}{without_numbers(described(run))}" if isinstance(run, Exception) else ""


@dataclass(frozen=True)
class Confirm:
    """A function that admits and runs a scenario, and returns whether the run shows the complaint.

    The run shows a violated claim only if the claim is violated by at least ``by`` [SI]. By default,
    ``admit`` starts a user's program anew for each run.
    """

    complaint: Complaint
    world: ScenarioRunner
    by: float = 0.0
    admit: Callable[[Scenario], Admitted] = admit

    def __call__(self, scenario: Scenario) -> bool:
        """Return whether ``scenario`` shows the complaint.

        The result is False if admission refuses the scenario.
        """
        try:
            run = self.world([self.admit(scenario)])[0]
        except InputError:
            return False
        margin = self.complaint.margin_in(run)
        return self.complaint.is_in(run) and (margin is None or -margin >= self.by)

    def share_of_draws(self, scenario: Scenario, draws: int) -> int:
        """Repeat the run ``draws`` times, and return how often the complaint occurs.

        Each repetition draws other random numbers for the avoider. The rest of the scenario stays the same in
        all repetitions.
        """
        admitted = self.admit(scenario)
        redrawn = (replace(admitted, avoider=OtherDraws(admitted.avoider, k)) for k in range(draws))
        return sum(self.complaint.is_in(self.world([draw])[0]) for draw in redrawn)


@dataclass(frozen=True, eq=False)
class OtherDraws(AvoiderAround):
    """An avoider that answers each query with another seed.

    The new seed derives from the query's seed and ``stream``.
    """

    stream: int

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int, **seen: Any
    ) -> Proposal:
        """Return the avoider's answer for another seed."""
        return self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=leaf(seed, Branch.SEARCH, 5, self.stream),
            **seen,
        )


@dataclass(frozen=True, eq=False)
class InOneWorld:
    """A run and the evaluations of its scenario's claims, or the exception of a failed run."""

    run: Trace | Exception
    evaluations: tuple[Evaluation, ...] = ()


@dataclass(frozen=True, eq=False)
class Disagreement:
    """A finding that a reference does not show, with its runs in both worlds.

    A missing run is None.
    """

    group: Group
    complaint: Complaint
    searched: InOneWorld | None = None
    confirming: InOneWorld | None = None


def disagreement_of(
    group: Group, complaint: Complaint, case: Scenario, searched: ScenarioRunner, confirming: ScenarioRunner
) -> Disagreement:
    """Run ``case`` in both worlds, and return both runs.

    If the complaint has a claim, both runs are judged by this claim.

    Args:
        group: The group of violations from which the scenario comes.
        complaint: The claim or failure that ``confirming`` does not show.
        case: The scenario.
        searched: The world in which the search ran.
        confirming: The world that confirms.

    """
    claims = case.claims if complaint.claim is None else (complaint.claim,)
    try:
        admitted = admit(replace(case, claims=claims))
    except InputError as error:
        return Disagreement(group, complaint, InOneWorld(error), InOneWorld(error))
    return Disagreement(
        group, complaint, in_one_world(searched, admitted), in_one_world(confirming, admitted)
    )


def physics_of(run: Trace | Exception, model: Trace | Exception) -> tuple[bool, str]:
    """Return whether physics influenced a run, and a sentence that states this.

    If no motor is saturated and there is no contact, a world with an engine computes the same motion as the
    kinematic world. Such a run repeats a finding without adding evidence from physics.

    Args:
        run: The run in a world with an engine.
        model: The run of the same scenario in the kinematic world.

    """
    if isinstance(model, Exception):
        return False, "whether physics had a part is unknown: the kinematic world has no such run"
    if isinstance(run, Exception) or len(run.ticks) != len(model.ticks):
        return True, "physics had a part: the kinematic world's run ends otherwise"
    apart_rad = np.abs(run.ticks["joint_position_rad"] - model.ticks["joint_position_rad"]).max(initial=0.0)
    had_part = not apart_rad <= SAME_RAD
    part = "a part: joints up to" if had_part else "no part: joints at most"
    return had_part, f"physics had {part} {apart_rad:.1g} rad from those of the kinematic world"


def in_one_world(
    world: ScenarioRunner, admitted: Admitted, run: Trace | Exception | None = None
) -> InOneWorld:
    """Run and judge one scenario.

    Args:
        world: The runner.
        admitted: The admitted scenario.
        run: Its run, if there is one already.

    Returns:
        The run with its evaluations. A failed run has no evaluations.

    """
    run = run or world([admitted])[0]
    evaluations = tuple(prop.evaluate(run) for prop in admitted.properties) if isinstance(run, Trace) else ()
    return InOneWorld(run, evaluations)
