"""The open findings of a report, which are derived from its other parts.

An assessor must look at each finding.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.overruled import overruling_in
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

SHOWS_GATE = "the runs show more of the gate and its fallback than of the avoider"
_PLAIN = {
    ClaimStatus.REFUTED: "is refuted",
    ClaimStatus.UNTESTED: "was never put to the test",
    ClaimStatus.INCOMPLETE: "has runs missing",
    ClaimStatus.NOT_SHOWN: "is not shown",
    ClaimStatus.DOUBTED: "is shown with doubt only",
    ClaimStatus.ESTIMATED: "is estimated only",
}

MOST_NAMED = 3  # files in a sentence


def findings_of(
    evidence: Evidence,
    ledger: Ledger,
    met: Sequence[Example | str],
    searches: Sequence[Searched],
    of_stored: Iterable[str],
) -> Iterator[OpenFinding]:
    """Yield all findings of a report.

    Args:
        evidence: The evidence without its findings.
        ledger: The ledger of the runs.
        met: The counterexamples, or the reasons why the page cannot show them.
        searches: The searches of the strata.
        of_stored: Findings on unreadable traces, on parts that no run tried, and on limited commands.

    """
    if not evidence.record.declaration_sha256:
        yield OpenFinding("nothing proves that the plan was declared before its runs were made", "plan")
    elif uncovered := undeclared(ledger):
        yield OpenFinding(uncovered, "plan")
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
    names = {element.name for element in argument_of(evidence).every()}
    for note in evidence.notes:
        if note.element not in names:
            yield OpenFinding(f"the author's note on {note.element!r} is on no element any more", "argument")


def undeclared(ledger: Ledger) -> str:
    """Return a sentence on files that users' modules opened and that no declaration covers, such as weights.

    ``certify declare`` executes no program, so it cannot know these files. The sentence is empty if there are
    none.
    """
    declared_parts = dict(ledger.declared.identity.parts)
    # A file without a hash was absent, or a program wrote it itself.
    hashed = [name for name, sha256 in ledger.opened.items() if sha256]
    names = [name for name in hashed if f"the file {name}" not in declared_parts]
    if not names:
        return ""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    listed = ", ".join(names[:MOST_NAMED]) + more
    return f"the declaration does not cover {listed}, which a program opened: it may have changed since"


def of_claims(claims: Sequence[ClaimEvidence]) -> Iterator[OpenFinding]:
    """Yield a finding for every claim that does not have the status SHOWN."""
    for claim in claims:
        if claim.standing in _PLAIN:
            text = f"{claim.sentence} {_PLAIN[claim.standing]}: {claim.why}"
            if claim.standing is ClaimStatus.UNTESTED and claim.exercised_when:
                text += f"; exercised when: {claim.exercised_when}"
            yield OpenFinding(text, f"claim-{claim.number}")


def of_hazards(hazards: Sequence[HazardEvidence], *, model_only: bool) -> Iterator[OpenFinding]:
    """Yield a finding for each hazard that has no claim or no required rate, or whose rate is too high.

    ``model_only`` is true if the world is not validated. In such a world, no rate meets the required rate.
    """
    for hazard in hazards:
        if not hazard.claims:
            yield OpenFinding(f"{hazard.name}: no claim stands under this hazard", "rates")
        elif hazard.level is None:
            yield OpenFinding(f"{hazard.name}: {hazard.steps[-1]}", "rates")
        elif hazard.met is not True or model_only:
            where = ", but of the model alone" if hazard.met else ""
            where += "" if hazard.approaches else ": nobody said how often people come near (approaches)"
            missed = f"at most {hazard.asked_an_hour:g} an hour (level {hazard.level}) is not shown{where}"
            yield OpenFinding(f"{hazard.name}: {missed}", "rates")


def of_strata(ledger: Ledger, strata: Sequence[StratumResult]) -> Iterator[OpenFinding]:
    """Yield findings on each stratum with failed runs, unanswered queries or mostly overruled proposals."""
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
        if fallback.summary:
            text = f"{stratum.name}: {fallback.summary}; most often: {fallback.reason}"
            yield OpenFinding(text, "strata")
        overruled = overruling_in(ledger, place)
        if 2 * overruled.overruled > overruled.proposals:
            yield OpenFinding(f"{stratum.name}: {overruled.summary}: {SHOWS_GATE}", "strata")


def of_searches(searches: Sequence[Searched], planned: int) -> Iterator[OpenFinding]:
    """Yield a finding for each search that is missing, interrupted or unconfirmed.

    ``planned`` is the number of search runs in the plan.
    """
    texts = [] if searches or not planned else ["the search that the plan asks for was not made"]
    for search in searches:
        if search.found is None:
            texts.append(f"{search.stratum}: the search {search.problem}")
            continue
        if search.found.interrupted:
            texts.append(f"{search.stratum}: the search was interrupted")
        if search.found.counterexamples and not search.found.confirmed:
            texts.append(f"{search.stratum}: without PyBullet, no counterexample was confirmed")
        if many := len(search.found.unconfirmed):
            texts.append(f"{search.stratum}: {many} findings of the search were not confirmed in PyBullet")
    yield from (OpenFinding(text, "counterexamples") for text in texts)


def of_examples(examples: Sequence[Example | str]) -> Iterator[OpenFinding]:
    """Yield findings on ``examples`` that the page cannot show, and on ``examples`` that the search found."""
    shown = [item.shown for item in examples if isinstance(item, Example)]
    problems = [item for item in examples if isinstance(item, str)]
    texts = []
    if untraced := problems.count(""):
        texts.append(
            f"{untraced} kinds of violation have no kept trace, and are counted only: keep more violations"
        )
    texts += filter(None, problems)
    if searched := sum(not item.independent for item in shown):
        texts.append(f"the search found {searched} counterexamples that the declared runs are no measure of")
    if len(shown) > MOST:
        texts.append(f"{len(shown) - MOST} of {len(shown)} counterexamples have files but no pictures here")
    yield from (OpenFinding(text, "counterexamples") for text in texts)


def of_worlds(credibility: Credibility, tested: Sequence[SystemUnderTest]) -> Iterator[OpenFinding]:
    """Yield a finding for each reason to doubt the simulator.

    A recorded cell is also a reason to doubt the simulator if its system is not in ``tested``.
    """
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
    """Yield findings on the harness: a missing or partial ``selftest``, false alarms, and missed faults."""
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
