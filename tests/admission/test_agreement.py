"""What was measured of the two worlds' agreement: read back as written, and old once the source changes."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace

import pytest

from safety_harness.admission.agreement import (
    FORMAT,
    Agreement,
    LargestDifference,
    from_json,
    measured_agreement,
    present_source,
)
from safety_harness.base.exceptions import InputError

EXAMPLE = Agreement(
    source="0" * 16,
    shipped=2,
    random=3,
    seed=1,
    near_m=0.005,
    compared=40,
    agreed=39,
    compared_near=4,
    agreed_near=4,
    optimistic=("one: hand distance: PyBullet violated, kinematic holds",),
    disagreements=("one: hand distance: PyBullet violated, kinematic holds",),
    differences=(LargestDifference("TCP position [m]", 3e-4, "stuck"),),
    left_out=(),
)


def to_json(agreement: Agreement) -> str:
    return json.dumps({"format": FORMAT, **asdict(agreement)})


def test_what_is_written_is_read_back() -> None:
    assert from_json(to_json(EXAMPLE)) == EXAMPLE


def test_a_share_of_nothing_is_no_number() -> None:
    assert EXAMPLE.share == 39 / 40
    assert math.isnan(replace(EXAMPLE, compared=0, agreed=0).share)


def test_a_measurement_is_old_unless_it_was_made_with_the_present_source() -> None:
    assert not EXAMPLE.is_of_present_source
    assert replace(EXAMPLE, source=present_source()).is_of_present_source


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "[]",
        "nothing",
        json.dumps({**json.loads(to_json(EXAMPLE)), "format": "another 7"}),
        json.dumps({**json.loads(to_json(EXAMPLE)), "more": 1}),
        json.dumps({key: one for key, one in json.loads(to_json(EXAMPLE)).items() if key != "agreed"}),
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="agreement"):
        from_json(text)


def test_what_comes_with_the_package_counts_up() -> None:
    found = measured_agreement()
    assert 0 < found.agreed <= found.compared
    assert found.agreed_near <= found.compared_near
    missing = found.compared + found.compared_near - found.agreed - found.agreed_near
    assert len(found.disagreements) == missing
    assert set(found.optimistic) <= set(found.disagreements)
    assert found.scenarios == found.shipped + found.random
