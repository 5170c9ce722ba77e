"""The hazard of each claim of the catalogue, and the terms of the standards that the claim refers to.

These are terms only: they help an assessor to find the way, and state no conformity. ``standards.yaml`` has
the standards, their editions, the requirements that this report addresses, and the hazards with their claims.
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
class Tracing:
    """The hazard that claims are about, terms of the standards, and the keys of these claims.

    In the table a term names the ``id`` of its standard, and in ``TRACED`` the name.
    """

    hazard: str
    terms: tuple[StandardTerm, ...] = ()
    claims: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StandardsTable:
    """All standards; ``checked`` is the year and month of the last check of each status."""

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
    """An assessor's question (``asks``) by the standard ``of``.

    A Requirement explains ``here`` and ``means``.
    """

    of: str
    asks: str
    means: str
    here: str = ""


QUESTIONS = _table(QUESTIONS_FILE, tuple[AssessorQuestion, ...])


def standards_of(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield the line that names the standards of the catalogue's ``entry``, for its description."""
    terms = TRACED.get(entry.key, OWN).terms
    yield "standards", "; ".join(f"{term.standard}: {term.term}" for term in terms) or "none"


def traced(entry: CatalogueEntry | None) -> Tracing:
    """Return the hazard and the terms of a claim of the catalogue; of a formula, ``entry`` is None."""
    return OWN if entry is None else TRACED.get(entry.key, OWN)
