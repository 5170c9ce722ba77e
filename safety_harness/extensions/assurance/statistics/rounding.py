"""Round bounds to three digits so that they never look better than they are."""

from __future__ import annotations

import math
from collections.abc import Callable


def rounded_up(share: float) -> str:
    """Return an upper bound with three digits, rounded up.

    Args:
        share: The bound. A value outside (0, 1) is written with up to six digits instead.

    """
    return _rounded(share, math.ceil)


def rounded_down(share: float) -> str:
    """Return a lower bound with three digits, rounded down.

    Args:
        share: The bound. A value outside (0, 1) is written with up to six digits instead.

    """
    return _rounded(share, math.floor)


def _rounded(share: float, to_whole: Callable[[float], int]) -> str:
    """Return ``share`` rounded to three digits.

    If only a rounding error separates ``share`` from a number with three digits, the result is that number.
    """
    if not 0.0 < share < 1.0:
        return f"{share:g}"
    digit = float(f"1e{int(f'{share:.17e}'.split('e')[1]) - 2}")  # 10**k may differ between C libraries
    nearest = round(share / digit)
    whole = nearest if abs(share / digit - nearest) < 1e-9 else to_whole(share / digit)
    return f"{min(whole * digit, 1.0):.3g}"
