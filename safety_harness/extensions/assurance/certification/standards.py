"""The hazard of each claim in the catalogue, and the terms of the standards to which the claim refers.

These terms only help an assessor to find the way, and state no conformity. ``standards.yaml`` has the
standards with their editions and the requirements that this report addresses. It also has the hazards with
their claims.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from ruamel.yaml import YAML

from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.extensions.assurance.certification.evidence import StandardTerm
from safety_harness.scenario.typed_json import typed

T = TypeVar("T")
TABLE, QUESTIONS_FILE = (Path(__file__).with_name(name) for name in ("standards.yaml", "questions.yaml"))


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """A requirement of a standard (``asks``).

    ``here`` is the id of the page's part that addresses it; it is empty if no part does. ``means`` is the
    answer of that part, or the missing work if ``here`` is empty.
    """

    asks: str
    means: str
    here: str = ""


@dataclass(frozen=True, kw_only=True)
class Standard:
    """A document: ``name`` with its edition, subject ``about``, and the ``source`` of these statements."""

    id: str
    name: str
    about: str
    status: str
    source: str
    requirements: tuple[Requirement, ...]


@dataclass(frozen=True, kw_only=True)
class Tracing:
    """A hazard, the terms of standards that belong to it, and the keys of the claims about it.

    In the table, a term refers to its standard by ``id``; in ``TRACED`` it has the standard's name.
    """

    hazard: str
    terms: tuple[StandardTerm, ...] = ()
    claims: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StandardsTable:
    """All standards and hazards; ``checked`` is the year and month when each status was last checked."""

    checked: str
    standards: tuple[Standard, ...]
    hazards: tuple[Tracing, ...]

    def __getitem__(self, key: str) -> Standard:
        return next(standard for standard in self.standards if standard.id == key)


def _table(file: Path, kind: type[T]) -> T:
    return typed(YAML(typ="safe", pure=True).load(file.read_text("utf-8")), kind, file, defaults=True)


STANDARDS = _table(TABLE, StandardsTable)
TRACED = {
    claim: replace(
        hazard, terms=tuple(replace(term, standard=STANDARDS[term.standard].name) for term in hazard.terms)
    )
    for hazard in STANDARDS.hazards
    for claim in hazard.claims
}
OWN = Tracing(hazard="not stated by the plan: the claim is a formula of its author's")


@dataclass(frozen=True, kw_only=True)
class AssessorQuestion:
    """A question (``asks``) that an assessor by the standard ``of`` may have.

    ``here`` and ``means`` are as in ``Requirement``.
    """

    of: str
    asks: str
    means: str
    here: str = ""


QUESTIONS = _table(QUESTIONS_FILE, tuple[AssessorQuestion, ...])


def standards_of(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield a line with the standards of the catalogue's ``entry``, for the description of the entry."""
    terms = TRACED.get(entry.key, OWN).terms
    yield "standards", "; ".join(f"{term.standard}: {term.term}" for term in terms) or "none"


def traced(entry: CatalogueEntry | None) -> Tracing:
    """Return the hazard and the terms of a claim in the catalogue; ``entry`` is None for a formula."""
    return OWN if entry is None else TRACED.get(entry.key, OWN)
