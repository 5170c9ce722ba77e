"""Search for the largest difference between two avoiders: one violates a claim, and the reference keeps it.

Both avoiders run in the same scenario, drawn from the space.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan
from weakref import WeakKeyDictionary

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import told_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.comparison import with_reference
from safety_harness.admission.trial import run_all
from safety_harness.base.exceptions import InputError, Place
from safety_harness.cell.simulation.worlds import world_of_trace
from safety_harness.claims.properties.against import SCALES, TOLERANCE, tolerance
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.trace.trace import Trace


def difference_of(mine: Evaluation, reference: Evaluation) -> float:
    """Return the ``difference`` of two evaluations of one claim in the same scenario.

    Args:
        mine: The claim in the run of the avoider under test.
        reference: The claim in the run of the reference.

    """
    return difference(mine.margin, reference.margin, SCALES[mine.unit], tolerance(mine, reference))


def difference(
    mine: float | None, reference: float | None, scale: float, tolerance: float | None = None
) -> float:
    """Return the value that a search for differences minimises, in the unit of both margins.

    The value is negative exactly if ``mine`` < 0 and the reference keeps the claim by the tolerance. It then
    is ``mine`` - ``reference``. Otherwise it is positive, because a difference between two avoiders that both
    keep a claim is no finding. A positive value falls as the difference falls, as ``mine`` falls to 0, and as
    the reference rises to the tolerance.

    Args:
        mine: The margin of the avoider under test [unit of ``scale``]; None or NaN if it is unknown.
        reference: The margin of the reference; if it is None, a violation counts whole.
        scale: The scale of the margins' unit.
        tolerance: The least margin by which the reference keeps a claim; None: ``TOLERANCE`` times the scale.

    Returns:
        The difference; NaN if it is unknown.

    """
    if mine is None or isnan(mine):
        return float("nan")
    if reference is None or isnan(reference):
        return mine if mine < 0.0 else float("nan")
    short = (TOLERANCE * scale if tolerance is None else tolerance) - reference
    if mine < 0.0 and short <= 0.0:
        return mine - reference
    ahead = (mine - reference + max(mine, 0.0) + max(short, 0.0)) / scale
    return scale * (1.0 + ahead if ahead > 0.0 else 1.0 / (1.0 - ahead))


@dataclass(frozen=True, eq=False)
class Reference:
    """The avoider that replaces a run's own avoider for a comparison, in an otherwise equal scenario.

    ``avoider`` is a name, or a path relative to the working directory.
    """

    avoider: str
    _runs: WeakKeyDictionary[Trace, Trace | None] = field(default_factory=WeakKeyDictionary, repr=False)

    @property
    def name(self) -> str:
        """The avoider's name in results."""
        return told_avoider(self.avoider)

    def in_place(self, scenario: Scenario) -> Scenario:
        """Return ``scenario`` with this avoider; raise InadmissibleError, which names ``--against``."""
        return with_reference(scenario, self.avoider, Place(field="--against"))

    def said_of(self, claim: Claim, run: Trace) -> Evaluation | None:
        """Return the evaluation of ``claim`` in the reference's run of the scenario of ``run``.

        The result is None if the reference could not run there. The reference runs once for each run; the
        result is remembered.
        """
        if run not in self._runs:
            self._runs[run] = self._run(run)
        repeated = self._runs[run]
        return None if repeated is None else property_of(claim, run.scenario).evaluate(repeated)

    def _run(self, run: Trace) -> Trace | None:
        """Repeat ``run`` with the reference in the same world; return None if it is refused or fails."""
        try:
            admitted = admit(self.in_place(run.scenario))
        except InputError:
            return None
        repeated = next(run_all([admitted], world_of_trace(run.provenance.world)))
        return repeated if isinstance(repeated, Trace) else None

    def keeps(self, claim: Claim, run: Trace) -> bool:
        """Return whether the reference ran and kept ``claim``, at least by the tolerance of its margin."""
        evaluation = self.said_of(claim, run)
        if evaluation is None or evaluation.verdict is Verdict.VIOLATED:
            return False
        return evaluation.margin is None or evaluation.margin >= tolerance(evaluation)

    def verdict_text(self, claim: Claim, run: Trace) -> str:
        """Return the reference's verdict and margin for ``claim`` in words."""
        judged = self.said_of(claim, run)
        verdict = "no run" if judged is None else f"{judged.verdict.value}, {judged.margin_text()}"
        return f"with {self.name} on the same draws: {verdict}"
