"""Margins of time: in milliseconds below one second, and a lower limit never rounded up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from safety_harness.claims.properties.base import shown_margin
from safety_harness.extensions.assurance.certification.result_tables import at_least_words

OF_TIME: Any = SimpleNamespace(per_si=1.0, unit="s")


@pytest.mark.parametrize(
    ("margin_s", "text"),
    [
        (0.1, "+100.0 ms"),
        (-0.0004, "-0.4 ms"),
        (0.0, "+0 ms"),
        (0.99999, "+1000.0 ms"),
        (1.0, "+1.0 s"),
        (-2.25, "-2.2 s"),
        (float("inf"), "+inf s"),
    ],
)
def test_a_time_below_one_second_is_shown_in_milliseconds(margin_s: float, text: str) -> None:
    assert shown_margin(margin_s, "s") == text


@pytest.mark.parametrize("margin_s", [0.00126, 0.00568, -0.00564, 0.00999, 0.1, -0.1, 0.99999, 1.26, -1.26])
def test_a_lower_limit_is_never_more_than_the_evidence_shows(margin_s: float) -> None:
    number, unit = at_least_words(margin_s, OF_TIME).replace("\u2212", "-").split()
    shown_s = float(number) * {"ms": 1e-3, "s": 1.0}[unit]
    assert margin_s - 0.1 * {"ms": 1e-3, "s": 1.0}[unit] - 1e-12 <= shown_s <= margin_s + 1e-12
