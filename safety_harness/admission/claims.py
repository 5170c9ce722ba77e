"""Resolve a claim's sentence to its property, which is an entry of the catalogue or a formula."""

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
    """Return the property of a claim.

    Args:
        claim: The claim.
        scenario: The scenario that contains the claim.

    Raises:
        FormulaError: A formula is malformed, or does not fit into the scenario.
        InadmissibleError: The sentence is unknown, and the hint lists the catalogue.  The error may also mean
            that the claim's bound has a wrong unit.

    """
    claimed = _property_of(claim, scenario)
    if claim.most is not None and (claim.most[1] or "1") != SI_UNITS[claimed.unit]:
        expected = f"{claim.expected.value}{BY_AT_MOST}a margin in {claimed.unit.symbol or 'whole numbers'}"
        raise InadmissibleError(place=claim.place, expected=expected, got=claim.expectation)
    return claimed


def _property_of(claim: Claim, scenario: Scenario) -> Property:
    """Return the property of a claim, without checking the unit of the claim's bound."""
    meant = entry_claimed(claim.sentence)
    if meant is not None:
        entry, match = meant
        claimed = entry.property_of(match, scenario, claim.place)
        if claim.edition < EDITION and isinstance(claimed, ProtectiveSeparation):
            default_mps = WALKING_MPS if claim.edition < 2 else claimed.default_mps
            return replace(claimed, default_mps=default_mps, tcp_alone=True)
        if claim.edition >= EDITION:
            _refuse_more_than_a_step(claimed, scenario, claim.place)
        return claimed
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


def meaning_of(claimed: Property) -> str:
    """Return a text that is equal for all spellings of a claim.

    For example, "hand distance never below 50 mm", "hand distance > 5 cm" and "always hand distance >= 50 mm"
    are one claim, because a margin of zero violates none of them.
    """
    meant = entry_claimed(claimed.sentence)
    if isinstance(claimed, FormulaClaim):
        formula = claimed.formula
    elif meant is not None and meant[0].formula:
        formula = parse_formula(meant[0].formula.format(meant[1][1]))
    else:
        return claimed.sentence
    match parts_of(formula):
        case (Always(body=Comparison() as bound, span=None),):
            below = bound.relation in (Relation.BELOW, Relation.AT_MOST)
            return f"{bound.signal.words} {'<' if below else '>'} {bound.limit.value!r}"
    return str(formula)


def _refuse_more_than_a_step(claim: Property, scenario: Scenario, place: Place) -> None:
    """Raise InadmissibleError if the claim's tolerance is too large.

    It must be below the largest possible error of an avoider's step, so that a step can violate the claim.
    """
    step_m = scenario.settings.avoidance.radius_m
    if not re.match("proposals|repulsion", claim.sentence):
        return
    for name, most_m in (("tolerance_m", step_m), ("within_m", 2 * step_m), ("allowance_m", 2 * step_m)):
        if getattr(claim, name, 0.0) >= most_m:
            expected = f"less than {most_m * 1e3:g} mm, the largest error of a step of {step_m * 1e3:g} mm"
            raise InadmissibleError(place=place, expected=expected, got=claim.sentence)


def _refuse_what_every_run_keeps(claim: FormulaClaim, place: Place) -> None:
    """Raise FormulaError if every run fulfils a part of the formula.

    Such a part only requires that a value is at least zero, although the value can never be negative.
    """
    for part in parts_of(claim.formula):
        bound = part.body if isinstance(part, Always) else None
        if isinstance(bound, Comparison) and bound.limit.value == bound.signal.limits[0] == 0.0:
            hands = bound.signal in (nearest_hand_to_tcp, predicted_hand_distance)
            if bound.relation is Relation.AT_LEAST or (hands and bound.relation is Relation.ABOVE):
                expected = f"a limit that {bound.signal.words} can fall below"
                raise FormulaError(place=place, expected=expected, got=f"{bound}, which every run keeps")
