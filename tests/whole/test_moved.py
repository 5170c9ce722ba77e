"""Old import paths of documented names lead to what is there now, and all others stop."""

from __future__ import annotations

from importlib import import_module

import pytest

from safety_harness.base.moved import MOVED


@pytest.mark.parametrize("old", MOVED)
def test_an_old_path_of_documented_names_gives_the_module_of_today(old: str) -> None:
    assert import_module(f"safety_harness.{old}") is import_module(f"safety_harness.{MOVED[old]}")


@pytest.mark.parametrize("old", ["robot.inverse", "logs.tables", "gym.rewards", "attribution.ingredients"])
def test_another_old_path_stops_and_makes_no_second_copy_of_a_module(old: str) -> None:
    with pytest.raises(ModuleNotFoundError):
        import_module(f"safety_harness.{old}")
