"""Proofs about the decisions of a run, made later on request: part of its trace, and of no verdict.

``extensions.lab.proof.decisions`` makes them. They change no other part of a trace.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from msgspec import Meta

from safety_harness.trace.system import Line


class Sameness(Enum):
    """Whether all hands in a box have the same outcome. ``OTHER``: a hand there has another outcome."""

    SAME = "the same"
    OTHER = "not the same"
    UNDECIDED = "undecided"
    NONE = "no answer of the network"


@dataclass(frozen=True, kw_only=True)
class CertifiedDecision:
    """The sameness of two outcomes over the box.

    ``certain``: the spread is small enough. ``away``: the way leads away from the hand.
    """

    certain: Sameness
    away: Sameness

    @property
    def whole(self) -> Sameness:
        """The sameness of both outcomes together."""
        both = (self.certain, self.away)
        order = (Sameness.NONE, Sameness.OTHER, Sameness.UNDECIDED)
        return next((sameness for sameness in order if sameness in both), Sameness.SAME)

    @property
    def summary(self) -> str:
        """The sameness in words, such as ``not the same: leads away``."""
        if self.whole in (Sameness.SAME, Sameness.NONE):
            return str(self.whole.value)
        checks = {"certain": self.certain, "leads away": self.away}
        return f"{self.whole.value}: {', '.join(name for name, same in checks.items() if same is self.whole)}"


@dataclass(frozen=True, kw_only=True)
class CertifiedDecisions:
    """A proof for each decision, for all hands within ``half_m`` by axis of the hand in the question."""

    half_m: Annotated[float, Meta(ge=0.0, le=1.0)]
    network_sha256: Line
    decisions: tuple[CertifiedDecision, ...]

    @property
    def summary(self) -> str:
        """The number of decisions of each sameness, in words."""
        counts = {kind: sum(decision.whole is kind for decision in self.decisions) for kind in Sameness}
        parts = [f"{count} {kind.value}" for kind, count in counts.items() if count]
        return f"{len(self.decisions)} decisions for every hand within {self.half_m * 1e3:g} mm by axis: " + (
            ", ".join(parts) or "none"
        )
