"""The seam that users plug into: an Avoider proposes where the TCP should give way to.

It is asked with the nearest predicted hand, the TCP position and a *seed*, not a generator, so
that it may run in a process of its own and one decision is the same wherever it is made.  It
sees nothing of the simulator's truth.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import AvoiderError

Vector = NDArray[np.float64]  # (3,)


def _no_spread() -> Vector:
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A repulsive position in the base frame and its predictive spread, both (3,) in metres.

    ``spread_m`` is one standard deviation per axis; zero for an avoider that knows none.
    """

    position_in_base_m: Vector
    spread_m: Vector = field(default_factory=_no_spread)


class Avoider(Protocol):
    """What a user's own avoider has to offer."""

    @property
    def name(self) -> str:
        """How reports call it."""
        ...

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Where to move the TCP, its orientation kept."""
        ...


def checked(proposal: object) -> Proposal:
    """The proposal with float64 arrays of shape (3,), all finite; else AvoiderError says what came."""
    if not isinstance(proposal, Proposal):
        raise AvoiderError(f"an avoider must return a Proposal; got {type(proposal).__name__}")
    cleaned = []
    for name, value in (("position", proposal.position_in_base_m), ("spread", proposal.spread_m)):
        try:
            given = np.asarray(value)
        except (TypeError, ValueError) as error:
            raise AvoiderError(f"the proposed {name} is no array of numbers: {error}") from error
        if given.dtype.kind not in "fiu":  # complex numbers would lose a part, texts be parsed
            raise AvoiderError(f"the proposed {name} must be real numbers; got {given.dtype}")
        array = given.astype(np.float64)
        if array.shape != (3,):
            raise AvoiderError(f"the proposed {name} must have shape (3,); got {array.shape}")
        if not np.all(np.isfinite(array)):
            raise AvoiderError(f"the proposed {name} is not finite: {array.tolist()}")
        cleaned.append(array)
    if np.any(cleaned[1] < 0.0):
        raise AvoiderError(f"a spread is never negative; got {cleaned[1].tolist()}")
    return Proposal(cleaned[0], cleaned[1])
