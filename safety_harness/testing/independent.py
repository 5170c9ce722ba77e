"""The first half of a test's draws: each independent of the others.

Hypothesis likes to repeat itself: most of its examples are variations of earlier ones, which finds bugs in
parsers, and leaves half of fifty hands at the same place.  So half of the examples are drawn afresh, every
choice uniformly within its bounds; the other half is Hypothesis's own, led by the margins of the first.
"""

from __future__ import annotations

from typing import Any

from hypothesis.errors import BackendCannotProceed
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider

from safety_harness.testing.session import session

NAME = "safety-harness"
_LARGEST = 2**64


class Independent(HypothesisProvider):
    """Hypothesis's way of drawing, but for numbers between two bounds."""

    def draw_integer(
        self, min_value: int | None = None, max_value: int | None = None, **others: Any
    ) -> int:
        """Uniform between the bounds, if they are not too far apart to mean anything."""
        self._stop_at_half()
        if min_value is None or max_value is None or others.get("weights"):
            return super().draw_integer(min_value, max_value, **others)
        return self._uniform().randint(min_value, max_value)

    def draw_float(self, *, min_value: float, max_value: float, **others: Any) -> float:
        """Uniform between finite bounds."""
        self._stop_at_half()
        if not -_LARGEST < min_value <= max_value < _LARGEST:
            return super().draw_float(min_value=min_value, max_value=max_value, **others)
        return self._uniform().uniform(min_value, max_value)

    def _uniform(self) -> Any:
        assert self._random is not None
        return self._random

    def _stop_at_half(self) -> None:
        test = session().test
        if test is None or test.examples >= session().profile.examples // 2:
            raise BackendCannotProceed("exhausted")


AVAILABLE_PROVIDERS[NAME] = Independent
