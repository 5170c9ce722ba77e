"""The interface for a user's avoider: it proposes a position to which the TCP retreats.

A question contains the nearest predicted hand, the TCP position and a *seed*. An avoider gets the seed
instead of a random generator. So the avoider may run in a process of its own, and a decision is the same in
every process. The avoider does not see the simulator's truth.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import AvoiderError, ControllerError
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.seams.contract import IMAGE, SIGHTS, sees_of
from safety_harness.trace.records import ENDLESS

Vector = NDArray[np.float64]  # (3,)
Vectors = NDArray[np.float64]  # (n, 3)
LARGEST = float(np.finfo(np.float64).max)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A repulsive position in the base frame and its predictive spread, both (3,) in metres.

    ``spread_m`` is one standard deviation per axis, or zero if the avoider has no estimate.
    """

    position_in_base_m: Vector
    spread_m: Vector = field(default_factory=lambda: np.zeros(3))


class Avoider(Protocol):
    """The members that a user's own avoider must have.

    A user's avoider may also have these attributes:

    - ``spread_threshold_m``, a number or None: the gate refuses a proposal whose spread exceeds this number
      on any axis.
    - ``decision_time_s``, a number: the simulated time that a decision takes, unless the scenario's settings
      state this time.
    - ``sees``, a list of quantities from a controller's contract, without "image": ``propose`` gets a fourth
      keyword argument ``seen``. The argument contains the values that these quantities have at the time of
      the question.
    """

    @property
    def name(self) -> str:
        """The avoider's name in reports."""
        ...

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return a position for the TCP.

        The TCP keeps its orientation.

        Args:
            hand_position_in_base_m: The position of the nearest predicted hand (3,).
            tcp_position_in_base_m: The position of the TCP (3,).
            seed: The seed of any random numbers, from 0 to 2^64 - 1.

        Returns:
            The position with its spread.

        Raises:
            AvoiderError: The avoider has no proposal. The harness records any other exception as a fault too.

        """
        ...


@dataclass(frozen=True, eq=False)
class AvoiderAround:
    """An avoider that wraps another avoider.

    A subclass defines ``propose``, and all other members come from the wrapped ``avoider``.
    """

    avoider: Avoider

    @property
    def name(self) -> str:
        """The inner avoider's name."""
        return self.avoider.name

    @property
    def spread_threshold_m(self) -> float | None:
        """The inner avoider's spread threshold.

        The property raises ``AvoiderError`` in the same cases as ``spread_threshold_of``.
        """
        return spread_threshold_of(self.avoider)

    @property
    def decision_time_s(self) -> float:
        """The inner avoider's decision time.

        The property raises ``AvoiderError`` in the same cases as ``decision_time_of``.
        """
        return decision_time_of(self.avoider)

    @property
    def sees(self) -> tuple[str, ...]:
        """The names of the quantities that the inner avoider sees.

        A subclass that calls the inner avoider must pass the argument ``seen`` to the inner avoider.
        """
        return shown_to(self.avoider)


def spread_threshold_of(avoider: Avoider) -> float | None:
    """Return the largest spread [m] at which the avoider's proposals are usable, or None without a bound.

    Raise ``AvoiderError`` if this bound is not a finite length. Zero is valid and allows only proposals
    without spread.
    """
    return _declared(avoider, "spread_threshold_m", "a length in metres", most=LARGEST)


def decision_time_of(avoider: Avoider) -> float:
    """Return the simulated time [s] that the avoider declares for a decision, or 0 if it declares no time.

    Raise ``AvoiderError`` if the declared time is invalid.
    """
    return _declared(avoider, "decision_time_s", f"a time from 0 s to {LONGEST_S:g} s", most=LONGEST_S) or 0.0


def shown_to(avoider: Avoider) -> tuple[str, ...]:
    """Return the names of the quantities in the avoider's ``sees``, in the order of ``SIGHTS``.

    Raise ``AvoiderError`` for an unknown name, and for "image", because avoiders get no pixels.
    """
    if getattr(avoider, "sees", None) is None:
        return ()
    try:
        sees = sees_of(avoider, SIGHTS)  # type: ignore[arg-type]  # it reads this attribute only
    except ControllerError as error:
        raise AvoiderError(str(error)) from error
    if IMAGE in sees:
        raise AvoiderError(f"sees must list inputs of avoiders; got {IMAGE!r}, but avoiders get no pixels")
    return sees


def _declared(avoider: Avoider, name: str, kind: str, *, most: float) -> float | None:
    """Return the number in the avoider's attribute ``name``, or None if the attribute is absent.

    Raise ``AvoiderError`` unless the number is between 0 and ``most``.
    """
    value = getattr(avoider, name, None)
    if value is None:
        return None
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or isinstance(value, bool) or not 0.0 <= value <= most:
        raise AvoiderError(f"{name} must be {kind}, or None; got {value!r}")
    return float(value)


def checked(proposal: object) -> Proposal:
    """Return the proposal with its two arrays as float64, each finite and of shape (3,).

    Raise ``AvoiderError`` if the proposal is invalid.
    """
    if not isinstance(proposal, Proposal):
        raise AvoiderError(f"an avoider must return a Proposal; got {type(proposal).__name__}")
    cleaned = []
    for name, value in (("position", proposal.position_in_base_m), ("spread", proposal.spread_m)):
        try:
            given = np.asarray(value)
        except (TypeError, ValueError) as error:
            raise AvoiderError(f"the proposed {name} is no array of numbers: {error}") from error
        if given.dtype.kind not in "fiu":  # a cast to float64 would drop an imaginary part, and parse texts
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
