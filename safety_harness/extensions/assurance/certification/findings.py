"""What is open in a report, read off the rest of it: an assessor has to look at each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.summary import fallback_of
from safety_harness.extensions.assurance.certification.argument import argument_of
from safety_harness.extensions.assurance.certification.counterexamples import MOST, Example, Searched
from safety_harness.extensions.assurance.certification.evidence import (
    ClaimEvidence,
    ClaimStatus,
    Evidence,
    HazardEvidence,
    OpenFinding,
    StratumResult,
)
from safety_harness.extensions.assurance.certification.tools import Credibility, SelfTest
from safety_harness.trace.system import SystemUnderTest

_PLAIN = {
    ClaimStatus.REFUTED: "is refuted",
    ClaimStatus.UNTESTED: "was never put to the test",
    ClaimStatus.INCOMPLETE: "has runs missing",
    ClaimStatus.NOT_SHOWN: "is not shown",
    ClaimStatus.DOUBTED: "is shown with doubt only",
    ClaimStatus.ESTIMATED: "is estimated only",
}


def findings_of(
    evidence: Evidence,
    ledger: Ledger,
    met: Sequence[Example | str],
    searches: Sequence[Searched],
    of_stored: Iterable[str],
) -> Iterator[OpenFinding]:
    """All of them; ``of_stored`` says which stored traces cannot be read, and what they left untried."""
    if not evidence.record.declaration_sha256:
        yield OpenFinding("nothing proves that the plan was declared before its runs were made", "plan")
    yield from of_claims(evidence.claims)
    yield from of_hazards(evidence.hazards, model_only=evidence.plan.model_only)
    yield from of_strata(ledger, evidence.strata)
    yield from (OpenFinding(text, "strata") for text in ledger.slow)
    tested, strata = evidence.system, range(len(evidence.strata))
    if tested.under_test and not (tested.asks or any(ledger.times(k).answers for k in strata)):
        yield OpenFinding("how long the controller takes to answer was not measured", "strata")
    if ledger.repeated.words or not ledger.repeated.asked:
        yield OpenFinding(ledger.repeated.line, "strata")
    yield from (OpenFinding(text, "strata") for text in of_stored)
    yield from of_examples(met)
    yield from of_searches(searches, evidence.plan.search_runs)
    yield from of_worlds(evidence.credibility, evidence.system.under_test)
    yield from of_selftest(evidence.selftest)
    names = {one.name for one in argument_of(evidence).every()}
    for note in evidence.notes:
        if note.element not in names:
            yield OpenFinding(f"the author's note on {note.element!r} is on no element any more", "argument")


def of_claims(claims: Sequence[ClaimEvidence]) -> Iterator[OpenFinding]:
    """Whatever is not shown."""
    for claim in claims:
        if claim.standing in _PLAIN:
            text = f"{claim.sentence} {_PLAIN[claim.standing]}: {claim.why}"
            if claim.standing is ClaimStatus.UNTESTED and claim.exercised_when:
                text += f"; exercised when: {claim.exercised_when}"
            yield OpenFinding(text, f"claim-{claim.number}")


def of_hazards(hazards: Sequence[HazardEvidence], *, model_only: bool) -> Iterator[OpenFinding]:
    """Hazards that no claim speaks to, of which nothing is asked, or whose rate is not shown."""
    for one in hazards:
        if not one.claims:
            yield OpenFinding(f"{one.name}: no claim stands under this hazard", "rates")
        elif one.level is None:
            yield OpenFinding(f"{one.name}: {one.steps[-1]}", "rates")
        elif one.met is not True or model_only:
            where = ", but of the model alone" if one.met else ""
            where += "" if one.approaches else ": nobody said how often people come near (approaches)"
            asked = f"at most {one.asked_an_hour:g} an hour (level {one.level}) is not shown{where}"
            yield OpenFinding(f"{one.name}: {asked}", "rates")


def of_strata(ledger: Ledger, strata: Sequence[StratumResult]) -> Iterator[OpenFinding]:
    """Runs that could not be carried on, and avoiders that gave no answer."""
    for place, stratum in enumerate(strata):
        if stratum.failed:
            reasons = ledger.all(
                "SELECT failure, count(*) FROM episode WHERE stratum = ? AND failure IS NOT NULL "
                "GROUP BY failure ORDER BY 2 DESC, 1 LIMIT 1",
                place,
            )
            most = next((f", most often: {reason}" for reason, _ in reasons), "")
            text = f"{stratum.name}: {stratum.failed} of {stratum.made} runs could not be carried on{most}"
            yield OpenFinding(text, "strata")
        fallback = fallback_of(ledger, place)
        if fallback.words:
            text = f"{stratum.name}: {fallback.words}; most often: {fallback.reason}"
            yield OpenFinding(text, "strata")


def of_searches(searches: Sequence[Searched], asked: int) -> Iterator[OpenFinding]:
    """What of the search that the plan asks for is not there, and what it met that is in no bound."""
    texts = [] if searches or not asked else ["the search that the plan asks for was not made"]
    for one in searches:
        if one.found is None:
            texts.append(f"{one.stratum}: the search {one.problem}")
            continue
        if one.found.interrupted:
            texts.append(f"{one.stratum}: the search was interrupted")
        if one.found.counterexamples and not one.found.confirmed:
            texts.append(f"{one.stratum}: without PyBullet, no counterexample was confirmed")
        if many := len(one.found.unconfirmed):
            texts.append(f"{one.stratum}: {many} findings of the search were not confirmed in PyBullet")
    yield from (OpenFinding(text, "counterexamples") for text in texts)


def of_examples(examples: Sequence[Example | str]) -> Iterator[OpenFinding]:
    """What of the counterexamples cannot be shown, or is no part of a bound."""
    shown = [one.shown for one in examples if isinstance(one, Example)]
    problems = [one for one in examples if isinstance(one, str)]
    texts = []
    if untraced := problems.count(""):
        texts.append(
            f"{untraced} kinds of violation have no kept trace, and are counted only: keep more violations"
        )
    texts += filter(None, problems)
    if searched := sum(not one.independent for one in shown):
        texts.append(f"the search found {searched} counterexamples that the declared runs are no measure of")
    if len(shown) > MOST:
        texts.append(f"{len(shown) - MOST} of {len(shown)} counterexamples have files but no pictures here")
    yield from (OpenFinding(text, "counterexamples") for text in texts)


def of_worlds(credibility: Credibility, tested: Sequence[SystemUnderTest]) -> Iterator[OpenFinding]:
    """Reasons to doubt the simulator, and that recorded cells are of the ``tested`` systems."""
    agreement = credibility.agreement
    if agreement is None or not agreement.present:
        text = "the agreement of the two worlds was not measured with this source"
        yield OpenFinding(text, "credibility")
    if agreement is not None and agreement.optimistic:
        text = f"{agreement.optimistic} optimistic disagreements of the kinematic world with PyBullet"
        yield OpenFinding(text, "agreement")
    for cell in credibility.cells:
        if cell.differing:
            text = (
                f"{cell.differing} of {cell.decided} verdicts of {cell.comparison.log} differ in simulation"
            )
            yield OpenFinding(text, "recorded-cells")
        if foreign := cell.foreign_to(tested):
            text = f"{cell.comparison.log} is no cell of the tested system: {foreign}"
            yield OpenFinding(text, "recorded-cells")
        if not cell.present:
            text = f"the worlds were held against {cell.comparison.log} with another source"
            yield OpenFinding(text, "recorded-cells")
    for rerun in credibility.reruns:
        if rerun.changed:
            text = f"{rerun.title}: {rerun.changed} of {rerun.verdicts} verdicts change"
            yield OpenFinding(text, rerun.place)


def of_selftest(selftest: SelfTest | None) -> Iterator[OpenFinding]:
    """Reasons to doubt the judges."""
    if selftest is None:
        yield OpenFinding("nothing is said of how well the harness notices faults", "tools")
        return
    if not selftest.whole:
        yield OpenFinding("not every fault of the catalogue was tried on the harness", "tools")
    if not selftest.present:
        yield OpenFinding("the harness was on trial with another source", "tools")
    for alarm in selftest.false_alarms:
        yield OpenFinding(f"the harmless change {alarm!r} raised an alarm", "tools")
    for fault in selftest.faults:
        if not fault.caught_by:
            limit = f", a stated limit: {fault.known_limit}" if fault.known_limit else ""
            yield OpenFinding(f"the seeded fault {fault.name!r} survived{limit}", "tools")
