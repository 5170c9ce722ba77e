"""The hazard of each claim of the catalogue, and the terms of the standards that the claim refers to.

These are terms only: they help an assessor to find the way, and state no conformity. ``standards.yaml`` has
the standards, their editions, and the requirements that this report addresses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML

from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.extensions.assurance.certification.evidence import StandardTerm
from safety_harness.scenario.typed_json import typed

TABLE, QUESTIONS_FILE = (Path(__file__).with_name(name) for name in ("standards.yaml", "questions.yaml"))


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """A requirement of a standard (``asks``).

    ``here`` is the id of the page's part that addresses it, or empty. ``means`` is that part's answer, or the
    missing work if ``here`` is empty.
    """

    asks: str
    means: str
    here: str = ""


@dataclass(frozen=True, kw_only=True)
class Standard:
    """A document: ``name`` with its edition, its subject ``about``, and the ``source`` of this knowledge."""

    id: str
    name: str
    about: str
    status: str
    source: str
    requirements: tuple[Requirement, ...]


@dataclass(frozen=True, kw_only=True)
class StandardsTable:
    """All standards; ``checked`` is the year and month of the last check of each status."""

    checked: str
    standards: tuple[Standard, ...]

    def __getitem__(self, key: str) -> Standard:
        return next(standard for standard in self.standards if standard.id == key)


STANDARDS = typed(
    YAML(typ="safe", pure=True).load(TABLE.read_text("utf-8")), StandardsTable, TABLE, defaults=True
)


@dataclass(frozen=True, kw_only=True)
class AssessorQuestion:
    """An assessor's question (``asks``) by the standard ``of``.

    A Requirement explains ``here`` and ``means``.
    """

    of: str
    asks: str
    means: str
    here: str = ""


QUESTIONS = typed(
    YAML(typ="safe", pure=True).load(QUESTIONS_FILE.read_text("utf-8")),
    tuple[AssessorQuestion, ...],
    QUESTIONS_FILE,
    defaults=True,
)
CELL, ROBOT, RISK = (STANDARDS[key].name for key in ("cell", "robot", "risk"))
FORMERLY = STANDARDS["contact"].name  # the cell's standard has its content now


@dataclass(frozen=True)
class Tracing:
    """A hazard in words, and terms of standards."""

    hazard: str
    terms: tuple[StandardTerm, ...]


def _traced(hazard: str, *terms: tuple[str, str]) -> Tracing:
    return Tracing(hazard, tuple(StandardTerm(standard=standard, term=term) for standard, term in terms))


MONITORING = (CELL, "collaborative application, speed and separation monitoring")
SEPARATION = _traced(
    "impact, crushing or trapping of a hand or forearm by the moving arm",
    MONITORING,
    (CELL, f"protective separation distance S_p ({FORMERLY}, 5.5.4)"),
)
DISTANCE = _traced(
    "impact, crushing or trapping of a hand or forearm by the arm",
    MONITORING,
    (CELL, "protective separation distance, held to a constant"),
)
REACTION = _traced(
    "the arm notices a hand, but gives way or stops too late",
    MONITORING,
    (CELL, "reaction time T_r"),
)
UNNOTICED = _traced(
    "a hand is near, and the arm does not notice it or notices it too late",
    MONITORING,
    (CELL, "reaction time T_r, and position uncertainty of the human, Z_d"),
)
LEARNED = _traced(
    "a learned proposal is followed where it should not be trusted",
    (CELL, "no term for learned parts: a fall-back within the safety function's own reach"),
)
LEARNED_ABSENT = _traced(
    "what was assessed is not what answers: the fallback stood in for the avoider",
    (CELL, "no term for learned parts: a fall-back within the safety function's own reach"),
)
AWAY = _traced("the avoiding motion itself leads towards a person", MONITORING)
SPACE = _traced(
    "the arm is sent where it cannot go, and stops or moves in an unforeseen way",
    (ROBOT, "operating space within the restricted space"),
)
SPEED = _traced(
    "the arm moves faster than separation and stopping distances allow for",
    (ROBOT, "reduced speed, monitored speed"),
    (CELL, "robot speed v_r of the protective separation distance"),
)
STOPPING = _traced(
    "the arm does not come to rest in the time that the distances allow for",
    (ROBOT, "protective stop, stopping time and stopping distance"),
    (CELL, "stopping time T_s"),
)
AVAILABILITY = _traced(
    "work is disturbed in vain, so that people come to bypass the safeguard",
    (RISK, "reasonably foreseeable misuse: defeating a safeguard"),
)
TASK = _traced("none of its own: the task, without which staying clear is no merit")
MEASUREMENT = _traced(
    "hands are taken to be where they are not", (CELL, "position uncertainty of the human, Z_d")
)

TRACED = {  # keys: the examples of the catalogue's entries
    "hand distance never below 50 mm": DISTANCE,
    "no moving part touches a hand": SEPARATION,
    "protective separation kept": SEPARATION,
    "protective separation kept at 1.6 m/s": SEPARATION,
    "protective separation kept from hands at their own speeds": SEPARATION,
    "repulsive poses reachable": SPACE,
    "proposed repulsive poses reachable": SPACE,
    "proposals lead away to within 10 mm": AWAY,
    "proposals within 60 mm of the optimum": LEARNED,
    "proposals within 3 spreads and 30 mm of the optimum": LEARNED,
    "proposals never sure and more than 60 mm from the optimum": LEARNED,
    "at most 50 % of proposals overruled": LEARNED_ABSENT,
    "acts only on answers within the gate's region": LEARNED,
    "repulsion moves away from every hand": AWAY,
    "repulsive ways clear of table, object and robot": AWAY,
    "obstacle distance never below 20 mm": AWAY,
    "uncertain answers fall back within 2 cycles": LEARNED,
    "certain answers are used": LEARNED,
    "fallback poses reachable and away": LEARNED,
    "stops where neither answer nor opposite pose can be reached": STOPPING,
    "gives way within 100 ms of a predicted hand": REACTION,
    "gives way within 100 ms of a true hand": UNNOTICED,
    "reacts within 120 ms": REACTION,
    "decisions within 100 ms": REACTION,
    "the avoider answered": LEARNED_ABSENT,
    "never gives way without a hand": AVAILABILITY,
    "never gives way without a hand within 600 mm": AVAILABILITY,
    "gives way at most 3 times": AVAILABILITY,
    "task never starved longer than 10 s": AVAILABILITY,
    "keeps its place within 5 mm": SPACE,
    "hand predictions within 50 mm": MEASUREMENT,
    "joint positions within limits": SPACE,
    "joint speeds within limits": SPEED,
    "TCP speed never above 250 mm/s": SPEED,
    "joint accelerations never above 500 deg/s2": SPEED,
    "TCP acceleration never above 2 m/s2": SPEED,
    "object in view or recovered within 2 s": TASK,
    "gain switch reached": TASK,
    "gain switch reached within 5 s": TASK,
    "gain switch reached within 600 iterations": TASK,
    "converged to the desired pose": TASK,
    "trace finite and monotone": _traced("none of its own: a record that is no record proves nothing"),
}
OWN = _traced("not stated by the plan: the claim is a formula of its author's")


def standards_of(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield the line that names the standards of the catalogue's ``entry``, for its description."""
    terms = TRACED.get(entry.example, OWN).terms
    yield "standards", "; ".join(f"{item.standard}: {item.term}" for item in terms) or "none"


def entry_of(sentence: str) -> CatalogueEntry | None:
    """Return the catalogue's entry for a ``sentence``; None for a formula."""
    return next((entry for entry in CATALOGUE if entry.understands(sentence)), None)


def traced(sentence: str) -> Tracing:
    """Return the hazard and the terms of the claim with this ``sentence``."""
    entry = entry_of(sentence)
    return OWN if entry is None else TRACED.get(entry.example, OWN)
