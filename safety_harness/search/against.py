"""A search for the largest difference: what one avoider violates and a reference, on the same draw, keeps."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan
from weakref import WeakKeyDictionary

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import told_avoider, with_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_all
from safety_harness.base.exceptions import InputError, Place
from safety_harness.cell.simulation.worlds import world_of_trace
from safety_harness.claims.properties.against import SCALES, TOLERANCE, tolerance
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.trace.trace import Trace


def difference_of(mine: Evaluation, reference: Evaluation) -> float:
    """Return the ``difference`` of two runs of one scenario."""
    return difference(mine.margin, reference.margin, SCALES[mine.unit], tolerance(mine, reference))


def difference(mine: float | None, reference: float | None, scale: float, by: float | None = None) -> float:
    """What leads a search, in the unit of both margins: less is nearer to what it is after, or more of it.

    Negative exactly where mine < 0 and the reference keeps the claim ``by`` so much (None: ``TOLERANCE`` of
    the scale): then it is mine - reference.  Elsewhere it falls as that does, and as mine falls
    to 0 and the reference rises to the tolerance, and stays positive: a difference of two that both keep a
    claim is no finding.  Where the reference has no margin a violation counts whole.  NaN where nothing is
    known.
    """
    if mine is None or isnan(mine):
        return float("nan")
    if reference is None or isnan(reference):
        return mine if mine < 0.0 else float("nan")
    short = (TOLERANCE * scale if by is None else by) - reference
    if mine < 0.0 and short <= 0.0:
        return mine - reference
    ahead = (mine - reference + max(mine, 0.0) + max(short, 0.0)) / scale
    return scale * (1.0 + ahead if ahead > 0.0 else 1.0 / (1.0 - ahead))


@dataclass(frozen=True, eq=False)
class Reference:
    """An avoider, named from the working directory, in the place of a run's own; all else is the same."""

    avoider: str
    _runs: WeakKeyDictionary[Trace, Trace | None] = field(default_factory=WeakKeyDictionary, repr=False)

    @property
    def name(self) -> str:
        """As results call it."""
        return told_avoider(self.avoider)

    def in_place(self, scenario: Scenario) -> Scenario:
        """The scenario with it; InadmissibleError that names ``--against``."""
        return with_avoider(scenario, self.avoider, Place(field="--against"))

    def said_of(self, claim: Claim, run: Trace) -> Evaluation | None:
        """The claim with the reference; None if it could not be run."""
        if run not in self._runs:
            self._runs[run] = self._run(run)
        other = self._runs[run]
        return None if other is None else property_of(claim, run.scenario).evaluate(other)

    def _run(self, run: Trace) -> Trace | None:
        try:
            admitted = admit(self.in_place(run.scenario))
        except InputError:
            return None
        found = next(run_all([admitted], world_of_trace(run.provenance.world)))
        return found if isinstance(found, Trace) else None

    def keeps(self, claim: Claim, run: Trace) -> bool:
        """Was it run, and did it keep the claim by the stated tolerance, as far as it has a margin?"""
        found = self.said_of(claim, run)
        if found is None or found.verdict is Verdict.VIOLATED:
            return False
        return found.margin is None or found.margin >= tolerance(found)

    def words(self, claim: Claim, run: Trace) -> str:
        """What becomes of the claim with it, for people."""
        found = self.said_of(claim, run)
        said = "no run" if found is None else f"{found.verdict.value}, {found.margin_text()}"
        return f"with {self.name} on the same draws: {said}"
