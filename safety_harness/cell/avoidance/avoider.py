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

from safety_harness.base.exceptions import AvoiderError, ControllerError
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.seams.contract import IMAGE, sees_of
from safety_harness.trace.records import ENDLESS

Vector = NDArray[np.float64]  # (3,)
Vectors = NDArray[np.float64]  # (n, 3)
LARGEST = float(np.finfo(np.float64).max)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A repulsive position in the base frame and its predictive spread, both (3,) in metres.

    ``spread_m`` is one standard deviation per axis; zero for an avoider that knows none.
    """

    position_in_base_m: Vector
    spread_m: Vector = field(default_factory=lambda: np.zeros(3))


class Avoider(Protocol):
    """What a user's own avoider has to offer.

    It may also have attributes ``spread_threshold_m`` (a number, or None): the gate then refuses
    a proposal whose spread is above it on any axis; and ``decision_time_s`` (a number): what a decision
    costs in simulated time, where the scenario's settings do not say otherwise.

    And ``sees``, words of a controller's contract but for "image": ``propose`` is then asked with a fourth
    keyword, ``seen``, which has what they name, as it was when the question was asked.
    """

    @property
    def name(self) -> str:
        """How reports call it."""
        ...

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Where to move the TCP, its orientation kept.

        ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,).
        """
        ...


@dataclass(frozen=True, eq=False)
class AvoiderAround:
    """An avoider around another: all is that ``avoider``'s own but ``propose``, which heirs give."""

    avoider: Avoider

    @property
    def name(self) -> str:
        """The avoider's own."""
        return self.avoider.name

    @property
    def spread_threshold_m(self) -> float | None:
        """The avoider's own; AvoiderError as there."""
        return spread_threshold_of(self.avoider)

    @property
    def decision_time_s(self) -> float:
        """The avoider's own; AvoiderError as there."""
        return decision_time_of(self.avoider)

    @property
    def sees(self) -> tuple[str, ...]:
        """The avoider's own: an heir that asks it hands ``seen`` on."""
        return shown_to(self.avoider)


def spread_threshold_of(avoider: Avoider) -> float | None:
    """The largest spread [m] with which the avoider's proposals may be used; None for any.

    AvoiderError for what is no such length: zero is one (only what is certain), infinity is not.
    """
    return _declared(avoider, "spread_threshold_m", "a length in metres", most=LARGEST)


def decision_time_of(avoider: Avoider) -> float:
    """What the avoider declares that a decision costs [s]; 0 for nothing declared.

    AvoiderError for what is no such time.
    """
    return _declared(avoider, "decision_time_s", f"a time from 0 s to {LONGEST_S:g} s", most=LONGEST_S) or 0.0


def shown_to(avoider: Avoider) -> tuple[str, ...]:
    """What the avoider sees beside the three keywords, in the order of the contract's ``SIGHTS``.

    AvoiderError for a word that is none of them, and for pixels.
    """
    if getattr(avoider, "sees", None) is None:
        return ()
    try:
        sees = sees_of(avoider)  # type: ignore[arg-type]  # it reads no more than that
    except ControllerError as error:
        raise AvoiderError(str(error)) from error
    if IMAGE in sees:
        raise AvoiderError(f"sees must be words that avoiders are shown; got {IMAGE!r}: no pixels")
    return sees


def _declared(avoider: Avoider, name: str, kind: str, *, most: float) -> float | None:
    """A number from 0 to ``most`` that the avoider may have; None for nothing declared, else AvoiderError."""
    value = getattr(avoider, name, None)
    if value is None:
        return None
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or isinstance(value, bool) or not 0.0 <= value <= most:
        raise AvoiderError(f"{name} must be {kind}, or None; got {value!r}")
    return float(value)


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
        if given.shape != (3,):
            raise AvoiderError(f"the proposed {name} must have shape (3,); got {given.shape}")
        array = given.astype(np.float64)
        if not np.all(np.isfinite(array)):
            raise AvoiderError(f"the proposed {name} is not finite: {array.tolist()}")
        if not np.all(np.abs(array) < ENDLESS):
            raise AvoiderError(f"the proposed {name} is as good as infinite: {array.tolist()}")
        cleaned.append(array)
    if np.any(cleaned[1] < 0.0):
        raise AvoiderError(f"a spread is never negative; got {cleaned[1].tolist()}")
    return Proposal(cleaned[0], cleaned[1])
