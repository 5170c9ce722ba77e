"""What is shipped with a shield is not refused."""

from __future__ import annotations

from pathlib import Path

from safety_harness.cli.validate import validate

ROOT = Path(__file__).parents[3]


def test_what_is_shipped_with_a_shield_is_not_refused() -> None:
    assert validate([*(ROOT / "plans/shielded").glob("*.yaml"), *(ROOT / "plans").glob("shield*.yaml")]) == 0
