"""From a claim's sentence to its property: one of the catalogue, or a formula."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache

from safety_harness.exceptions import InadmissibleError, near_miss
from safety_harness.formulas.claim import FormulaClaim
from safety_harness.formulas.parse import ALL_CLAIMS, looks_like_formula, parse_formula
from safety_harness.properties.base import SI_UNITS, Property
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.protective_separation import ProtectiveSeparation
from safety_harness.properties.separation import WALKING_MPS
from safety_harness.scenario.model import BY_AT_MOST, EDITION, Claim, Scenario


def property_of(claim: Claim, scenario: Scenario) -> Property:
    """The property that a claim's sentence names.

    FormulaError for a formula that cannot be read, or that has no room in the scenario;
    InadmissibleError with the catalogue for what is no formula either, and for a bound in another unit.
    """
    found = _property_of(claim, scenario)
    if claim.most is not None and (claim.most[1] or "1") != SI_UNITS[found.unit]:
        expected = f"{claim.expected.value}{BY_AT_MOST}a margin in {found.unit.symbol or 'whole numbers'}"
        raise InadmissibleError(place=claim.place, expected=expected, got=claim.expectation)
    return found


def _property_of(claim: Claim, scenario: Scenario) -> Property:
    meant = _entry_of(claim.sentence)
    if meant is not None:
        entry, match = meant
        found = entry.property_of(match, scenario, claim.place)
        if claim.edition < EDITION and isinstance(found, ProtectiveSeparation):
            default_mps = WALKING_MPS if claim.edition < 2 else found.default_mps
            return replace(found, default_mps=default_mps, tcp_alone=True)
        return found
    if looks_like_formula(claim.sentence):
        formula = FormulaClaim(parse_formula(claim.sentence, claim.place))
        formula.check(scenario, claim.place)
        return formula
    examples = [entry.example for entry in CATALOGUE]
    raise InadmissibleError(
        place=claim.place,
        expected='a claim of the catalogue, or a formula such as "always hand distance > 50 mm"',
        got=repr(claim.sentence),
        hint=near_miss(claim.sentence, examples, most=3, all_of_them=ALL_CLAIMS),
    )


@lru_cache(maxsize=256)  # the scenarios of a space claim the same
def _entry_of(sentence: str) -> tuple[CatalogueEntry, re.Match[str]] | None:
    """Which entry of the catalogue a sentence is, and its parts."""
    for entry in CATALOGUE:
        match = entry.understands(sentence)
        if match:
            return entry, match
    return None
