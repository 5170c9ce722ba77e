"""Proofs about the decisions of a run.

Proofs are computed on request after the run, and no verdict uses them. ``extensions.lab.proof.decisions``
makes the proofs. The proofs become part of the trace and change no other part.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from msgspec import Meta

from safety_harness.trace.system import Line


class Sameness(Enum):
    """The result of a proof: whether all hands in a box have the same outcome.

    ``OTHER`` means that a hand has another outcome.
    """

    SAME = "the same"
    OTHER = "not the same"
    UNDECIDED = "undecided"
    NONE = "no answer of the network"


@dataclass(frozen=True, kw_only=True)
class CertifiedDecision:
    """The results of a proof for two outcomes of a decision.

    Each result states whether the outcome is the same for all hands in the box. ``certain`` is about whether
    the spread is small enough. ``away`` is about whether the way leads away from the hand.
    """

    certain: Sameness
    away: Sameness

    @property
    def whole(self) -> Sameness:
        """The worse of the two results."""
        both = (self.certain, self.away)
        order = (Sameness.NONE, Sameness.OTHER, Sameness.UNDECIDED)
        return next((sameness for sameness in order if sameness in both), Sameness.SAME)

    @property
    def summary(self) -> str:
        """The result as text; for example, ``not the same: leads away`` states the outcome that differs."""
        if self.whole in (Sameness.SAME, Sameness.NONE):
            return str(self.whole.value)
        checks = {"certain": self.certain, "leads away": self.away}
        return f"{self.whole.value}: {', '.join(name for name, same in checks.items() if same is self.whole)}"


@dataclass(frozen=True, kw_only=True)
class CertifiedDecisions:
    """A proof for each decision of a run.

    Each proof covers all hands whose coordinates are within ``half_m`` of the hand in the question.
    """

    half_m: Annotated[float, Meta(ge=0.0, le=1.0)]
    network_sha256: Line
    decisions: tuple[CertifiedDecision, ...]

    @property
    def summary(self) -> str:
        """The number of decisions with each result.

        The keys are the texts of the results.
        """
        counts = {kind: sum(decision.whole is kind for decision in self.decisions) for kind in Sameness}
        parts = [f"{count} {kind.value}" for kind, count in counts.items() if count]
        return f"{len(self.decisions)} decisions for every hand within {self.half_m * 1e3:g} mm by axis: " + (
            ", ".join(parts) or "none"
        )
