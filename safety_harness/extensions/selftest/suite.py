"""Choose the episodes in which faults are tried: shipped scenarios, followed by draws of the spaces.

The order of the episodes is fixed. ``quick`` takes a couple of minutes on two idle cores; ``nightly`` uses
all scenarios and many draws.
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

    It always includes the TELLING scenarios and ``draws`` draws of each space. If ``others`` is true, it also
    includes all other scenarios.
    """

    name: str
    others: bool
    draws: int


QUICK = SelfTestProfile(name="quick", others=False, draws=2)  # for a couple of minutes
NIGHTLY = SelfTestProfile(name="nightly", others=True, draws=30)  # draws: a choice
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
    """The profile of a self-test, the folder of the scenarios, and replacements of parts of the scenarios.

    ``avoider`` replaces the avoider of each scenario, unless it is None. ``safety_filter`` is the user's
    filter in each scenario, or None. ``predictor`` is the predictor in each scenario with the visual servo,
    or None. ``world`` is the world of all runs.
    """

    profile: SelfTestProfile
    folder: Path
    avoider: str | None
    safety_filter: str | None = None
    predictor: str | None = None
    world: WorldEntry = KINEMATIC

    def episodes(self) -> tuple[Admitted, ...]:
        """Return the episodes, at least one, in the order in which they are tried.

        The first episodes are the scenarios in ``folder`` that are listed in TELLING. They are followed by
        the other scenarios in ``folder``, and finally by draws of the folder's spaces. If ``others`` is false
        and ``folder`` has TELLING scenarios, the other scenarios are omitted. Scenarios that the world cannot
        run are always omitted.

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
            # A fixed seed: every self-test draws the same scenarios, so that two of them can be compared.
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
    # Only scenarios longer than ``LONG_S`` come last; among the others, the name decides.
    return place, max(scenario.duration_s, LONG_S), scenario.name


def claims_of(scenario: Scenario) -> tuple[Claim, ...]:
    """Return the claims with which a scenario is judged.

    They are the examples of all catalogue entries, and those of the scenario's own claims that must hold.
    """
    examples = [Claim(sentence=entry.example, expected=Verdict.HOLDS) for entry in CATALOGUE]
    known = {claim.sentence for claim in examples}
    own = [c for c in scenario.claims if c.expected is Verdict.HOLDS and c.sentence not in known]
    return (*examples, *own)
