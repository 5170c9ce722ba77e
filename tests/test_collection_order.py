"""Which tests two workers begin with."""

from __future__ import annotations

import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tests.conftest import PARTS, SLOW, WORLDS, pytest_collection_modifyitems

TESTS = Path(__file__).parent


def item(room: str, number: int) -> Any:
    path = TESTS / room / "test_it.py" if room else TESTS.parent / "paper" / "tests" / "test_it.py"
    return SimpleNamespace(path=path, room=room, number=number, name=f"test_{number}")


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


def test_every_slow_test_of_the_list_is_there() -> None:
    folders = TESTS, TESTS.parent / "paper" / "tests"
    for line in SLOW:
        file, name = line.split("::")
        (path,) = (path for folder in folders for path in folder.rglob(file))
        assert f"def {name}(" in path.read_text(), line


def test_a_test_of_the_list_is_marked_slow_and_another_is_not() -> None:
    file, name = min(SLOW).split("::")
    marked: list[str] = []
    for one in (name, f"{name}_otherwise"):
        stands_for = SimpleNamespace(path=TESTS / "cli" / file, name=one, add_marker=marked.append)
        pytest_collection_modifyitems([stands_for])  # type: ignore[list-item]
    assert marked == ["slow"]
