"""From a claim's sentence to its property: one of the catalogue, or a formula."""

from __future__ import annotations

import re
from difflib import get_close_matches
from functools import lru_cache

from safety_harness.exceptions import InadmissibleError
from safety_harness.formulas.claim import FormulaClaim
from safety_harness.formulas.parse import looks_like_formula, parse_formula
from safety_harness.properties.base import Property
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.scenario.model import Claim, Scenario


def property_of(claim: Claim, scenario: Scenario) -> Property:
    """The property that a claim's sentence names.

    FormulaError for a formula that cannot be read, or that has no room in the scenario;
    InadmissibleError with the catalogue for what is no formula either.
    """
    meant = _entry_of(claim.sentence)
    if meant is not None:
        entry, match = meant
        return entry.property_of(match, scenario, claim.place)
    if looks_like_formula(claim.sentence):
        formula = FormulaClaim(parse_formula(claim.sentence, claim.place))
        formula.check(scenario, claim.place)
        return formula
    examples = [entry.example for entry in CATALOGUE]
    near = get_close_matches(claim.sentence, examples, n=1, cutoff=0.5)
    raise InadmissibleError(
        place=claim.place,
        expected='a formula such as "always hand distance > 50 mm", or a claim of the catalogue: '
        + "; ".join(examples),
        got=repr(claim.sentence),
        hint=f"did you mean {near[0]!r}?" if near else "",
    )


@lru_cache(maxsize=256)  # the scenarios of a space claim the same
def _entry_of(sentence: str) -> tuple[CatalogueEntry, re.Match[str]] | None:
    """Which entry of the catalogue a sentence is, and its parts."""
    for entry in CATALOGUE:
        match = entry.understands(sentence)
        if match:
            return entry, match
    return None
