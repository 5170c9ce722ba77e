from __future__ import annotations

from dataclasses import fields
from enum import Enum

import numpy as np
import pytest

from safety_harness.scenario.bounds import BY_KEY
from safety_harness.scenario.settings_keys import setting_keys
from safety_harness.settings import DEFAULTS

GROUPS = [type(getattr(DEFAULTS, field.name)) for field in fields(DEFAULTS)]


@pytest.mark.parametrize("group", GROUPS)
def test_no_two_fields_have_the_same_words(group: type) -> None:
    words = [key.words for key in setting_keys(group)]
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
        assert not units & set(" ".join(key.words).split())


def test_the_keys_with_bounds_of_their_own_are_fields() -> None:
    assert {f"{group.__name__}.{field.name}" for group in GROUPS for field in fields(group)} >= set(BY_KEY)


@pytest.mark.parametrize("group", GROUPS)
def test_every_default_lies_within_its_bounds(group: type) -> None:
    for key in setting_keys(group):
        value = getattr(group(), key.name)
        numbers = np.ravel([] if value is None or isinstance(value, Enum) else value)
        assert np.all((key.bounds.least <= numbers) & (numbers <= key.bounds.most)), key.name


def test_the_largest_gain_is_stable_at_the_longest_control_period() -> None:
    longest_s = BY_KEY["Clock.control_period_s"].most
    assert max(BY_KEY["Servo.gain_far"].most, BY_KEY["Servo.gain_near"].most) * longest_s < 1.0
