"""The first half of a test's draws: each independent of the others.

Hypothesis likes to repeat itself: most of its examples are variations of earlier ones, which finds bugs in
parsers, and leaves half of fifty hands at the same place.  So half of the examples are drawn afresh, every
choice uniformly within its bounds; the other half is Hypothesis's own, led by the margins of the first.
"""

from __future__ import annotations

from math import inf

from hypothesis.errors import BackendCannotProceed
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider

from safety_harness.testing.session import session

NAME = "safety-harness"
_LARGEST = 2**64


class Independent(HypothesisProvider):
    """Hypothesis's way of drawing, but for numbers between two bounds."""

    def draw_integer(
        self,
        min_value: int | None = None,
        max_value: int | None = None,
        *,
        weights: dict[int, float] | None = None,
        shrink_towards: int = 0,
    ) -> int:
        """Uniform between two bounds without weights."""
        self._stop_at_half()
        if min_value is None or max_value is None or weights or self._random is None:
            return super().draw_integer(min_value, max_value, weights=weights, shrink_towards=shrink_towards)
        return self._random.randint(min_value, max_value)

    def draw_float(
        self,
        *,
        min_value: float = -inf,
        max_value: float = inf,
        allow_nan: bool = True,
        smallest_nonzero_magnitude: float,
    ) -> float:
        """Uniform between two bounds that are not too far apart to mean anything."""
        self._stop_at_half()
        if not -_LARGEST < min_value <= max_value < _LARGEST or self._random is None:
            return super().draw_float(
                min_value=min_value,
                max_value=max_value,
                allow_nan=allow_nan,
                smallest_nonzero_magnitude=smallest_nonzero_magnitude,
            )
        return self._random.uniform(min_value, max_value)

    def _stop_at_half(self) -> None:
        test = session().test
        if test is None or test.examples >= session().profile.examples // 2:
            raise BackendCannotProceed("exhausted")


AVAILABLE_PROVIDERS[NAME] = Independent
