"""What is made after the runs: a part of the report that fails is an open finding, the others are written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from safety_harness.base.exceptions import LedgerError, described
from safety_harness.extensions.assurance.certification.evidence import UNMADE, OpenFinding

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class ReportGuard:
    """Collects ``findings``: which parts could not be made, and why."""

    findings: list[OpenFinding] = field(default_factory=list)

    def of(self, what: str, make: Callable[[], T], otherwise: Any) -> T:
        """Return what ``make`` gives, or ``otherwise`` if it fails, which is noted down.

        A ledger that cannot be read is raised: without it there is nothing to report.
        """
        try:
            return make()
        except LedgerError:
            raise
        except Exception as error:  # also of a user's program, whatever it raises
            self.findings.append(OpenFinding(f"{what} {UNMADE}: {described(error)}", "strata"))
            found: T = otherwise
            return found
