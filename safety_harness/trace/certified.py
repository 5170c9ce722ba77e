"""What was proven about the decisions of a run afterwards, on request: part of its trace, and of no verdict.

Made by ``extensions.lab.proof.decisions``.  It changes nothing else of a trace, and one without it is as it
was.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from msgspec import Meta

from safety_harness.trace.system import Line


class Sameness(Enum):
    """Of an outcome for all hands in a box; ``OTHER``: another one there has another outcome."""

    SAME = "the same"
    OTHER = "not the same"
    UNDECIDED = "undecided"
    NONE = "no answer of the network"


@dataclass(frozen=True, kw_only=True)
class CertifiedDecision:
    """Is the spread small enough for each hand or for none, and leads the way away from each or from none?"""

    certain: Sameness
    away: Sameness

    @property
    def whole(self) -> Sameness:
        """Of both."""
        both = (self.certain, self.away)
        order = (Sameness.NONE, Sameness.OTHER, Sameness.UNDECIDED)
        return next((one for one in order if one in both), Sameness.SAME)

    @property
    def words(self) -> str:
        """``not the same: leads away``."""
        if self.whole in (Sameness.SAME, Sameness.NONE):
            return str(self.whole.value)
        checks = {"certain": self.certain, "leads away": self.away}
        return f"{self.whole.value}: {', '.join(name for name, one in checks.items() if one is self.whole)}"


@dataclass(frozen=True, kw_only=True)
class CertifiedDecisions:
    """One for each decision; hands are anywhere within ``half_m`` by axis of the one that was asked about."""

    half_m: Annotated[float, Meta(ge=0.0, le=1.0)]
    network_sha256: Line
    decisions: tuple[CertifiedDecision, ...]

    @property
    def words(self) -> str:
        """How many are the same."""
        counts = {kind: sum(one.whole is kind for one in self.decisions) for kind in Sameness}
        parts = [f"{count} {kind.value}" for kind, count in counts.items() if count]
        return f"{len(self.decisions)} decisions for every hand within {self.half_m * 1e3:g} mm by axis: " + (
            ", ".join(parts) or "none"
        )
