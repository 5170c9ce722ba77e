"""Which tests two workers begin with."""

from __future__ import annotations

import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tests.conftest import PARTS, WORLDS, pytest_collection_modifyitems

TESTS = Path(__file__).parent


def item(room: str, number: int) -> Any:
    path = TESTS / room / "test_it.py" if room else TESTS.parent / "paper" / "tests" / "test_it.py"
    return SimpleNamespace(path=path, room=room, number=number)


def test_the_worlds_come_first_and_their_parts_in_the_middle_and_none_is_lost() -> None:
    rooms = [*WORLDS, *PARTS, "scenario", "properties", "report", ""]
    items = [item(room, number) for room in sorted(rooms) for number in range(20)]
    ordered = items.copy()
    pytest_collection_modifyitems(ordered)
    assert sorted(map(id, ordered)) == sorted(map(id, items))
    assert ordered[0].room == WORLDS[0]
    assert ordered[len(ordered) // 2].room == PARTS[0]
    for room in rooms:
        assert [one.number for one in ordered if one.room == room] == list(range(20))


def test_any_part_of_the_tests_can_be_collected_alone() -> None:
    rng = random.Random(1)
    for count in (0, 1, 2, 7):
        for room in ("", WORLDS[0], PARTS[0], "scenario"):
            items = [item(room, number) for number in range(count)] + [item(rng.choice(PARTS), 0)]
            ordered = items.copy()
            pytest_collection_modifyitems(ordered)
            assert sorted(map(id, ordered)) == sorted(map(id, items))
