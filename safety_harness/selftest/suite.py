"""What faults are tried on: shipped scenarios, then draws of the spaces, in a fixed order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.spaces import draw_admissible
from safety_harness.exceptions import InputError, Place, ScenarioError
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.seeds import Branch, seed
from safety_harness.simulation.worlds import KINEMATIC
from safety_harness.space.read import read_space

LONG_S = 30.0  # such scenarios come last: they cost as much as several others


@dataclass(frozen=True, eq=False)
class Suite:
    """Admitted scenarios in the order in which they are tried, one at least."""

    episodes: tuple[Admitted, ...]

    @classmethod
    def read(
        cls,
        folder: Path,
        *,
        first: Sequence[str] = (),
        others: bool = True,
        avoider: str | None = None,
        draws: int = 0,
    ) -> Suite:
        """The scenarios of ``folder``, those named ``first`` before the ``others``, then draws of its spaces.

        Without ``others`` only those named are taken, if there are any.  ``avoider`` takes the place of
        what they name.  What only PyBullet can run is left out.  InputError for a file that cannot be used,
        or if nothing is left to try.
        """
        if not folder.is_dir():
            raise ScenarioError(
                place=Place(field="--scenarios"),
                expected="a folder with scenario files",
                got=f"no such folder: {folder}",
                hint="the shipped ones are in scenarios/ of the repository",
            )
        gathered = gather([folder])
        if gathered.errors:
            raise gathered.errors[0]
        ordered = sorted(gathered.scenarios, key=lambda one: _rank(one, first))
        named = [one for one in ordered if one.name in first]
        episodes = list(_admitted(ordered if others or not named else named, avoider))
        spaces = [read_space(path) for path in sorted((folder / "spaces").glob("*.yaml"))]
        for number, space in enumerate(spaces):
            if draws:
                drawn = draw_admissible(space, seed(0, Branch.SELFTEST, 0, number), draws).scenarios
                episodes += _admitted(drawn, avoider)
        if not episodes:
            raise ScenarioError(
                place=Place(field="--scenarios"),
                expected="a scenario that the kinematic world can run",
                got=f"none of the {len(ordered)} in {folder}",
            )
        return cls(tuple(episodes))


def _rank(scenario: Scenario, first: Sequence[str]) -> tuple[int, float, str]:
    place = first.index(scenario.name) if scenario.name in first else len(first)
    return place, max(scenario.duration_s, LONG_S), scenario.name


def _admitted(scenarios: Iterable[Scenario], avoider: str | None) -> Iterator[Admitted]:
    """Those that the kinematic world can run."""
    for scenario in scenarios:
        try:
            KINEMATIC.refuse(scenario)
        except InputError:
            continue
        yield admit(scenario if avoider is None else with_avoider(scenario, avoider))


def claims_of(scenario: Scenario) -> tuple[Claim, ...]:
    """The whole catalogue as its examples have it, and what the scenario itself claims to hold."""
    examples = [Claim(sentence=entry.example, expected=Verdict.HOLDS) for entry in CATALOGUE]
    known = {claim.sentence for claim in examples}
    own = [c for c in scenario.claims if c.expected is Verdict.HOLDS and c.sentence not in known]
    return (*examples, *own)
