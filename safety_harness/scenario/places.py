"""Where everything of a scenario stands in its file, found when it is first asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from safety_harness.exceptions import Place
from safety_harness.scenario.fields import Field, places


@dataclass(frozen=True)
class Places(Mapping[str, Place]):
    """``places`` of ``root``: few of the scenarios of a search are ever complained about."""

    root: Field

    @cached_property
    def _found(self) -> dict[str, Place]:
        return places(self.root)

    def __getitem__(self, path: str) -> Place:
        return self._found[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


@dataclass(frozen=True)
class Replaced(Mapping[str, Place]):
    """``places`` with another one of ``field``, found when it is first asked for as well."""

    places: Mapping[str, Place]
    field: str
    place: Place

    def __getitem__(self, path: str) -> Place:
        return self.place if path == self.field else self.places[path]

    def __iter__(self) -> Iterator[str]:
        return iter({**self.places, self.field: self.place})

    def __len__(self) -> int:
        return len(self.places) + (self.field not in self.places)
