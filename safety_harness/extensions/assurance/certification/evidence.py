"""Everything that the evidence report shows, as frozen data: the page and the JSON are both made from it.

The JSON, what is read of it, and its schema are all three read off the types.

Numbers are in SI; probabilities are of a violation in a run that put the claim to the test.  What is not
known is None or an empty tuple, never a number that looks well.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import msgspec

from safety_harness.base.compiled import source_hash
from safety_harness.base.exceptions import InputError
from safety_harness.claims.properties.answered import fallback_words
from safety_harness.claims.properties.tally import basis
from safety_harness.extensions.assurance.certification.tools import CoverageOfRuns, Credibility, SelfTest
from safety_harness.extensions.lab.proof.maps import BoxMap
from safety_harness.scenario.typed_json import of_format, plain, read_json, typed
from safety_harness.trace.system import NOT_NOTED, SystemUnderTest

FORMAT = "safety-harness evidence 1"
LATER = (
    "proven",
    "shields",
    "hazards",
    "notes",
    "learned",
)  # fields that stand in the JSON only where there is something in them
UNMADE = "cannot be made"  # of a part of the report that failed after the runs
UNANSWERED = "decision faults"  # among a stratum's decisions: those without a usable answer of the avoider


class ClaimStatus(Enum):
    """The word on a claim.  Only the first one is ever shown in green."""

    # each is graver than those above it
    SHOWN = "shown"
    ESTIMATED = "estimated only"  # the plan sets no target
    DOUBTED = "shown with doubt"  # runs without a verdict count against it; model only; by the fallback
    NOT_SHOWN = "not shown"
    INCOMPLETE = "runs missing"
    UNTESTED = "never put to the test"
    REFUTED = "refuted"


@dataclass(frozen=True, kw_only=True)
class Bound:
    """An exact interval of the probability of a violation: it holds with ``confidence`` alone.

    Each end is wrong with half of what is left at most.
    """

    lower: float
    upper: float
    confidence: float
    method: str

    @property
    def of_one_end(self) -> float:
        """The confidence with which either end holds alone."""
        return 1.0 - (1.0 - self.confidence) / 2.0


@dataclass(frozen=True, kw_only=True)
class Quantile:
    """At least ``share`` of runs keep a margin of ``at_least_si``: with the interval's confidence, alone."""

    share: float
    at_least_si: float


@dataclass(frozen=True, kw_only=True)
class ClaimResult:
    """One claim in one stratum.

    ``runs`` is the sum of the five counts after it.  ``bound`` is None where there are no trials, or too few
    runs of the plan.  ``margins_si`` are the least ones first, thinned to what a curve needs.
    """

    stratum: str
    planned: int
    runs: int
    holds: int
    violated: int
    inconclusive: int
    failed: int
    untested: int
    bound: Bound | None
    standing: ClaimStatus
    why: str
    least_margin_si: float | None
    margins_si: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()  # the share of margins that are no larger
    quantiles: tuple[Quantile, ...] = ()

    @property
    def tested(self) -> int:
        """Runs that put the claim to the test, whatever came out."""
        return self.runs - self.untested


@dataclass(frozen=True, kw_only=True)
class StandardTerm:
    """A term of a standard that a claim is traced to."""

    standard: str
    term: str


@dataclass(frozen=True, kw_only=True)
class ClaimEvidence:
    """One claim of the plan over all strata; ``unit`` and ``per_si`` are how its margins are shown."""

    number: int
    sentence: str
    target: float | None
    hazard: str
    hazard_is_authors: bool
    terms: tuple[StandardTerm, ...]
    rationale: str
    exercised_when: str
    unit: str
    per_si: float
    standing: ClaimStatus
    why: str
    outcomes: tuple[ClaimResult, ...]


@dataclass(frozen=True, kw_only=True)
class HourlyBound:
    """At most ``an_hour`` violations of a claim, of approaches of which ``per_run`` violate it at most.

    ``stratum`` is that of the largest bound per run: whichever mixture of strata an hour is, it is no worse.
    """

    claim: int
    stratum: str
    per_run: float
    an_hour: float


@dataclass(frozen=True, kw_only=True)
class HazardEvidence:
    """One hazard of the plan in its author's words, the ``steps`` to what is asked, and what is bounded.

    ``claims`` are the numbers of those under it.  ``approaches_an_hour`` is an upper bound that holds with
    ``rate_confidence``; all rates hold together with the plan's confidence, apart from its bounds per run.
    """

    name: str
    task: str
    zone: str
    body_region: str
    event: str
    severity: str
    exposure: str
    avoidance: str
    decided_by: str
    because: str
    steps: tuple[str, ...]
    level: str | None
    asked_an_hour: float | None
    claims: tuple[int, ...]
    approaches: str
    approaches_an_hour: float | None
    rate_confidence: float | None
    rates: tuple[HourlyBound, ...]

    @property
    def met(self) -> bool | None:
        """Is every rate at or below what is asked?  None where nothing is asked, or a rate is missing."""
        if self.asked_an_hour is None or not self.claims or len(self.rates) < len(self.claims):
            return None
        return all(one.an_hour <= self.asked_an_hour for one in self.rates)


@dataclass(frozen=True, kw_only=True)
class StratumResult:
    """One part of the operational domain, and what came of running it.

    ``decisions`` are (what, how many) over all runs; ``refused_draws`` those that admission refused.
    """

    name: str
    space: str
    about: str
    space_sha256: str
    planned: int
    made: int
    failed: int
    refused_draws: int
    decisions: tuple[tuple[str, int], ...]
    random_traces: int
    violation_traces: int


@dataclass(frozen=True, kw_only=True)
class OverrulingResult:
    """How often the gate overruled the avoider in one stratum: of its proposals, and of runs with a proposal.

    ``bound`` is of the share of runs with some proposal overruled, an interval of its own: it is none of the
    bounds that hold together, and None without such runs, or while runs are missing.  ``words`` say for
    which reasons, and what came instead.
    """

    stratum: str
    proposals: int
    overruled: int
    words: str
    runs: int
    runs_overruled: int
    bound: Bound | None


@dataclass(frozen=True, kw_only=True)
class DeclaredPlan:
    """The plan that the runs were made by."""

    name: str
    about: str
    file: str
    sha256: str
    text: str
    world: str
    model_only: bool
    confidence: float
    per_bound_confidence: float
    bounds: int
    seed: int
    stop_early: bool
    search_runs: int


@dataclass(frozen=True, kw_only=True)
class SystemDescription:
    """The system under test.  Pairs are (label, value) in words; ``gate`` is empty where there is none."""

    under_test: tuple[SystemUnderTest, ...]  # each that a stratum has
    card: tuple[tuple[str, str], ...]
    limits: tuple[str, ...]
    gate: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str], ...]
    changed: tuple[tuple[str, str, str], ...]  # setting, default, in this plan

    @property
    def tested(self) -> str:
        """Avoiders and controllers, by name."""
        return " and ".join(dict.fromkeys(one.tested.name for one in self.under_test))

    @property
    def robot(self) -> str:
        """Or robots."""
        return " and ".join(dict.fromkeys(one.robot.name for one in self.under_test))

    @property
    def asks(self) -> bool:
        """Is there an avoider?"""
        return any(one.avoider is not None for one in self.under_test)

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """(part, name and hash), each once."""
        found = (pair for one in self.under_test for pair in one.parts.items())
        labels = (
            (name.capitalize(), f"{part.name}, sha256 {part.sha256}" if part.sha256 else part.name)
            for name, part in found
        )
        return tuple(dict.fromkeys(labels))


@dataclass(frozen=True, kw_only=True)
class SeparationTerm:
    """One term of the protective separation distance."""

    symbol: str
    length_m: float
    meaning: str


@dataclass(frozen=True, kw_only=True)
class SeparationCase:
    """The pair with least to spare in one stored run, at one assumed speed of the human."""

    stratum: str
    run: str
    time_s: float
    distance_m: float
    required_m: float
    hand_speed_mps: float
    robot_speed_mps: float
    terms: tuple[SeparationTerm, ...]


@dataclass(frozen=True, kw_only=True)
class CalibrationCheck:
    """How often the avoider's own intervals held their target in a stratum's declared random runs.

    ``decided`` is holds, violated or inconclusive.
    """

    stratum: str
    sentence: str
    decided: str
    why: str
    decisions: int


@dataclass(frozen=True, kw_only=True)
class CounterexampleEvidence:
    """One distinct violation.  ``independent``: met by a declared run and not by a search."""

    number: int
    claim: int | None
    sentence: str
    origin: str
    independent: bool
    like_it: int
    margin: str
    scenario_file: str
    trace_file: str
    command: str
    lines: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class WhoseFault:
    """Whose fault the violations of the declared runs are.

    ``about`` says how many of how many were looked at, and is empty without a violation; ``groups`` counts
    what each is laid at, ``would_help`` the violations that each single change would have avoided.
    """

    about: str
    groups: tuple[tuple[str, int], ...]
    would_help: tuple[tuple[str, int], ...]


@dataclass(frozen=True, kw_only=True)
class SearchSummary:
    """What the hunt for counterexamples did; it never enters a bound."""

    runs: int
    searcher: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class OpenFinding:
    """Something that is open: an assessor has to look at it."""

    text: str
    place: str  # id on the page


@dataclass(frozen=True, kw_only=True)
class ArgumentNote:
    """What the author says beside an element of the argument, by the element's name."""

    element: str
    text: str


@dataclass(frozen=True, kw_only=True)
class StoredFile:
    """A file of the report's folder."""

    path: str
    sha256: str
    bytes: int


@dataclass(frozen=True, kw_only=True)
class EvidenceProvenance:
    """Where all of it comes from."""

    package_version: str
    source_hash: str
    python: str
    platform: str
    machine: str
    libraries: tuple[tuple[str, str], ...]
    command: str
    commands: tuple[str, ...]  # by which each part can be made again
    began_at: str
    ended_at: str
    run_seconds_s: float


@dataclass(frozen=True, kw_only=True)
class Record:
    """What the report can be held to by what is lodged elsewhere.

    ``rows_sha256`` is the Merkle root over all episodes (RFC 6962).  ``declaration_sha256`` is what ``certify
    declare`` printed for this very plan, seed and software; empty if nothing was declared.
    """

    rows_sha256: str
    declaration_sha256: str


@dataclass(frozen=True, kw_only=True)
class CertifiedClaim:
    """``claim`` and ``region`` as the certificate calls them, ``confirmed`` in the checker's words.

    ``gates`` say of each stratum whether the region has all questions whose answers its gate takes.
    """

    claim: str
    region: str
    verdict: str
    confirmed: str
    maps: tuple[BoxMap, ...]
    gates: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class CertifiedProofs:
    """What was confirmed of the network with this hash."""

    network_sha256: str
    claims: tuple[CertifiedClaim, ...]


@dataclass(frozen=True, kw_only=True)
class TrainingDistance:
    """How far a stratum lies from what its network was trained on.

    ``runs`` counts all runs with a hand by what was seen at their gravest decision, in the order of
    ``search.coverage.SEEN``.  Of the hands in the ``decisions`` of the stored random runs: the share outside
    of the box of seen hands, and their median and largest distance from it; None where there are none.
    """

    stratum: str
    runs: tuple[int, ...]
    decisions: int
    share_outside: float | None
    median_outside_m: float | None
    largest_outside_m: float | None


@dataclass(frozen=True, kw_only=True)
class LearnedPart:
    """``networks`` are (name, SHA-256 of the file), ``seen`` whose training the distances are from."""

    networks: tuple[tuple[str, str], ...]
    seen: tuple[str, ...]
    strata: tuple[TrainingDistance, ...]
    life: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """The whole report."""

    format: str
    interrupted: bool
    plan: DeclaredPlan
    standing: ClaimStatus
    strata: tuple[StratumResult, ...]
    overruling: tuple[OverrulingResult, ...]
    claims: tuple[ClaimEvidence, ...]
    system: SystemDescription
    assumptions: tuple[str, ...]
    exclusions: tuple[str, ...]
    separation: tuple[SeparationCase, ...]
    calibration: tuple[CalibrationCheck, ...]
    coverage: CoverageOfRuns
    counterexamples: tuple[CounterexampleEvidence, ...]
    whose_fault: WhoseFault
    search: SearchSummary | None
    credibility: Credibility
    selftest: SelfTest | None
    selftest_absent: str
    findings: tuple[OpenFinding, ...]
    record: Record
    provenance: EvidenceProvenance
    files: tuple[StoredFile, ...]
    proven: CertifiedProofs | None = None  # about the avoider's network, where a certificate was given
    hazards: tuple[HazardEvidence, ...] = ()  # where the plan names any
    notes: tuple[ArgumentNote, ...] = ()  # where its author wrote any
    learned: LearnedPart | None = None  # where an avoider is a network
    shields: tuple[str, ...] = ()  # how their theorem stands, where a stratum has one

    @property
    def fallback(self) -> str:
        """For headlines: how often the fallback stood in for the avoider; empty if that always answered."""
        decisions = [pair for stratum in self.strata for pair in stratum.decisions]
        unanswered = sum(count for what, count in decisions if what == UNANSWERED)
        return fallback_words(unanswered, sum(count for what, count in decisions if what != UNANSWERED))

    @property
    def unmade(self) -> list[str]:
        """Which parts of the report failed after the runs, and why."""
        return [one.text for one in self.findings if f" {UNMADE}: " in one.text]

    @property
    def basis(self) -> str:
        """What the verdicts rest on: world, exercised runs, and what the report excludes or assumes."""
        world = f"the {self.plan.world} world" if self.plan.model_only else self.plan.world
        counts = [
            (sum(one.tested - one.failed for one in claim.outcomes), sum(one.runs for one in claim.outcomes))
            for claim in self.claims
        ]
        return basis([world], counts, (*self.exclusions, *self.assumptions))

    @property
    def full(self) -> bool:
        """Was all of it asked for on paper?"""
        return "--full" in self.provenance.command.split()


SEVERITY = list(ClaimStatus)


def by_gravity(claims: Iterable[ClaimEvidence]) -> list[ClaimEvidence]:
    """The gravest first; those that stand alike as the plan has them."""
    return sorted(claims, key=lambda one: -SEVERITY.index(one.standing))


def as_text(evidence: Evidence) -> str:
    """The whole report as JSON; ValueError for a number that is not finite."""
    found = plain(evidence)
    for name in LATER:
        if not found[name]:
            del found[name]
    return json.dumps(found, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def read_evidence(path: Path) -> Evidence:
    """What ``as_text`` wrote, here or earlier; InputError with the place of what is not as it should be."""
    found = of_format(read_json(path, "an evidence report"), FORMAT, path)
    try:
        return typed(_as_now(found), Evidence, path)
    except InputError as error:
        made = found.get("provenance")
        if isinstance(made, dict) and made.get("source_hash") == source_hash():
            raise
        raise InputError(place=error.place, expected=error.expected, got=error.got, hint=OLDER) from error


def _as_now(found: dict[str, Any]) -> dict[str, Any]:
    """With what earlier versions left out, or noted less of: of the system only avoider and robot."""
    whole = {name: getattr(Evidence, name) for name in LATER} | found
    known, system = whole.get("credibility"), whole.get("system")
    if isinstance(known, dict):
        whole["credibility"] = {"cells": []} | known
    if isinstance(system, dict) and system.keys() >= _NOTED_THEN:
        parts = {
            part: {"name": system[part], "sha256": system[f"{part}_sha256"]} for part in ("avoider", "robot")
        }
        rest = {name: one for name, one in system.items() if name not in _NOTED_THEN}
        whole["system"] = rest | {"under_test": [plain(NOT_NOTED) | parts]}
    return whole


OLDER = (
    "if another version of this package wrote it: verify it with that one, or certify anew the plan in the "
    "report's folder plan/"
)
_NOTED_THEN = {"avoider", "avoider_sha256", "robot", "robot_sha256"}


def schema() -> dict[str, Any]:
    """The published schema of the JSON (draft 2020-12)."""
    found = msgspec.json.schema(Evidence)
    for kind in found["$defs"].values():
        if kind.get("type") == "object":  # with all of its fields and no others
            kind |= {"required": list(kind["properties"]), "additionalProperties": False}
            for part in kind["properties"].values():
                part.pop("default", None)
    whole = found["$defs"]["Evidence"]
    whole["properties"]["format"] = {"const": FORMAT}
    whole["required"] = [name for name in whole["required"] if name not in LATER]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": FORMAT, **found}
