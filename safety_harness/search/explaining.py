"""Define the seam between a search and the package that explains its violations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from safety_harness.admission.admit import Admitter
from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.search.counterexample import Explain
from safety_harness.search.written import WrittenCounterexample

if TYPE_CHECKING:
    from safety_harness.search.session import SearchSession


class SearchFaults(Protocol):
    """The causes of a search's violations."""

    @property
    def tally(self) -> Any:
        """How often each cause occurs, for the page."""

    @property
    def summary(self) -> str:
        """One line with the number of violation groups for each cause."""

    def as_json(self) -> dict[str, object]:
        """Return the causes as JSON."""


class SearchExplainer(Protocol):
    """An explainer of the violations that a search in one world finds."""

    admitter: Admitter

    def __init__(self, world: WorldEntry) -> None:
        """Make an explainer whose replays run in ``world``."""

    @property
    def explain(self) -> Explain:
        """The function that explains one counterexample."""

    def of_search(self, session: SearchSession) -> SearchFaults | None:
        """Explain all groups of violations of a finished search."""

    def answers(self, shown: Sequence[WrittenCounterexample]) -> dict[str, dict[str, object]]:
        """Return the explanation of each counterexample as JSON, by the name of its file."""
