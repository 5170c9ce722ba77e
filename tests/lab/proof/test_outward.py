"""Printed shares of a proof are bounds: rounded outwards, whatever the digits."""

from __future__ import annotations

from safety_harness.extensions.lab.proof.certificate import outward


def test_a_share_that_is_not_proven_is_printed() -> None:
    """With 2.4e-7 undecided it is not proven at least 100.0000 %."""
    assert outward((1.0 - 2.4e-7, 0.0, 2.4e-7)) == ("99.9999%", "0.0000%", "0.0001%")
    assert outward((1.0, 0.0, 0.0)) == ("100.0000%", "0.0000%", "0.0000%")
