"""The hazard of each claim in the catalogue, and the related terms of standards.

The terms only help an assessor to find related requirements. The terms do not state conformity.
``standards.yaml`` has the standards with their editions and the requirements that this report addresses. The
file also has the hazards with their claims.
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
    """A requirement of a standard.

    ``asks`` is the text of the requirement. ``here`` is the id of the part of the page that addresses the
    requirement. ``here`` is empty if no part addresses the requirement. ``means`` describes the answer in
    this part. If ``here`` is empty, ``means`` describes the missing work instead.
    """

    asks: str
    means: str
    here: str = ""


@dataclass(frozen=True, kw_only=True)
class Standard:
    """A document.

    ``name`` includes the edition, ``about`` is the subject, and ``source`` is the source of these statements.
    """

    id: str
    name: str
    about: str
    status: str
    source: str
    requirements: tuple[Requirement, ...]


@dataclass(frozen=True, kw_only=True)
class Tracing:
    """A hazard, the terms of standards that belong to it, and the keys of the claims about it.

    In ``standards.yaml``, a term refers to its standard by ``id``. In ``TRACED``, a term has the standard's
    name.
    """

    hazard: str
    terms: tuple[StandardTerm, ...] = ()
    claims: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StandardsTable:
    """All standards and hazards.

    ``checked`` is the year and month when each status was last checked.
    """

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
    """A question that an assessor may have.

    ``asks`` is the question, and ``of`` is the standard that the assessor applies. ``here`` and ``means``
    have the same meaning as in ``Requirement``.
    """

    of: str
    asks: str
    means: str
    here: str = ""


QUESTIONS = _table(QUESTIONS_FILE, tuple[AssessorQuestion, ...])


def standards_of(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield a label, and a text that lists the standards for the catalogue's ``entry``.

    The description of the entry shows both.
    """
    terms = TRACED.get(entry.key, OWN).terms
    yield "standards", "; ".join(f"{term.standard}: {term.term}" for term in terms) or "none"


def traced(entry: CatalogueEntry | None) -> Tracing:
    """Return the hazard and the terms of a claim in the catalogue.

    For a formula, ``entry`` is None.
    """
    return OWN if entry is None else TRACED.get(entry.key, OWN)
