from __future__ import annotations

import math

import numpy as np
import pytest

from safety_harness.base import normals
from safety_harness.base.normals import standard_normal
from safety_harness.base.seeds import Branch, generator


@pytest.mark.parametrize("seed", range(4))
def test_draws_and_state_are_numpy_s(seed: int) -> None:
    """Some 65 draws of 240,000 lie in the tails, which come from our logarithm."""
    own, theirs = generator(seed, Branch.SEARCH), generator(seed, Branch.SEARCH)
    found, expected = standard_normal(own, (60_000, 4)), theirs.standard_normal((60_000, 4))
    far = np.abs(expected) > 3.6541528853610088
    assert 30 < far.sum() < 120
    assert np.array_equal(found[~far], expected[~far])
    assert found[far] == pytest.approx(expected[far], rel=4e-16)
    assert own.bit_generator.state == theirs.bit_generator.state


def test_the_tails_come_from_our_logarithm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(normals, "log1p", lambda x: math.log1p(x) - 1e-3)
    found = standard_normal(generator(0, Branch.SEARCH), 60_000)
    plain = generator(0, Branch.SEARCH).standard_normal(60_000)
    assert np.array_equal(found != plain, np.abs(plain) > 3.6541528853610088)
