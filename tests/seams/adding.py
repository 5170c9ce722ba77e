"""A kind of object of a wing's own: a user's file gives adders, which are asked for sums."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from safety_harness.base.exceptions import Place
from safety_harness.seams.isolation.child import ServedKind, serve
from safety_harness.seams.isolation.messages import Drop, Failed, Make, ProcessMessage, Refused, decoder_of
from safety_harness.seams.isolation.python_file import made_by, refuse_lacking

PLACE = Place(field="adder")


class Added(ProcessMessage, tag="added"):
    """The sum; of an object that was just made its name."""

    sum: float
    name: str = ""


class Add(ProcessMessage, tag="add"):
    """Add two numbers with the object of that number."""

    call: ClassVar[str] = "add"
    number: int
    numbers: tuple[float, float]


said = decoder_of(Added | Failed | Refused)


class Adders(ServedKind):
    """The adders of a file."""

    what = "an adder"
    told = decoder_of(Make | Drop | Add)

    def make(self, told: Make, path: Path, wanted: dict[str, Any]) -> Added:
        """One more."""
        found: Any = made_by(path, told.source, wanted["name"], self.what, PLACE, "")
        refuse_lacking(found, wanted["name"], ("add",), PLACE, "")
        self.made[told.number] = found
        return Added(len(self.made), found.name)

    def answers(self, told: Add) -> Iterator[Added]:
        """What it says."""
        yield Added(self.made[told.number].add(*told.numbers))


main = partial(serve, Adders())
