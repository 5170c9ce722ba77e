"""Bounds with three digits, which never look better than they are."""

from __future__ import annotations

import math
from collections.abc import Callable


def rounded_up(share: float) -> str:
    """An upper bound with three digits, none of which makes it look better than it is."""
    return _rounded(share, math.ceil)


def rounded_down(share: float) -> str:
    """A lower bound likewise."""
    return _rounded(share, math.floor)


def _rounded(share: float, to_whole: Callable[[float], int]) -> str:
    """What is a number of three digits already, but for an error of a float's, stays it."""
    if not 0.0 < share < 1.0:
        return f"{share:g}"
    digit = 10.0 ** (math.floor(math.log10(share)) - 2)
    near = round(share / digit)
    whole = near if abs(share / digit - near) < 1e-9 else to_whole(share / digit)
    return f"{min(whole * digit, 1.0):.3g}"
