"""Search for the largest difference between two avoiders.

There is a difference if the avoider under test violates a claim that the reference keeps. Both avoiders run
in the same scenario, which is drawn from the space.
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

    If ``mine`` is negative and the margin of the reference is at least the tolerance, the value is ``mine`` -
    ``reference``, which is negative. Otherwise the value is positive, because a difference between two
    avoiders that both keep a claim is no finding. A positive value decreases with the difference of the
    margins. A positive value also decreases as ``mine`` falls to 0, and as the reference rises to the
    tolerance.

    Args:
        mine: The margin of the avoider under test [unit of ``scale``]. It is None or NaN if the margin is
            unknown.
        reference: The margin of the reference, or None. Without it, the result is ``mine`` if ``mine`` is
            negative, and NaN otherwise.
        scale: The scale of the margins' unit.
        tolerance: The least margin with which the reference must keep a claim. The default is ``TOLERANCE``
            times the scale.

    Returns:
        The difference, or NaN if the difference is unknown.

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
    """The reference, which replaces the avoider of a run for a comparison.

    The rest of the scenario stays the same. ``avoider`` is a name, or a path relative to the working
    directory.
    """

    avoider: str
    _runs: WeakKeyDictionary[Trace, Trace | None] = field(default_factory=WeakKeyDictionary, repr=False)

    @property
    def name(self) -> str:
        """The avoider's name in results."""
        return told_avoider(self.avoider)

    def in_place(self, scenario: Scenario) -> Scenario:
        """Return ``scenario`` with this avoider.

        If this raises InadmissibleError, the error states the place ``--against``.
        """
        return with_reference(scenario, self.avoider, Place(field="--against"))

    def said_of(self, claim: Claim, run: Trace) -> Evaluation | None:
        """Return the evaluation of ``claim`` for the reference, in the same scenario as ``run``.

        The result is None if the reference could not run in that scenario. The reference runs once for each
        ``run``, and later calls use the stored result.
        """
        if run not in self._runs:
            self._runs[run] = self._run(run)
        repeated = self._runs[run]
        return None if repeated is None else property_of(claim, run.scenario).evaluate(repeated)

    def _run(self, run: Trace) -> Trace | None:
        """Repeat ``run`` with the reference in the same world.

        Return None if the scenario is refused or the run fails.
        """
        try:
            admitted = admit(self.in_place(run.scenario))
        except InputError:
            return None
        repeated = next(run_all([admitted], world_of_trace(run.provenance.world)))
        return repeated if isinstance(repeated, Trace) else None

    def keeps(self, claim: Claim, run: Trace) -> bool:
        """Return whether the reference ran and kept ``claim`` with a margin of at least the tolerance."""
        evaluation = self.said_of(claim, run)
        if evaluation is None or evaluation.verdict is Verdict.VIOLATED:
            return False
        return evaluation.margin is None or evaluation.margin >= tolerance(evaluation)

    def verdict_text(self, claim: Claim, run: Trace) -> str:
        """Return a text with the verdict and the margin of the reference for ``claim``."""
        judged = self.said_of(claim, run)
        verdict = "no run" if judged is None else f"{judged.verdict.value}, {judged.margin_text()}"
        return f"with {self.name} on the same draws: {verdict}"
