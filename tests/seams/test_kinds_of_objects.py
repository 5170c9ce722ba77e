"""A wing's own kind of object lives in the same process as an avoider or a controller, by the same rules."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.seams.isolation.channel import GoneError
from safety_harness.seams.isolation.connection import Connection, binary_wire, process_of, refusing
from safety_harness.seams.isolation.messages import Failed, Make
from safety_harness.seams.isolation.process import Process
from tests.seams import adding
from tests.seams.adding import PLACE, Add, Added

SOURCE = """\
import os, time
class Mine:
    name = "mine"
    def add(self, a, b):
        print("adds", a, b)
        if b == 1.0: raise ValueError("one")
        if b == 2.0: raise SystemExit(3)
        if b == 3.0: os._exit(3)
        if b == 4.0: time.sleep(600)
        if b == 5.0: return object()
        return a + b
class Nothing:
    name = "nothing"
"""
Begun = tuple[Connection, Callable[..., Make]]


@pytest.fixture
def begun(tmp_path: Path) -> Begun:
    file = tmp_path / "mine.py"
    file.write_text(SOURCE)
    begin = partial(Process.python, "tests.seams.adding")
    start = process_of(file, SOURCE.encode(), logging.getLogger("adders"), begin)
    wire = binary_wire(adding.said.decode, 1_000)
    return Connection(start, wire), lambda name, number=0: Make.from_file(file, SOURCE.encode(), name, number)


def asked(connection: Connection, *numbers: float, number: int = 0, limit_s: float = 30.0) -> Added | Failed:
    connection.say(Add(number, numbers), limit_s)  # type: ignore[arg-type]
    answer: Added | Failed = connection.hear(limit_s)
    return answer


def test_objects_are_made_asked_and_forgotten_by_number(
    begun: Begun, caplog: pytest.LogCaptureFixture
) -> None:
    connection, make = begun
    with caplog.at_level(logging.WARNING):
        assert connection.introduce(make("Mine", 7), Added, 30.0) == Added(1.0, "mine")
        assert connection.introduce(make("Mine", 8), Added, 30.0) == Added(2.0, "mine")
        assert asked(connection, 0.5, 0.25, number=8) == Added(0.75)
        connection.forget(8)
        assert asked(connection, 0.0, 0.0, number=8) == Failed("add raised: KeyError: 8")
    executed, printed = caplog.messages
    assert executed.startswith("executes ")
    assert printed == "mine.py wrote: adds 0.5 0.25"
    assert connection.generation == 1


def test_what_it_raises_is_said_and_its_process_goes_on(begun: Begun) -> None:
    connection, make = begun
    connection.introduce(make("Mine"), Added, 30.0)
    assert asked(connection, 0.0, 1.0) == Failed("add raised: ValueError: one (mine.py:6)")
    assert asked(connection, 0.0, 2.0) == Failed("add raised: SystemExit: 3 (mine.py:7)")
    assert str(asked(connection, 0.0, 5.0)).startswith("Failed(why='add raised: TypeError: no numbers, text")
    assert asked(connection, 1.0, 0.0) == Added(1.0)
    assert connection.quiet


@pytest.mark.parametrize(
    ("number", "limit_s", "hung", "why"),
    [(3.0, 30.0, False, "its process ended with exit status 3"), (4.0, 0.3, True, "its time was over")],
)
def test_one_that_ends_or_hangs_is_begun_anew(
    begun: Begun, number: float, limit_s: float, hung: bool, why: str
) -> None:
    connection, make = begun
    connection.introduce(make("Mine"), Added, 30.0)
    with pytest.raises(GoneError, match=why) as gone:
        asked(connection, 0.0, number, limit_s=limit_s)
    assert gone.value.hung == hung
    connection.end()
    assert not connection.alive
    connection.introduce(make("Mine"), Added, 30.0)
    assert asked(connection, 1.0, 0.0) == Added(1.0)
    assert connection.generation == 2


def test_a_process_that_ended_unseen_is_replaced_when_the_next_object_is_made(begun: Begun) -> None:
    connection, make = begun
    connection.introduce(make("Mine"), Added, 30.0)
    connection.say(Add(0, (0.0, 3.0)), 30.0)  # and nobody hears that it ends
    assert connection.introduce(make("Mine"), Added, 30.0) == Added(1.0, "mine")
    assert connection.generation == 2


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("Nothing", "expected Nothing to have a method add; got no such method in a Nothing"),
        ("None_", "no such name"),
    ],
)
def test_a_file_without_one_is_refused_at_its_place(begun: Begun, name: str, why: str) -> None:
    connection, make = begun
    with pytest.raises(InadmissibleError, match=why) as refused, refusing(InadmissibleError, "", 1.0, PLACE):
        connection.introduce(make(name), Added, 30.0)
    assert refused.value.place == PLACE
    assert connection.alive
