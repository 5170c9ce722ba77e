"""What the report says of the system under test."""

from __future__ import annotations

from dataclasses import replace

import pytest
from examples import VISIT, scenario

from safety_harness.certification.system import model_of
from safety_harness.exceptions import ModelError


def test_a_network_in_the_home_of_nobody_is_one_that_is_missing() -> None:
    nobody = replace(scenario(VISIT, duration_s=1.0), avoider="~nobody of that name/x.safetensors")
    with pytest.raises(ModelError, match="no such file"):
        model_of(nobody)
