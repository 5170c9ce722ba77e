"""The hazard that a claim of the catalogue is about, and the terms of the standards that it is traced to.

Terms only: a claim speaks the standards' language so that an assessor finds the way, which is no statement
of conformity.  ``standards.yaml`` has the standards, their editions, the part of the report that speaks to
each requirement, and the hazards with the keys of their claims.
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
TABLE, ASKED = (Path(__file__).with_name(name) for name in ("standards.yaml", "questions.yaml"))


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """What a standard ``asks``; ``here`` is the id of the part of the page that speaks to it, or empty.

    ``means`` is what that part says of it, or what it would take where nothing here speaks to it.
    """

    asks: str
    means: str
    here: str = ""


@dataclass(frozen=True, kw_only=True)
class Standard:
    """A document with its edition in its ``name``, what it is ``about``, and where that is known from."""

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
    """``checked``: year and month in which each status was last looked up."""

    checked: str
    standards: tuple[Standard, ...]
    hazards: tuple[Tracing, ...]

    def __getitem__(self, key: str) -> Standard:
        return next(one for one in self.standards if one.id == key)


def _table(file: Path, kind: type[T]) -> T:
    return typed(YAML(typ="safe", pure=True).load(file.read_text("utf-8")), kind, file, defaults=True)


STANDARDS = _table(TABLE, StandardsTable)
TRACED = {
    claim: replace(
        one, terms=tuple(replace(term, standard=STANDARDS[term.standard].name) for term in one.terms)
    )
    for one in STANDARDS.hazards
    for claim in one.claims
}
OWN = Tracing(hazard="not stated by the plan: the claim is a formula of its author's")


@dataclass(frozen=True, kw_only=True)
class AssessorQuestion:
    """What an assessor ``asks`` by the standard ``of``; ``here`` and ``means`` as of a requirement."""

    of: str
    asks: str
    means: str
    here: str = ""


QUESTIONS = _table(ASKED, tuple[AssessorQuestion, ...])


def standards_of(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """Yield the line of a claim's description that names the standards that it is traced to."""
    terms = TRACED.get(entry.key, OWN).terms
    yield "standards", "; ".join(f"{term.standard}: {term.term}" for term in terms) or "none"


def traced(entry: CatalogueEntry | None) -> Tracing:
    """Return the hazard and the terms of a claim of the catalogue; of a formula, ``entry`` is None."""
    return OWN if entry is None else TRACED.get(entry.key, OWN)
