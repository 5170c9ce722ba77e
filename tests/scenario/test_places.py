from __future__ import annotations

import pytest

from safety_harness.scenario.fields import Places
from safety_harness.scenario.read import parse_scenario
from tests.space.spaces import HEAD


def test_the_places_are_a_mapping_that_is_made_when_it_is_first_asked() -> None:
    places = parse_scenario(HEAD.replace("scenario space", "scenario") + "avoider: opposite pose\n").places
    assert isinstance(places, Places)
    assert len(places) == len(dict(places))
    assert places["avoider"].field == "avoider"
    assert "nothing" not in places
    with pytest.raises(KeyError):
        _ = places["nothing"]
