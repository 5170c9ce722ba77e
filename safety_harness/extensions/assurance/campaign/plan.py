"""A plan: claims, scenario spaces, the number of runs in each space, and the traces to keep.

The identity of the results includes the plan's text. A plan is proven to be older than its results only if
another party holds the hash of the plan. docs/reference/plan.md describes the file.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from safety_harness.admission.avoiders import BESIDE, command_line_reference, with_avoider
from safety_harness.admission.claims import meaning_of, property_of
from safety_harness.admission.driving import named_system
from safety_harness.base.exceptions import InadmissibleError, InputError, Place, ScenarioError, near_miss
from safety_harness.base.shipped.contents import located
from safety_harness.cell.simulation.worlds import (
    KINEMATIC,
    REFERENCE,
    WorldEntry,
    world_labelled,
    worlds_by_label,
)
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.assurance.campaign.hazards import PlannedHazards, read_hazards
from safety_harness.extensions.assurance.campaign.identity import (
    Identity,
    PlanFile,
    files_of_plan,
    identity_of,
    unpacked,
)
from safety_harness.extensions.assurance.campaign.plan_keys import (
    CLAIM,
    KEPT,
    LEAST_TARGET,
    MOST_TARGET,
    PLAN,
    SEARCH,
    STRATUM,
)
from safety_harness.scenario.compose import Library, only_variant, rewritten
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.files import as_path, resolved
from safety_harness.scenario.kinds import FileKind, kind_of, refuse_other_kind
from safety_harness.scenario.model import (
    EDITION,
    LARGEST_SEED,
    NO_AVOIDER,
    VISUAL_SERVO,
    Claim,
    Driver,
    Scenario,
    Verdict,
)
from safety_harness.scenario.nodes import REFERRING, Node, Scalar, references_in
from safety_harness.scenario.references import file_and_name, portable
from safety_harness.scenario.units import FRACTION
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.system import SystemUnderTest

V = TypeVar("V")

MOST_RUNS = 10**9  # of a stratum
MOST_STRATA, MOST_CLAIMS = 64, 64
MOST_TRACES = 100_000  # of a stratum, some 0.4 MB each


@dataclass(frozen=True)
class PlannedClaim:
    """A claim that should hold, as its author wrote it.

    ``target`` is the largest violation probability that the plan allows. ``hazards`` are the names of the
    plan's hazards that the claim lists. ``hazard`` is a text with the names of these hazards, or the author's
    own description.
    """

    claim: Claim
    unit: Unit
    target: float | None = None
    hazard: str = ""
    hazards: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The text of the claim in the plan."""
        return self.claim.sentence


@dataclass(frozen=True, eq=False)
class Stratum:
    """A scenario space with ``runs`` independent draws."""

    name: str
    space: ScenarioSpace
    runs: int

    @property
    def number(self) -> int:
        """The number from which the seeds derive.

        The number depends on the name alone, and not on other strata.
        """
        return stratum_number(self.name)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """A plan, as returned by ``read_plan``. All its bounds hold simultaneously with ``confidence``.

    The ledger keeps the complete traces of ``random_traces`` runs and of ``violations_kept`` violations per
    stratum. ``search_runs`` is the number of runs that search for counterexamples, and no bound uses these
    runs. ``avoider`` replaces the avoiders of the spaces. ``files`` are all files of the plan.
    """

    title: str
    about: str
    avoider: str | None
    world: WorldEntry
    names_world: bool  # or takes the first reference
    confidence: float
    seed: int
    strata: tuple[Stratum, ...]
    risks: PlannedHazards
    claims: tuple[PlannedClaim, ...]
    search_runs: int
    random_traces: int
    violations_kept: int
    stop_early: bool
    file: Path
    files: tuple[PlanFile, ...]
    identity: Identity
    avoider_place: Place
    proof: Path | None = None  # a certificate for certify, which reads it; a run never does

    @property
    def name(self) -> str:
        """The name of the plan's file without its suffix."""
        return self.file.stem

    @property
    def runs(self) -> int:
        """The number of runs in all strata."""
        return sum(stratum.runs for stratum in self.strata)

    @property
    def search_world(self) -> WorldEntry:
        """The world that searches and ``campaign attribute`` use.

        This is the user's simulator if the plan has one, and otherwise the kinematic world.
        """
        return self.world if self.world.program else KINEMATIC

    @property
    def avoider_here(self) -> str | None:
        """The plan's avoider, with a path relative to the working directory.

        None if the plan has no avoider.
        """
        return None if self.avoider is None else _seen_from_here(self.file.parent, self.avoider)

    def with_avoider(self, scenario: Scenario) -> Scenario:
        """Return ``scenario`` with the plan's avoider, or unchanged if the plan has no avoider.

        Args:
            scenario: A scenario of the plan.

        """
        reference = self.avoider_here
        return scenario if reference is None else with_avoider(scenario, reference, self.avoider_place)


def read_packable(path: Path) -> Plan:
    """Return the plan in ``path``.

    A report contains a copy of the plan's files. Raise ScenarioError if such a copy would be read
    differently.
    """
    plan = read_plan(path)
    with tempfile.TemporaryDirectory(prefix="safety-harness-") as folder:
        try:
            copy = read_plan(unpacked(plan.files, Path(folder)))
        except InputError as error:
            got = f"a copy in which {error.place} is missing"
            raise ScenarioError.of_file(plan.file, _PACKABLE, got) from error
    copied, references = dict(copy.identity.parts), [*map(_stored_references, (plan, copy))]
    if name := min(references[0] ^ references[1], default=""):  # the copy's traces would have another name
        raise ScenarioError.of_file(plan.file, _PACKABLE, f"{name}, which shares no folder with a space")
    changed = [file.name for file in plan.files if copied.get(f"the file {file.name}") != file.sha256]
    if changed:
        got = f"a copy that reads {', '.join(changed)} from elsewhere"
        raise ScenarioError.of_file(plan.file, _PACKABLE, got)
    return plan


def _stored_references(plan: Plan) -> set[str]:
    """Return the references to files in the plan's spaces, in the form that a trace stores."""
    spaces = ((stratum.space.tree, (stratum.space.file or plan.file).parent) for stratum in plan.strata)
    references = ((file_and_name(text)[0] or text, at) for tree, at in spaces for text in references_in(tree))
    return {portable(text, at) for text, at in references if Path(text).suffix}


_PACKABLE = "references that a report can contain: relative paths"


def read_plan(path: str | Path, edition: int = EDITION) -> Plan:
    """Return the plan in the file ``path``, with its spaces.

    The function makes no avoider, because that would execute a user's file.

    Args:
        path: The file. ``shipped:NAME`` refers to a shipped file, and a plan may refer to a space in the same
            way.
        edition: The edition of the catalogue that gives the claims their meaning.

    Raises:
        InputError: The plan cannot be used. The error states the place in the file.

    """
    path = as_path(path, "read_plan(path)")
    refuse_other_kind(path, FileKind.PLAN)
    library = Library()
    root = Field(library.tree(path), path, path="", line=1)
    given = root.fields(PLAN.names)
    title = given.required("plan").prose("a title on one line")
    avoider, controller = given.optional("avoider"), given.optional("controller")
    reference = avoider.sentence("the name of an avoider") if avoider else None
    if controller:
        if avoider:
            raise avoider.error("one of avoider and controller: only the visual servo asks one", got="both")
        reference = Driver(controller.sentence("the name of a controller"))
    named = avoider or controller
    place = named.place if named else Place(field="avoider")
    strata = _strata(given.required("strata"), path.parent, library)
    if reference:
        for stratum in strata:
            with_avoider(stratum.space.simplest, _seen_from_here(path.parent, reference), place)
    confidence = _read(given, "confidence", lambda f: f.quantity(FRACTION, least=0.5, most=0.999999), 0.95)
    risks = read_hazards(given, confidence)
    claims = _claims(given.required("claims"), strata, risks, edition)
    keep = _read(given, "keep", lambda field: field.fields(KEPT.names), None)
    search = _read(given, "search", lambda field: field.fields(SEARCH.names), None)
    stop = given.optional("stop early")
    stop_early = stop is not None and stop.one_of({"yes": True, "no": False})
    if stop and stop_early and any(claim.target is None for claim in claims):
        raise stop.error(
            "no, or a target (violated in at most: ...) for every claim, which tells when to stop"
        )
    world = _read(given, "world", _world, REFERENCE)
    files = files_of_plan(path, library, [stratum.space for stratum in strata], reference, risks.files)
    return Plan(
        title=title,
        about=_read(given, "about", lambda f: f.prose("why, intended use, assumptions", lines=True), ""),
        avoider=reference,
        world=world,
        names_world=given.optional("world") is not None,
        confidence=confidence,
        seed=_read(given, "seed", lambda f: f.integer(least=0, most=LARGEST_SEED), 0),
        strata=strata,
        risks=risks,
        claims=claims,
        search_runs=_read(search, "runs", lambda f: f.integer(least=0, most=MOST_RUNS), 0),
        random_traces=_read(keep, "random traces", lambda f: f.integer(least=0, most=MOST_TRACES), 20),
        violations_kept=_read(keep, "violations", lambda f: f.integer(least=0, most=MOST_TRACES), 200),
        stop_early=stop_early,
        file=path,
        files=files,
        identity=identity_of(
            files,
            [s.space for s in strata],
            reference,
            world.label,
            _systems(strata, path, reference),
            edition,
        ),
        avoider_place=place,
        proof=_read(given, "proof", lambda f: path.parent / f.sentence("certificate.json of prove"), None),
    )


def _world(field: Field) -> WorldEntry:
    """Return the world that a plan refers to.

    The world is a built-in world or a user's simulator. Paths of a simulator are relative to the working
    directory.
    """
    labels = list(worlds_by_label())
    expected = f"{', '.join(labels)}, or a simulator: exec:COMMAND, tcp:HOST:PORT or unix:PATH"
    if (world := world_labelled(text := field.sentence(expected))) is None:
        raise field.error(expected, hint=near_miss(text, labels))
    return world


def _systems(
    strata: Iterable[Stratum], path: Path, reference: str | None
) -> Iterator[tuple[str, SystemUnderTest]]:
    """Yield the system under test of each stratum.

    A stratum whose program is missing is omitted, because admission refuses it later.
    """
    for stratum in strata:
        scenario = stratum.space.simplest
        if reference:
            scenario = with_avoider(scenario, _seen_from_here(path.parent, reference))
        with suppress(OSError, InadmissibleError):
            yield stratum.name, named_system(scenario)


@lru_cache(maxsize=256)  # each episode needs it
def stratum_number(name: str) -> int:
    """Return the number from which the seeds of a stratum derive: 63 bits of the SHA-256 of its name."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") >> 1


def scenarios_by_avoider(plan: Plan) -> Iterable[Scenario]:
    """Return one scenario for each avoider or controller that the plan's runs use."""
    scenarios: dict[tuple[str, ...], Scenario] = {}
    for stratum in plan.strata:
        simplest = plan.with_avoider(stratum.space.simplest)
        further: list[Scenario] = []
        if not plan.avoider:
            tree = stratum.space.tree
            further = [replace(simplest, avoider=tested) for tested in references_in(tree, ("avoider",))]
            further += [
                replace(simplest, controller=tested, avoider=NO_AVOIDER)
                for tested in references_in(tree, ("controller",))
                if tested != VISUAL_SERVO
            ]
        for field in BESIDE:
            named = references_in(stratum.space.tree, (field.replace("_", " "),))
            further += [replace(simplest, **{field: text}) for text in named]  # type: ignore[arg-type]  # of BESIDE
        for tested in (simplest, *further):
            scenarios.setdefault((command_line_reference(tested), *tested.parts_under_test[1:]), tested)
    return scenarios.values()


def _seen_from_here(folder: Path, reference: str) -> str:
    """Convert the path in ``reference``, and return the result.

    The path in ``reference`` is relative to ``folder``. The path in the result is relative to the working
    directory.
    """
    file, name = file_and_name(reference)
    if not file:
        return reference
    return type(reference)(str(located(folder / Path(file).expanduser())) + (f":{name}" if name else ""))


def _read(given: Fields | None, key: str, read: Callable[[Field], V], default: V) -> V:
    """Return the result of ``read`` for the value of ``key``, or ``default`` if the key is missing."""
    field = given.optional(key) if given else None
    return read(field) if field else default


def _strata(listed: Field, folder: Path, library: Library) -> tuple[Stratum, ...]:
    strata: list[Stratum] = []
    for item in listed.items("a list of strata", least=1, most=MOST_STRATA):
        given = item.fields(STRATUM.names)
        name = given.required("stratum").sentence("a name")
        if any(stratum_number(name) == earlier.number for earlier in strata):
            raise given.required("stratum").error("a name for one stratum only")
        runs = given.required("runs").integer(least=1, most=MOST_RUNS)
        space = given.required("space")
        expected = "the file of a scenario space, relative to the plan"
        file = located(folder / space.sentence(expected), space.place)
        if not file.is_file():
            raise space.error(expected, got=f"no such file: {file}")
        if (kind := kind_of(file)) not in (None, FileKind.SPACE):
            raise space.error(expected, got=f"{kind.words}: {file}")
        variant = only_variant(file, library, "one scenario space")
        tree = with_relative_paths(variant.tree, file.parent)  # as a report refers to files, in any folder
        strata.append(Stratum(name, space_of(tree, file, name=variant.name), runs))
    return tuple(strata)


def with_relative_paths(node: Node, folder: Path) -> Node:
    """Return a copy of ``node`` with paths relative to ``folder``.

    The function changes the paths of parts under test and of recordings.
    """

    def relative(text: str) -> str:
        file, name = file_and_name(text)
        path = Path(os.path.expanduser(file or text))
        if not path.is_absolute():
            return text
        return os.path.relpath(resolved(path), resolved(folder)) + f":{name}" * bool(name)

    return rewritten(node, dict.fromkeys(REFERRING, relative))


def _claims(
    at: Field, strata: tuple[Stratum, ...], risks: PlannedHazards, edition: int
) -> tuple[PlannedClaim, ...]:
    claims: list[PlannedClaim] = []
    meant: dict[str, str] = {}  # the sentence of each meaning
    for item in at.items("a list of claims", least=1, most=MOST_CLAIMS):
        given = item.fields(CLAIM.names)
        sentence = given.required("claim")
        text = sentence.sentence("a claim of the catalogue, or a formula")
        claim = Claim(sentence=text, expected=Verdict.HOLDS, edition=edition, place=sentence.place)
        properties = [property_of(claim, stratum.space.simplest) for stratum in strata]
        if (meaning := meaning_of(properties[0])) in meant:
            got = f"{properties[0].sentence!r}, which is {meant[meaning]!r} a second time"
            raise sentence.error("each claim once", got=got)
        meant[meaning] = properties[0].sentence
        listed = given.optional("hazards")
        hazards = risks.named(listed) if listed else ()
        if hazards and "hazard" in given:
            raise given.required("hazard").error("one of hazard and hazards", got="both")
        target = given.optional("violated in at most")
        own = _read(given, "hazard", lambda f: f.prose("what may happen to whom", lines=True), "")
        claims.append(
            PlannedClaim(
                claim,
                properties[0].unit,
                _target(target, hazards, risks) if target else None,
                "; ".join(hazards) or own,
                hazards,
            )
        )
    return tuple(claims)


def _target(field: Field, hazards: tuple[str, ...], risks: PlannedHazards) -> float:
    if isinstance(field.node, Scalar) and field.node.text == "derived":
        return risks.target(hazards, field)
    return field.quantity(FRACTION, least=LEAST_TARGET, most=MOST_TARGET)
