"""Choose the episodes for faults: shipped scenarios, then draws of the spaces, in a fixed order.

``quick`` takes a couple of minutes on two idle cores; ``nightly`` uses all scenarios and many draws.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import with_avoider, with_part
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.exceptions import InputError, Place, ScenarioError, near_miss
from safety_harness.base.seeds import Branch, seed
from safety_harness.base.shipped.contents import located
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.space.read import read_space

LONG_S = 30.0  # longer scenarios come last: they cost as much as several short ones

# The scenarios that catch most faults come first, as measured in docs/results/self-test.md.
TELLING = (
    "hand-visits-and-leaves",
    "second-hand",
    "hesitating-reach",
    "hand-stays",
    "overhead-camera",
    "own-formulas",
    "network-certain",
    "network-in-doubt",
    "cornered",
    "between-two-hands",
    "servoing-alone",
    "stops-in-time",
    "nothing-reachable",
    "lost-between-two-hands",
    "object-lost-and-found",
    "fault-camera-hidden-by-a-hand",
    "fault-camera-blind",
    "tilted-start",
    "over-the-shoulder",
    "proven-region",
    "hidden-for-a-moment",
)


@dataclass(frozen=True, kw_only=True)
class SelfTestProfile:
    """The extent of a self-test.

    It always includes the TELLING scenarios, with ``others`` all other scenarios, and ``draws`` draws of each
    space.
    """

    name: str
    others: bool
    draws: int


QUICK = SelfTestProfile(name="quick", others=False, draws=2)
NIGHTLY = SelfTestProfile(name="nightly", others=True, draws=30)
PROFILES = (QUICK, NIGHTLY)


def profile_named(name: str) -> SelfTestProfile:
    """Return the profile with the name ``name``; raise ScenarioError if there is none."""
    profiles = {profile.name: profile for profile in PROFILES}
    if name not in profiles:
        hint = near_miss(name, profiles)
        raise ScenarioError.of_option("--profile", " or ".join(profiles), repr(name), hint)
    return profiles[name]


@dataclass(frozen=True)
class SelfTestPlan:
    """The profile of a self-test, the folder of scenarios, and the ``avoider`` that replaces their own.

    ``safety_filter`` is the user's filter that each scenario gets, if any, and ``predictor`` the predictor of
    each scenario with the visual servo. ``world`` is that of all runs.
    """

    profile: SelfTestProfile
    folder: Path
    avoider: str | None
    safety_filter: str | None = None
    predictor: str | None = None
    world: WorldEntry = KINEMATIC

    def episodes(self) -> tuple[Admitted, ...]:
        """Return the episodes, at least one, in the order in which they are tried.

        The TELLING scenarios of ``folder`` come first, then the other scenarios, then draws of the folder's
        spaces. A profile without ``others`` omits the other scenarios if there are any telling ones.
        Scenarios that the world cannot run are always omitted.

        The method raises InputError if a file cannot be used, or if no episode is left.
        """
        folder = located(self.folder)
        if not folder.is_dir():
            raise ScenarioError(
                place=Place(field="--scenarios"),
                expected="a folder with scenario files",
                got=f"no such folder: {folder}",
                hint="the shipped ones: shipped:scenarios",
            )
        gathered = gather([folder])
        if gathered.errors:
            raise gathered.errors[0]
        ordered = sorted(gathered.scenarios, key=_rank)
        telling = [scenario for scenario in ordered if scenario.name in TELLING]
        episodes = list(self._admitted(telling if telling and not self.profile.others else ordered))
        spaces = [read_space(path) for path in sorted((folder / "spaces").glob("*.yaml"))]
        for number, space in enumerate(spaces):
            drawn = draw_admissible(space, seed(0, Branch.SELFTEST, 0, number), self.profile.draws)
            episodes += self._admitted(drawn.scenarios)
        if not episodes:
            raise ScenarioError(
                place=Place(field="--scenarios"),
                expected=f"a scenario that {self.world} can run",
                got=f"no such scenario among {len(ordered)} in {self.folder}",
            )
        return tuple(episodes)

    def _admitted(self, scenarios: Iterable[Scenario]) -> Iterator[Admitted]:
        """Admit and yield the scenarios that the world can run."""
        for scenario in scenarios:
            try:
                self.world.refuse(scenario)
            except InputError:
                continue
            tested = scenario if self.avoider is None else with_avoider(scenario, self.avoider)
            if self.safety_filter is not None:  # which takes the place of a shield
                tested = with_part(replace(tested, shield=None), "safety_filter", self.safety_filter)
            if self.predictor is not None and not scenario.driven:  # a controller does its own prediction
                tested = with_part(tested, "predictor", self.predictor)
            yield admit(tested)


def _rank(scenario: Scenario) -> tuple[int, float, str]:
    place = TELLING.index(scenario.name) if scenario.name in TELLING else len(TELLING)
    return place, max(scenario.duration_s, LONG_S), scenario.name


def claims_of(scenario: Scenario) -> tuple[Claim, ...]:
    """Return the whole catalogue with its examples' limits, and the scenario's claims that must hold."""
    examples = [Claim(sentence=entry.example, expected=Verdict.HOLDS) for entry in CATALOGUE]
    known = {claim.sentence for claim in examples}
    own = [c for c in scenario.claims if c.expected is Verdict.HOLDS and c.sentence not in known]
    return (*examples, *own)
