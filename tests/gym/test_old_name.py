"""The environment that old programs ask for is the one of today."""

from __future__ import annotations

from importlib import import_module

import pytest


def test_what_is_registered_with_gymnasium_by_the_old_name_is_one_environment() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    old = import_module("safety_harness.gym")
    assert old is import_module("safety_harness.extensions.gym")
    assert old.ENVIRONMENT_ID in gymnasium.envs.registration.registry
