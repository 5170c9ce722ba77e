"""A guard for the work after the runs, which turns a failed part of the report into an open finding.

The report keeps all other parts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from safety_harness.base.exceptions import LedgerError, described
from safety_harness.extensions.assurance.certification.evidence import UNMADE, OpenFinding

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class ReportGuard:
    """A guard that runs the steps of making a report.

    ``findings`` has the failed steps and the reasons.
    """

    findings: list[OpenFinding] = field(default_factory=list)

    def run(self, part: str, make: Callable[[], T], otherwise: Any) -> T:
        """Return the result of ``make``.

        If ``make`` fails, record a finding that ``part`` failed, and return ``otherwise``.

        Raises:
            LedgerError: The ledger cannot be read, so that no report is possible.

        """
        try:
            return make()
        except LedgerError:
            raise
        except Exception as error:  # a user's program may raise anything
            self.findings.append(OpenFinding(f"{part} {UNMADE}: {described(error)}", "strata"))
            substitute: T = otherwise
            return substitute
