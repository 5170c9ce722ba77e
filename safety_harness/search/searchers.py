"""The searchers, by their names on the command line."""

from __future__ import annotations

from typing import Protocol

from safety_harness.base.exceptions import ScenarioError, near_miss, refuse_other_type
from safety_harness.search.cma_es import CmaEs
from safety_harness.search.cube import Cube
from safety_harness.search.default import Default
from safety_harness.search.diverse import Diverse
from safety_harness.search.sampling import QuasiRandom, UniformSampling
from safety_harness.search.search import Searcher


class MakesSearcher(Protocol):
    """A factory of searchers."""

    name: str

    def __call__(self, cube: Cube, *, claims: int, seed: int) -> Searcher:
        """Return a new searcher.

        Args:
            cube: The cube of the space.
            claims: The number of claims.
            seed: The root of all random numbers.

        """


SEARCHERS: tuple[MakesSearcher, ...] = (
    Default,
    UniformSampling,
    QuasiRandom,
    CmaEs,
    Diverse,
)


def searcher_named(name: str) -> MakesSearcher:
    """Return the factory of searcher ``name``.

    Raise ScenarioError, which lists all names, if ``name`` is unknown.
    """
    for make in SEARCHERS:
        if make.name == name:
            return make
    names = [make.name for make in SEARCHERS]
    refuse_other_type("searcher_named(name)", name, str, expected=f"one of {', '.join(names)}")
    expected = f"one of {', '.join(names)}"
    raise ScenarioError.of_option("searcher", expected, repr(name), near_miss(name, names))
