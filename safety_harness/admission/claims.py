"""From a claim's sentence to its property: one of the catalogue, or a formula."""

from __future__ import annotations

import re
from dataclasses import replace

from safety_harness.base.exceptions import FormulaError, InadmissibleError, Place, near_miss
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.formula import Always, Comparison, Relation, parts_of
from safety_harness.claims.formulas.parse import ALL_CLAIMS, looks_like_formula, parse_formula
from safety_harness.claims.formulas.signals import nearest_hand_to_tcp, predicted_hand_distance
from safety_harness.claims.properties.base import SI_UNITS, Property
from safety_harness.claims.properties.catalogue import CATALOGUE, entry_claimed
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.signals.separation import WALKING_MPS
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
    meant = entry_claimed(claim.sentence)
    if meant is not None:
        entry, match = meant
        found = entry.property_of(match, scenario, claim.place)
        if claim.edition < EDITION and isinstance(found, ProtectiveSeparation):
            default_mps = WALKING_MPS if claim.edition < 2 else found.default_mps
            return replace(found, default_mps=default_mps, tcp_alone=True)
        if claim.edition >= EDITION:
            _refuse_more_than_a_step(found, scenario, claim.place)
        return found
    if looks_like_formula(claim.sentence):
        formula = FormulaClaim(parse_formula(claim.sentence, claim.place), claim.edition)
        formula.check(scenario, claim.place)
        if claim.edition >= EDITION:
            _refuse_what_every_run_keeps(formula, claim.place)
        return formula
    examples = [entry.example for entry in CATALOGUE]
    expected = 'a claim of the catalogue, or a formula such as "always hand distance > 50 mm"'
    hint = near_miss(claim.sentence, examples, most=3, all_of_them=ALL_CLAIMS)
    raise InadmissibleError(place=claim.place, expected=expected, got=repr(claim.sentence), hint=hint)


def _refuse_more_than_a_step(claim: Property, scenario: Scenario, place: Place) -> None:
    """InadmissibleError for a tolerance that a step of the avoider, wherever it leads, does not exceed."""
    step_m = scenario.settings.avoidance.radius_m
    if not re.match("proposals|repulsion", claim.sentence):
        return
    for name, most_m in (("tolerance_m", step_m), ("within_m", 2 * step_m), ("allowance_m", 2 * step_m)):
        if getattr(claim, name, 0.0) >= most_m:
            expected = f"less than {most_m * 1e3:g} mm, as far as a step of {step_m * 1e3:g} mm can be off"
            raise InadmissibleError(place=place, expected=expected, got=claim.sentence)


def _refuse_what_every_run_keeps(claim: FormulaClaim, place: Place) -> None:
    """FormulaError for a part that asks a value which is never negative to stay above zero, or at it."""
    for part in parts_of(claim.formula):
        one = part.body if isinstance(part, Always) else None
        if isinstance(one, Comparison) and one.limit.value == one.signal.limits[0] == 0.0:
            hands = one.signal in (nearest_hand_to_tcp, predicted_hand_distance)
            if one.relation is Relation.AT_LEAST or (hands and one.relation is Relation.ABOVE):
                expected = f"a limit that {one.signal.words} can fall below"
                raise FormulaError(place=place, expected=expected, got=f"{one}, which every run keeps")
