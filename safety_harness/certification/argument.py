"""The assurance argument in goal structuring notation, made from the evidence: what is claimed, on what.

Goals are what should be true, strategies how a goal is broken down, solutions the evidence it rests on;
contexts and assumptions stand beside.  A goal without a solution is undeveloped and is drawn so.  The words
on goals are the evidence's own: an argument whose evidence fails shows it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

from safety_harness.certification.evidence import ClaimStatus, Evidence
from safety_harness.certification.verdicts import percent

DONE, DOUBT, FAILS, OPEN = "holds", "inconclusive", "violated", "none"
STATE = {
    ClaimStatus.SHOWN: DONE,
    ClaimStatus.DOUBTED: DOUBT,
    ClaimStatus.NOT_SHOWN: DOUBT,
    ClaimStatus.INCOMPLETE: DOUBT,
    ClaimStatus.UNTESTED: FAILS,
    ClaimStatus.REFUTED: FAILS,
    ClaimStatus.ESTIMATED: OPEN,
}


class ElementKind(Enum):
    """The elements of the notation; the value is the letter of its keys."""

    GOAL = "G"
    STRATEGY = "S"
    SOLUTION = "Sn"
    CONTEXT = "C"
    ASSUMPTION = "A"


KIND_WORDS = {kind: kind.name.lower() for kind in ElementKind}


@dataclass(frozen=True, kw_only=True)
class Element:
    """One element: ``place`` is the id on the page that it leads to, ``state`` the colour of what it says.

    ``below`` supports it, ``beside`` is what it is to be read in.
    """

    kind: ElementKind
    key: str
    text: str
    place: str
    state: str = OPEN
    below: tuple[Element, ...] = ()
    beside: tuple[Element, ...] = ()

    @property
    def undeveloped(self) -> bool:
        """A goal or strategy that nothing supports."""
        return self.kind in (ElementKind.GOAL, ElementKind.STRATEGY) and not self.below


@dataclass
class _Maker:
    """Makes elements, numbered by kind in the order of making."""

    counts: dict[ElementKind, int] = field(default_factory=dict)

    def __call__(
        self, kind: ElementKind, text: str, place: str, state: str = OPEN, *, beside: tuple[Element, ...] = ()
    ) -> Element:
        self.counts[kind] = self.counts.get(kind, 0) + 1
        key = f"{kind.value}{self.counts[kind]}"
        return Element(kind=kind, key=key, text=text, place=place, state=state, beside=beside)


def argument_of(evidence: Evidence) -> Element:
    """The whole argument; its leaves lead to the parts of the page that hold their evidence."""
    make, plan = _Maker(), evidence.plan
    sure = f"{percent(plan.confidence)} for all {plan.bounds} bounds together, {plan.world}"
    top = make(
        ElementKind.GOAL,
        f"{evidence.system.avoider} keeps the plan's claims in the declared domain, as often as it asks"
        + (f"; {evidence.fallback}" if evidence.fallback else ""),
        "claims",
        STATE[evidence.standing],
        beside=(
            make(ElementKind.CONTEXT, "Domain: " + ", ".join(one.name for one in evidence.strata), "strata"),
            make(
                ElementKind.CONTEXT, f"System: {evidence.system.avoider} on {evidence.system.robot}", "system"
            ),
            make(ElementKind.ASSUMPTION, "Hands, braking and arm are as the assumptions say", "assumptions"),
        ),
    )
    by_claims = make(
        ElementKind.STRATEGY,
        "By claim and stratum, with exact bounds from independent runs",
        "results",
        beside=(make(ElementKind.CONTEXT, sure, "plan"),),
    )
    goals = []
    for claim in evidence.claims:
        place, state = f"claim-{claim.number}", STATE[claim.standing]
        target = "" if claim.target is None else f", violated in at most {percent(claim.target)}"
        goal = make(ElementKind.GOAL, f"{claim.sentence}{target}", place, state)
        runs = sum(outcome.tested for outcome in claim.outcomes)
        if runs:
            words = f"{runs} runs put it to the test: {claim.standing.value}"
            goal = replace(goal, below=(make(ElementKind.SOLUTION, words, place, state),))
        goals.append(goal)
    means = (
        ("Ways to violate a claim are known and explained", "counterexamples", DOUBT, _hunt),
        ("The simulator may be believed for these claims", "credibility", OPEN, _credibility),
        ("What judges would notice a fault", "tools", OPEN, _tools),
    )
    others = tuple(
        replace(make(ElementKind.GOAL, text, place, state), below=support(evidence, make))
        for text, place, state, support in means
    )
    by_means = make(ElementKind.STRATEGY, "By what could make the bounds misleading", "not-shown")
    by_claims = replace(by_claims, below=tuple(goals))
    return replace(top, below=(by_claims, replace(by_means, below=others)))


def _hunt(evidence: Evidence, make: _Maker) -> tuple[Element, ...]:
    found = []
    if evidence.search is not None:
        state = DOUBT if evidence.counterexamples else OPEN
        distinct = len(evidence.counterexamples)
        words = f"Search of {evidence.search.runs} runs; {distinct} distinct counterexamples in all"
        found.append(make(ElementKind.SOLUTION, words, "counterexamples", state))
    if evidence.coverage.runs:
        words = f"Coverage: {len(evidence.coverage.cells)} cells in {evidence.coverage.runs} runs"
        found.append(make(ElementKind.SOLUTION, words, "coverage"))
    return tuple(found)


def _credibility(evidence: Evidence, make: _Maker) -> tuple[Element, ...]:
    known, found = evidence.credibility, []
    if known.agreement is not None:
        agreement = known.agreement
        state = DOUBT if agreement.optimistic or not agreement.present else DONE
        words = f"Two worlds: {agreement.disagreements} of {agreement.verdicts} verdicts differ"
        found.append(make(ElementKind.SOLUTION, words, "agreement", state))
    for rerun in known.reruns:
        words = f"{rerun.title}: {rerun.changed} of {rerun.verdicts} verdicts change"
        found.append(make(ElementKind.SOLUTION, words, rerun.place, DOUBT if rerun.changed else DONE))
    if known.oracles:
        found.append(
            make(ElementKind.SOLUTION, f"{len(known.oracles)} parts against other software", "oracles")
        )
    return tuple(found)


def _tools(evidence: Evidence, make: _Maker) -> tuple[Element, ...]:
    test = evidence.selftest
    if test is None:
        return ()
    every = 0 < len(test.faults) == test.caught and test.whole
    words = f"Seeded faults: {test.caught} of {len(test.faults)} caught"
    words += "" if test.whole else ", not all tried"
    fine = every and not test.false_alarms and test.present
    return (make(ElementKind.SOLUTION, words, "tools", DONE if fine else DOUBT),)
