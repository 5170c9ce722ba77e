from __future__ import annotations

import pytest

from safety_harness.exceptions import Place
from safety_harness.scenario.fields import Places, Replaced
from safety_harness.scenario.read import parse_scenario
from tests.space.spaces import HEAD

TEXT = HEAD.replace("scenario space", "scenario")
ELSEWHERE = Place(field="--avoider")


@pytest.mark.parametrize("text", [TEXT, TEXT + "avoider: opposite pose\n"])
def test_a_place_that_is_replaced_is_as_in_a_dictionary(text: str) -> None:
    places = parse_scenario(text).places
    assert isinstance(places, Places)
    replaced = Replaced(places, "avoider", ELSEWHERE)
    wanted = {**places, "avoider": ELSEWHERE}
    assert dict(replaced) == wanted
    assert len(replaced) == len(wanted)
    assert "nothing" not in replaced
    with pytest.raises(KeyError):
        _ = replaced["nothing"]
