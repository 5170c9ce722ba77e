from __future__ import annotations

from dataclasses import fields
from enum import Enum

import numpy as np
import pytest
from scenario_strategies import number_of

from safety_harness.base.settings import DEFAULTS, Clock, Servo
from safety_harness.scenario.settings_keys import setting_keys

GROUPS = [type(getattr(DEFAULTS, field.name)) for field in fields(DEFAULTS)]


@pytest.mark.parametrize("group", GROUPS)
def test_no_two_fields_have_the_same_words(group: type) -> None:
    words = [key.path for key in setting_keys(group)]
    assert len(set(words)) == len(words)


@pytest.mark.parametrize("group", GROUPS)
def test_no_unit_is_left_in_the_words(group: type) -> None:
    units = {
        "m",
        "s",
        "px",
        "px2",
        "rad",
        "mps",
        "mps2",
        "hz",
        "radps",
        "radps2",
        "pxps",
        "pxps2",
        "px2ps",
        "s2pm",
    }
    for key in setting_keys(group):
        assert not units & set(" ".join(key.path).split())


@pytest.mark.parametrize("group", GROUPS)
def test_every_default_lies_within_its_bounds(group: type) -> None:
    for key in setting_keys(group):
        value = getattr(group(), key.attribute)
        numbers = np.ravel([] if value is None or isinstance(value, Enum) else value)
        assert np.all((number_of(key).least <= numbers) & (numbers <= number_of(key).most)), key.name


def test_the_largest_gain_is_stable_at_the_longest_control_period() -> None:
    most = {key.attribute: number_of(key).most for group in (Clock, Servo) for key in setting_keys(group)}
    assert max(most["gain_far"], most["gain_near"]) * most["control_period_s"] < 1.0
