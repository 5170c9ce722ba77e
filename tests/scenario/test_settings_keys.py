from __future__ import annotations

from dataclasses import fields

import pytest

from safety_harness.scenario.settings_keys import MAY_BE_NEGATIVE, MAY_BE_ZERO, setting_keys
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


def test_the_exceptions_about_signs_are_fields() -> None:
    names = {field.name for group in GROUPS for field in fields(group)}
    assert names >= MAY_BE_ZERO | MAY_BE_NEGATIVE
