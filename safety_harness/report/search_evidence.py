"""Define the content of the page about a search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from safety_harness.admission.agreement import Agreement
from safety_harness.admission.repeatability import RepeatabilityResult
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.claims.properties.against import Against
from safety_harness.search.confirm import Disagreement
from safety_harness.search.coverage import Coverage
from safety_harness.search.explaining import SearchFaults
from safety_harness.search.findings import Findings
from safety_harness.search.written import Causes, WrittenCounterexample
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.system import NOT_NOTED, SystemUnderTest
from safety_harness.trace.trace import Provenance


@dataclass(frozen=True, kw_only=True)
class SearchEvidence:
    """The content of the page.

    ``fallback`` states how often the fallback replaced the avoider, and is empty if this never occurred.
    ``repeated`` holds the answers of a second avoider, or None if there was no second avoider. ``baseline``
    holds the findings of uniform sampling with the same budget, if the user requested it. ``unconfirmed``
    lists the findings that a reference world does not show. ``confirmed`` counts the findings that every
    world in ``confirmed_in`` shows. ``not_found`` lists the claims for which the space expects a violation
    although no counterexample violates them. If no reference was available, ``unconfirmable`` states why no
    finding was confirmed. ``searched`` is the searched world.
    """

    title: str
    space: str
    tested: str  # the name by which commands refer to the tested program
    computing_time: str  # the cost of a decision in simulated time
    seed: int
    budget: int
    command: str
    generated_at: datetime
    findings: Findings
    fallback: str
    overruling: Overruling  # in the runs of the search
    repeated: RepeatabilityResult | None = None
    baseline: Findings | None
    coverage: Coverage
    violations: Coverage
    shown: tuple[WrittenCounterexample, ...]
    confirmed: int
    physical: int  # of these, findings in which physics had a part
    confirmed_in: tuple[str, ...]  # the installed references
    unconfirmed: tuple[Disagreement, ...]
    not_found: tuple[str, ...]
    nearest_hand_m: float
    agreement: Agreement
    provenance: Provenance
    system: SystemUnderTest = NOT_NOTED
    unconfirmable: str = ""
    searched: WorldEntry = KINEMATIC
    faults: SearchFaults | None = None  # the causes of all violations
    attributed: Mapping[str, dict[str, object]] = field(default_factory=dict)  # by the counterexample's file
    flips: tuple[str, ...] = ()  # differences without a clear result when drawn again
    worse: tuple[str, ...] = ()  # sentences on what this avoider does worse than the reference
    causes: Causes = field(default_factory=Causes)
    against: Against | None = None  # how the runs differ from those with a reference

    @property
    def rest_command(self) -> str:
        """The command that explains the remaining examples.

        The command is empty if no example remains.
        """
        more = self.causes.unasked and not self.findings.interrupted
        return f"{self.command} --explain all" if more else ""

    @property
    def shrunk(self) -> int:
        """The number of groups that were shrunk."""
        return sum(len(shown.groups) for shown in self.shown)
