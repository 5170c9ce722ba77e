"""The whole content of an evidence report as frozen data, from which the page and the JSON are written.

The types define three things: the JSON, the reader of the JSON, and its schema.

Numbers are in SI. Each probability is the probability of a violation in a run that tests the claim. An
unknown value is None or an empty tuple, never a number.
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
from safety_harness.cell.simulation.worlds import world_labelled
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
)  # the JSON has these fields only if they are not empty
UNMADE = "cannot be made"  # marks the finding on a part of the report that failed after the runs
UNANSWERED = "decision faults"  # key of a stratum's decisions without a usable answer of the avoider


class ClaimStatus(Enum):
    """The status of a claim.  The page colours only SHOWN green."""

    # from best to worst: SEVERITY and the verdict of a plan depend on this order
    SHOWN = "shown"
    ESTIMATED = "estimated only"  # the plan sets no target
    DOUBTED = "shown with doubt"  # some run has no verdict, or model only, or by the fallback
    NOT_SHOWN = "not shown"
    INCOMPLETE = "runs missing"
    UNTESTED = "never put to the test"
    REFUTED = "refuted"


@dataclass(frozen=True, kw_only=True)
class Bound:
    """An exact interval of the violation probability; it holds alone with ``confidence``.

    Each end is wrong with at most half of the remaining probability.
    """

    lower: float
    upper: float
    confidence: float
    method: str

    @property
    def of_one_end(self) -> float:
        """The confidence with which each end of the interval holds by itself."""
        return 1.0 - (1.0 - self.confidence) / 2.0


@dataclass(frozen=True, kw_only=True)
class Quantile:
    """The margin ``at_least_si`` that at least ``share`` of the runs keep.

    It holds with the interval's confidence, alone.
    """

    share: float
    at_least_si: float


@dataclass(frozen=True, kw_only=True)
class ClaimResult:
    """The result of a claim in one stratum.

    ``runs`` is the sum of the five counts after it.  ``bound`` is None without trials, or while runs of the
    plan are missing.  ``margins_si`` ascend, and have only as many points as a curve needs.
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
    shares: tuple[float, ...] = ()  # for each of margins_si: the share of runs with no larger margin
    quantiles: tuple[Quantile, ...] = ()

    @property
    def tested(self) -> int:
        """The number of runs that exercise the claim, whatever their outcome."""
        return self.runs - self.untested


@dataclass(frozen=True, kw_only=True)
class StandardTerm:
    """A term of a standard that a claim refers to."""

    standard: str
    term: str


@dataclass(frozen=True, kw_only=True)
class ClaimEvidence:
    """The evidence on a claim of the plan over all strata.

    ``target`` is None if the plan sets no target.  ``hazard_is_authors`` is true if the plan's author wrote
    ``hazard``.  ``unit`` and ``per_si`` convert margins for display.
    """

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
    """An upper bound on the violations of a claim in an hour.

    It is ``per_run``, the bound per run, times the approaches in an hour. ``stratum`` has the largest bound
    per run, so the bound holds for every mixture of strata.
    """

    claim: int
    stratum: str
    per_run: float
    an_hour: float


@dataclass(frozen=True, kw_only=True)
class HazardEvidence:
    """A hazard of the plan in its author's words, the ``steps`` from it to the required rate, and the bounds.

    ``claims`` are the numbers of the claims under it.  ``asked_an_hour`` is the required rate, None without
    one. ``approaches_an_hour`` is an upper bound that holds with ``rate_confidence``.  All rates hold
    together with the plan's confidence, apart from its bounds per run.
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
        """True if every rate meets the required rate.

        None if the required rate, a claim or a bound is missing.
        """
        if self.asked_an_hour is None or not self.claims or len(self.rates) < len(self.claims):
            return None
        return all(rate.an_hour <= self.asked_an_hour for rate in self.rates)


@dataclass(frozen=True, kw_only=True)
class StratumResult:
    """A part of the operational domain, and the outcome of its runs.

    ``decisions`` are (kind, number) over all runs.  ``refused_draws`` counts the draws that admission
    refused.
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
    """The number of times that the gate overruled the avoider in a stratum.

    ``proposals`` and ``overruled`` count proposals. ``runs`` counts the runs with a proposal,
    ``runs_overruled`` the runs with an overruled proposal.  ``bound`` is of the share of the latter, an
    interval apart from the bounds that hold together. It is None without such runs, or while runs are
    missing.  ``words`` give the gate's reasons and the replacements.
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
    """The plan of the runs."""

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
    """The system under test.

    Pairs are (label, value) in words.  ``gate`` is empty without a gate.
    """

    under_test: tuple[SystemUnderTest, ...]  # the different systems of the strata
    card: tuple[tuple[str, str], ...]
    limits: tuple[str, ...]
    gate: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str], ...]
    changed: tuple[tuple[str, str, str], ...]  # setting, default, in this plan

    @property
    def tested(self) -> str:
        """The names of all avoiders and controllers, each with its safety filter."""
        names = (
            system.tested.name
            + (f" with safety filter {part.name}" if (part := system.safety_filter) else "")
            + (f" with predictor {part.name}" if (part := system.predictor) else "")
            for system in self.under_test
        )
        return " and ".join(dict.fromkeys(names))

    @property
    def robot(self) -> str:
        """The robot's name, or the names of all robots."""
        return " and ".join(dict.fromkeys(system.robot.name for system in self.under_test))

    @property
    def asks(self) -> bool:
        """True if an avoider is under test."""
        return any(system.avoider is not None for system in self.under_test)

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """The distinct pairs of (part, name and hash)."""
        pairs = (pair for system in self.under_test for pair in system.parts.items())
        labels = (
            (
                name.replace("_", " ").capitalize(),
                f"{part.name}, sha256 {part.sha256}" if part.sha256 else part.name,
            )
            for name, part in pairs
        )
        return tuple(dict.fromkeys(labels))


@dataclass(frozen=True, kw_only=True)
class SeparationTerm:
    """A term of the protective separation distance."""

    symbol: str
    length_m: float
    meaning: str


@dataclass(frozen=True, kw_only=True)
class SeparationCase:
    """The pair of hand and arm with the least margin in a stored run, at one assumed speed of the human."""

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
    """A distinct violation.

    ``independent`` is true if a declared run met it, false for a search.  ``like_it`` counts the violations
    of its kind.  ``claim`` is None if the plan does not have it.
    """

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
    """The causes of the violations in the declared runs.

    ``about`` states how many of the violations were attributed, and is empty without a violation.  ``groups``
    counts the violations for each cause. ``would_help`` counts, for each single change, the violations that
    it would have avoided.
    """

    about: str
    groups: tuple[tuple[str, int], ...]
    would_help: tuple[tuple[str, int], ...]


@dataclass(frozen=True, kw_only=True)
class SearchSummary:
    """The search for counterexamples; it never enters a bound."""

    runs: int
    searcher: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class OpenFinding:
    """An open point that an assessor has to look at."""

    text: str
    place: str  # id on the page


@dataclass(frozen=True, kw_only=True)
class ArgumentNote:
    """The author's note on an element of the argument, by the element's name."""

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
    """The origin of the report."""

    package_version: str
    source_hash: str
    python: str
    platform: str
    machine: str
    libraries: tuple[tuple[str, str], ...]
    command: str
    commands: tuple[str, ...]  # each repeats a part of the report
    began_at: str
    ended_at: str
    run_seconds_s: float


@dataclass(frozen=True, kw_only=True)
class Record:
    """The hashes that lodged copies can confirm.

    ``rows_sha256`` is the Merkle root over all episodes (RFC 6962).  ``declaration_sha256`` is the hash that
    ``certify declare`` printed for this plan, seed and software; empty without a declaration.
    """

    rows_sha256: str
    declaration_sha256: str


@dataclass(frozen=True, kw_only=True)
class CertifiedClaim:
    """A proven claim.

    ``claim`` and ``region`` have the certificate's names. ``confirmed`` has the checker's words. ``gates``
    state for each stratum whether the gate takes answers only to questions in the region.
    """

    claim: str
    region: str
    verdict: str
    confirmed: str
    maps: tuple[BoxMap, ...]
    gates: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class CertifiedProofs:
    """The confirmed proofs about the network with this hash."""

    network_sha256: str
    claims: tuple[CertifiedClaim, ...]


@dataclass(frozen=True, kw_only=True)
class TrainingDistance:
    """The distance of a stratum from the training data of its network.

    ``runs`` counts all runs with a hand, by whether hand and TCP were seen at the most severe decision, in
    the order of ``search.coverage.SEEN``.  The next fields cover the hands in the ``decisions`` of the stored
    random runs. ``share_outside`` is the share outside of the box of seen hands. The distances (m) from that
    box cover the hands outside.  A field without data is None.
    """

    stratum: str
    runs: tuple[int, ...]
    decisions: int
    share_outside: float | None
    median_outside_m: float | None
    largest_outside_m: float | None


@dataclass(frozen=True, kw_only=True)
class LearnedPart:
    """The learned part of the system.

    ``networks`` are (name, SHA-256 of the file).  ``seen`` names the training data of the distances.
    ``life`` has (label, text) on training, use and service.
    """

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
    proven: CertifiedProofs | None = None  # about the avoider's network; None without a certificate
    hazards: tuple[HazardEvidence, ...] = ()  # the plan's hazards
    notes: tuple[ArgumentNote, ...] = ()  # the author's notes on the argument
    learned: LearnedPart | None = None  # None if no part can be learned
    shields: tuple[str, ...] = ()  # how the theorem of each shield stands

    @property
    def fallback(self) -> str:
        """A text for headlines on how often the fallback replaced the avoider.

        The text is empty if the fallback never replaced the avoider.
        """
        decisions = [pair for stratum in self.strata for pair in stratum.decisions]
        unanswered = sum(count for kind, count in decisions if kind == UNANSWERED)
        return fallback_words(unanswered, sum(count for kind, count in decisions if kind != UNANSWERED))

    @property
    def unmade(self) -> list[str]:
        """The parts of the report that failed after the runs, each with the reason."""
        return [finding.text for finding in self.findings if f" {UNMADE}: " in finding.text]

    @property
    def simulator(self) -> str:
        """The user's simulator that made the runs, as text.

        The text is empty if a built-in world made the runs.
        """
        world = world_labelled(self.plan.world)
        return str(world) if world is not None and world.program else ""

    @property
    def basis(self) -> str:
        """A text on the basis of the verdicts: world, exercised runs, exclusions and assumptions."""
        world = f"the {self.plan.world} world" if self.plan.model_only else self.plan.world
        counts = [
            (sum(row.tested - row.failed for row in claim.outcomes), sum(row.runs for row in claim.outcomes))
            for claim in self.claims
        ]
        return basis([self.simulator or world], counts, (*self.exclusions, *self.assumptions))

    @property
    def full(self) -> bool:
        """True if the user asked for a PDF of the whole page (``--full``)."""
        return "--full" in self.provenance.command.split()


SEVERITY = list(ClaimStatus)


def by_severity(claims: Iterable[ClaimEvidence]) -> list[ClaimEvidence]:
    """Return ``claims`` in the order of severity, beginning with the most severe status.

    If two claims have the same status, the claim with the larger bound comes first.
    """

    def key(claim: ClaimEvidence) -> tuple[int, float]:
        bounds = [outcome.bound.upper for outcome in claim.outcomes if outcome.bound is not None]
        return -SEVERITY.index(claim.standing), -max(bounds, default=0.0)

    return sorted(claims, key=key)


def as_text(evidence: Evidence) -> str:
    """Return ``evidence`` as JSON.

    Raises:
        ValueError: A number is not finite.

    """
    document = plain(evidence)
    for name in LATER:
        if not document[name]:
            del document[name]
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def read_evidence(path: Path) -> Evidence:
    """Read a report that ``as_text`` of this version or of an earlier version wrote.

    Args:
        path: The file evidence.json in a report's folder.

    Returns:
        The evidence. A field that an earlier version did not write has its default value.

    Raises:
        InputError: The file is no evidence report, or a field is wrong. The error states the place of the
            field.

    """
    document = of_format(read_json(path, "an evidence report"), FORMAT, path)
    try:
        return typed(_as_now(document), Evidence, path)
    except InputError as error:
        origin = document.get("provenance")
        if isinstance(origin, dict) and origin.get("source_hash") == source_hash():
            raise
        raise InputError(place=error.place, expected=error.expected, got=error.got, hint=OLDER) from error


def _as_now(document: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of an earlier version, converted to the fields of this version.

    Earlier versions recorded only the avoider and the robot of the system, or omitted the safety filter and
    the predictor.
    """
    whole = {name: getattr(Evidence, name) for name in LATER} | document
    known, system = whole.get("credibility"), whole.get("system")
    if isinstance(known, dict):
        whole["credibility"] = {"cells": []} | known
    if isinstance(system, dict) and system.keys() >= _NOTED_THEN:
        parts = {
            part: {"name": system[part], "sha256": system[f"{part}_sha256"]} for part in ("avoider", "robot")
        }
        rest = {name: value for name, value in system.items() if name not in _NOTED_THEN}
        whole["system"] = rest | {"under_test": [plain(NOT_NOTED) | parts]}
    elif isinstance(system, dict) and isinstance(system.get("under_test"), list):
        parts_then = system["under_test"]
        if all(isinstance(part, dict) for part in parts_then):
            lacking = {"safety_filter": None, "predictor": None}
            whole["system"] = system | {"under_test": [lacking | part for part in parts_then]}
    return whole


OLDER = (
    "if another version of this package wrote it, verify it with that version, or certify the plan in the "
    "report's folder plan/ anew"
)
_NOTED_THEN = {"avoider", "avoider_sha256", "robot", "robot_sha256"}


def schema() -> dict[str, Any]:
    """Return the published schema of the JSON (draft 2020-12).

    Every object must have all of its fields, apart from the fields in ``LATER``, and no further fields.
    """
    document = msgspec.json.schema(Evidence)
    for kind in document["$defs"].values():
        if kind.get("type") == "object":  # it has exactly these fields
            kind |= {"required": list(kind["properties"]), "additionalProperties": False}
            for part in kind["properties"].values():
                part.pop("default", None)
    whole = document["$defs"]["Evidence"]
    whole["properties"]["format"] = {"const": FORMAT}
    whole["required"] = [name for name in whole["required"] if name not in LATER]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": FORMAT, **document}
