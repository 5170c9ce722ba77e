"""Tasks are done once, found again by what made them, and one that fails costs no other."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest

from safety_harness.base.exceptions import OutputError
from safety_harness_paper.work import RESULT, Done, Task, Workshop, in_order

CALLS: list[str] = []


def add(folder: Path, *needs: Done, value: int) -> dict[str, Any]:
    CALLS.append(folder.name)
    return {"sum": value + sum(need.result["sum"] for need in needs)}


def fail(folder: Path) -> dict[str, Any]:
    raise ValueError("no such number")


def interrupt(folder: Path) -> dict[str, Any]:
    raise KeyboardInterrupt


def not_a_number(folder: Path) -> dict[str, Any]:
    return {"value": float("nan")}


def die(folder: Path) -> dict[str, Any]:
    os._exit(9)


def task(label: str, value: int, *needs: Task) -> Task:
    return Task(label, add, (("value", value),), needs)


def workshop(folder: Path, jobs: int = 1) -> tuple[Workshop, list[str]]:
    CALLS.clear()
    lines: list[str] = []
    return Workshop(folder, jobs, lines.append), lines


def test_a_task_comes_after_what_it_needs_and_is_done_once(tmp_path: Path) -> None:
    one = task("one", 1)
    two, three = task("two", 2, one), task("three", 3, one)
    both = task("both", 10, two, three)
    assert in_order([both]) == [one, two, three, both]
    shop, lines = workshop(tmp_path)
    done = shop.run([both])
    assert done[both].result == {"sum": 17}
    assert len(CALLS) == 4
    assert [line.split(";")[0] for line in lines] == ["[1/4] one", "[2/4] two", "[3/4] three", "[4/4] both"]
    shop, lines = workshop(tmp_path)
    assert shop.run([both])[both].result == {"sum": 17}
    assert CALLS == []
    assert lines == ["4 of 4 steps are there already"]


def test_another_number_anywhere_below_is_another_key() -> None:
    first, second = task("one", 1), task("one", 2)
    assert first.key != second.key
    assert task("two", 2, first).key != task("two", 2, second).key
    assert task("renamed", 1).key == first.key
    assert Task("one", fail, (("value", 1),)).key != first.key


def test_a_result_that_cannot_be_read_is_made_again(tmp_path: Path) -> None:
    one = task("one", 1)
    shop, _ = workshop(tmp_path)
    file = shop.run([one])[one].folder / RESULT
    for spoilt in ("", "[1]", '{"sum":'):
        file.write_text(spoilt)
        shop, _ = workshop(tmp_path)
        assert shop.run([one])[one].result == {"sum": 1}
        assert [one.folder_name] == CALLS


def test_one_that_fails_costs_only_what_needs_it(tmp_path: Path) -> None:
    broken = Task("broken", fail)
    hopeless, fine = task("hopeless", 1, broken), task("fine", 2)
    shop, lines = workshop(tmp_path)
    assert set(shop.run([hopeless, fine])) == {fine}
    assert shop.failed == {
        broken: "ValueError: no such number",
        hopeless: "it needs 'broken', which failed",
    }
    assert "error: broken: ValueError: no such number" in lines


def test_a_result_that_is_no_number_is_a_failure(tmp_path: Path) -> None:
    nan = Task("nan", not_a_number)
    shop, _ = workshop(tmp_path)
    assert shop.run([nan]) == {}
    assert "JSON" in shop.failed[nan]


def test_an_interruption_keeps_what_is_finished(tmp_path: Path) -> None:
    one, stop = task("one", 1), Task("stop", interrupt)
    shop, _ = workshop(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        shop.run([one, stop])
    kept = shop.kept(one)
    assert kept is not None
    assert kept.result == {"sum": 1}
    assert shop.kept(stop) is None


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    shop, _ = workshop(tmp_path / "file" / "below")
    with pytest.raises(OutputError, match="can be written"):
        shop.run([task("one", 1)])


def test_processes_give_the_same_results(tmp_path: Path) -> None:
    one = task("one", 1)
    both = task("both", 10, task("two", 2, one), task("three", 3, one))
    alone = Task("alone", add, (("value", 5),), (one,), alone=True)
    shop, _ = workshop(tmp_path, jobs=2)
    done = shop.run([both, alone, Task("broken", fail)])
    assert {t.label: d.result["sum"] for t, d in done.items()} == {
        "one": 1,
        "two": 3,
        "three": 4,
        "both": 17,
        "alone": 6,
    }
    assert list(shop.failed.values()) == ["ValueError: no such number"]
    assert json.loads((done[both].folder / RESULT).read_text()) == {"sum": 17}


def test_a_process_that_is_killed_is_said_and_the_rest_is_left_for_another_time(tmp_path: Path) -> None:
    killed = Task("killed", die)
    after = task("after", 1, killed)
    shop, _ = workshop(tmp_path, jobs=2)
    assert shop.run([killed, after]) == {}
    assert "a process ended" in shop.failed[killed]
    assert set(shop.failed) == {killed, after}


def wait_a_little(folder: Path) -> dict[str, Any]:
    time.sleep(0.5)
    return {}


def test_a_long_step_gives_a_sign_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("safety_harness_paper.work.HEARTBEAT_S", 0.05)
    shop, lines = workshop(tmp_path, jobs=2)
    shop.run([Task("a long one", wait_a_little)])
    assert "under way: a long one" in lines
