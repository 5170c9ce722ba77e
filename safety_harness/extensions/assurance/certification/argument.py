"""The assurance argument in goal structuring notation, by hazard, made from the evidence.

The top goal is argued by hazard, claim and stratum, and by the stages of AMLAS where a part is learned.
Goals are what should be true, strategies how a goal is broken down, solutions the evidence it rests on;
contexts, assumptions and justifications stand beside.  Defeaters are what would undermine the top goal, each
with what was done about it (counter goals and counter solutions of the notation's dialectic extension).  A
goal without support is undeveloped and is drawn so.  The words are the evidence's own: an argument whose
evidence fails shows it.  What an author adds (``notes``) stands beside, and changes no state.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum

from safety_harness.extensions.assurance.certification.evidence import (
    SEVERITY,
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    HazardEvidence,
    by_gravity,
)
from safety_harness.extensions.assurance.certification.system import DATA, LEARNING
from safety_harness.extensions.assurance.certification.verdicts import at_most, gravest, hourly, percent
from safety_harness.report.words import count_words

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
MOST_STRATA = 4  # of a claim, the gravest first; the rest in one element


class ElementKind(Enum):
    """The elements of the notation; the value is the letter of its keys."""

    GOAL = "G"
    STRATEGY = "S"
    SOLUTION = "Sn"
    CONTEXT = "C"
    ASSUMPTION = "A"
    JUSTIFICATION = "J"
    DEFEATER = "CG"
    ANSWER = "CSn"


@dataclass(frozen=True)
class Element:
    """One element: ``place`` is the id on the page that it leads to, ``state`` the colour of what it says.

    ``below`` supports it, or challenges it if it is a defeater or an answer; ``beside`` is what it is to be
    read in.  ``key`` has its kind and number; ``name``, which outlives a run, is what a note is on.
    """

    kind: ElementKind
    text: str
    place: str
    state: str = OPEN
    below: tuple[Element, ...] = ()
    beside: tuple[Element, ...] = ()
    key: str = ""
    name: str = ""

    @property
    def undeveloped(self) -> bool:
        """A goal, strategy or defeater of which nothing is said."""
        return self.kind in UNDEVELOPED and not self.below

    def every(self) -> Iterator[Element]:
        """It, what stands beside it, and all below."""
        yield self
        yield from self.beside
        for one in self.below:
            yield from one.every()


UNDEVELOPED = {
    ElementKind.GOAL: "undeveloped: nothing supports it",
    ElementKind.STRATEGY: "undeveloped: nothing supports it",
    ElementKind.DEFEATER: "nothing was done about it",
}


def argument_of(evidence: Evidence) -> Element:
    """The whole argument; its leaves lead to the parts of the page that hold their evidence."""
    plan, system = evidence.plan, evidence.system
    domain = "Domain: " + ", ".join(one.name for one in evidence.strata)
    sure = f"{percent(plan.confidence)} for all {plan.bounds} bounds together, {plan.world}"
    by_hazard = Element(
        ElementKind.STRATEGY,
        "By hazard, claim and stratum, with exact bounds from independent runs",
        "results",
        beside=(Element(ElementKind.CONTEXT, sure, "plan"),),
        below=tuple(_hazards(evidence)),
        name="by hazard",
    )
    known = evidence.learned
    stages = tuple(_stages(evidence)) if system.card or evidence.proven or (known and known.networks) else ()
    by_stage = Element(
        ElementKind.STRATEGY,
        "By the stages of AMLAS, for the learned part",
        "system",
        below=stages,
        name="AMLAS",
    )
    if known and known.networks and not known.strata:  # a controller, which answers no avoider's questions
        by_stage = Element(ElementKind.GOAL, NOT_SUPERVISED, "learned", OPEN, name="AMLAS")
    top = Element(
        ElementKind.GOAL,
        f"{system.tested} keeps the plan's claims in the declared domain, as often as it asks"
        + (f"; {evidence.fallback}" if evidence.fallback else ""),
        "claims",
        STATE[evidence.standing],
        below=(by_hazard, *([by_stage] if stages else ()), *_defeaters(evidence)),
        beside=(
            Element(ElementKind.CONTEXT, domain, "strata"),
            Element(ElementKind.CONTEXT, f"System: {system.tested} on {system.robot}", "system"),
            Element(
                ElementKind.ASSUMPTION, "Hands, braking and arm are as the assumptions say", "assumptions"
            ),
        ),
        name="top",
    )
    return _numbered(_noted(top, {one.element: one.text for one in evidence.notes}), Counter())


def _noted(element: Element, notes: dict[str, str]) -> Element:
    """With the author's notes as justifications beside."""
    text = notes.get(element.name, "") if element.name else ""
    note = (Element(ElementKind.JUSTIFICATION, f"The author: {text}", element.place),) if text else ()
    below = tuple(_noted(one, notes) for one in element.below)
    return replace(element, beside=element.beside + note, below=below)


def _numbered(element: Element, counts: Counter[ElementKind]) -> Element:
    """With keys, counted by kind: what stands beside an element before what stands below it."""
    counts[element.kind] += 1
    key = f"{element.kind.value}{counts[element.kind]}"
    beside = tuple(_numbered(one, counts) for one in element.beside)
    return replace(
        element, key=key, beside=beside, below=tuple(_numbered(one, counts) for one in element.below)
    )


def _hazards(evidence: Evidence) -> Iterator[Element]:
    """A goal for each hazard of the plan, then one for the words of each claim that names none."""
    for hazard in evidence.hazards:
        claims = [one for one in evidence.claims if one.number in hazard.claims]
        yield _hazard(hazard, claims, rated=bool(hazard.met) and not evidence.plan.model_only)
    named = {number for hazard in evidence.hazards for number in hazard.claims}
    others = [one for one in by_gravity(evidence.claims) if one.number not in named]
    for words in dict.fromkeys(one.hazard for one in others):
        claims = [one for one in others if one.hazard == words]
        below = tuple(_claim(one, ()) for one in claims)
        state = STATE[gravest(one.standing for one in claims)]
        text = f"Kept rare: {words}"
        yield Element(ElementKind.GOAL, text, "hazards", state, below, name=f"hazard: {words}")


def _hazard(hazard: HazardEvidence, claims: list[ClaimEvidence], *, rated: bool) -> Element:
    """``rated``: are its rates shown, and not of a model alone?"""
    asked = "" if hazard.asked_an_hour is None else f", at most {hazard.asked_an_hour:g} an hour"
    rates = {
        one.claim: Element(
            ElementKind.SOLUTION, f"At most {hourly(one.an_hour)} an hour", "rates", DONE if rated else DOUBT
        )
        for one in hazard.rates
    }
    beside = [
        Element(ElementKind.CONTEXT, f"{hazard.task}; {hazard.zone}; {hazard.body_region}", "rates"),
        Element(
            ElementKind.JUSTIFICATION,
            f"{''.join(hazard.steps[-1:])}; decided by {hazard.decided_by}",
            "rates",
        ),
    ]
    if hazard.approaches:
        beside.append(Element(ElementKind.ASSUMPTION, f"Approaches: {hazard.approaches}", "rates"))
    state = STATE[gravest(one.standing for one in claims)]
    return Element(
        ElementKind.GOAL,
        f"Kept rare: {hazard.name}{asked} ({hazard.event})",
        "rates",
        DOUBT if state == DONE and not rated else state,
        tuple(_claim(one, (rates[one.number],) if one.number in rates else ()) for one in by_gravity(claims)),
        tuple(beside),
        name=f"hazard: {hazard.name}",
    )


def _claim(claim: ClaimEvidence, rates: tuple[Element, ...]) -> Element:
    place, state = f"claim-{claim.number}", STATE[claim.standing]
    target = "" if claim.target is None else f", violated in at most {percent(claim.target)}"
    tested = sorted(
        (one for one in claim.outcomes if one.tested), key=lambda one: -SEVERITY.index(one.standing)
    )
    many = tested if len(tested) <= MOST_STRATA else tested[: MOST_STRATA - 1]
    strata = [_stratum(one, place) for one in many]
    if rest := tested[len(many) :]:
        words = f"{len(rest)} more strata: {rest[0].standing.value} at worst"
        strata.append(Element(ElementKind.SOLUTION, words, place, STATE[rest[0].standing]))
    untested = [one.stratum for one in claim.outcomes if not one.tested]
    if strata and untested:  # a goal of its own, which nothing supports
        words = f"{', '.join(untested)}: never put to the test"
        strata.append(Element(ElementKind.GOAL, words, place, STATE[ClaimStatus.UNTESTED]))
    below = (*strata, *rates) if strata else ()
    return Element(
        ElementKind.GOAL, f"{claim.sentence}{target}", place, state, below, name=f"claim: {claim.sentence}"
    )


def _stratum(one: ClaimResult, place: str) -> Element:
    bound = "" if one.bound is None else f", at most {at_most(one.bound.upper)}"
    words = (
        f"{one.stratum}: {one.violated} of {one.tested} tested runs violate it{bound}: {one.standing.value}"
    )
    return Element(ElementKind.SOLUTION, words, place, STATE[one.standing])


NOT_SUPERVISED = (
    "Not applicable, and open: AMLAS covers offline supervised learning. A policy that was learned by "
    "reinforcement is argued by AMLAS-RL (arXiv 2507.08848), which this report does not do"
)


def _stages(evidence: Evidence) -> Iterator[Element]:
    """AMLAS's six stages, each with what this report has of it."""
    card, claims, proven = dict(evidence.system.card), evidence.claims, evidence.proven
    asked = sum(one.target is not None for one in claims)
    risks = f"{len(evidence.hazards)} hazards; {asked} of {len(claims)} claims have a target"
    runs = f"{sum(one.made for one in evidence.strata)} declared runs"
    hashes = [value for name, value in evidence.system.facts if "sha256" in value and name == "Avoider"]

    life = dict(evidence.learned.life) if evidence.learned else {}
    told = [(f"{name}: {text}", "learned", OPEN) for name, text in life.items() if name.endswith("trained")]

    def carded(*begin: str) -> Solutions:
        return [(f"{name}: {text}", "system", OPEN) for name, text in card.items() if name.startswith(begin)]

    stages: tuple[tuple[str, Solutions], ...] = (
        ("scoping: where the learned part answers is stated", [("The strata of the plan", "strata", OPEN)]),
        (
            "safety requirements: what is asked of it follows from the system's risk",
            [(risks, "rates", OPEN)] if evidence.hazards else [],
        ),
        ("data: what it learned from is known", carded(DATA, "Seen hands") + told),
        ("learning: how it was made can be repeated", carded(LEARNING)),
        (
            "verification: it does what is asked",
            [
                (runs, "results", STATE[evidence.standing]),
                *([(f"{len(proven.claims)} claims about every question", "proven", OPEN)] if proven else []),
            ],
        ),
        (
            "deployment: what was verified answers in the cell, and its service is watched",
            list(_deployment(evidence)) if evidence.learned else [],
        ),
    )
    for number, (text, solutions) in enumerate(stages, start=1):
        below = tuple(Element(ElementKind.SOLUTION, *one) for one in solutions)
        if number == len(stages) and below:
            below += (Element(ElementKind.GOAL, IN_THE_CELL, "learned", name="AMLAS stage 6, in the cell"),)
        frozen = tuple(Element(ElementKind.CONTEXT, one, "system") for one in hashes if number == 4)
        name = f"AMLAS stage {number}"
        yield Element(ElementKind.GOAL, f"Stage {number}, {text}", "system", OPEN, below, frozen, name=name)


IN_THE_CELL = (
    "Not covered here: the cell's controller loads this very file, somebody reads the monitor and acts, and "
    "nobody trains it on"
)


def _deployment(evidence: Evidence) -> Answers:
    """What the project has of it: how another network is noticed, and what a cell's logs came to."""
    yield "Frozen and known by its hash: another network takes another report", "learned", OPEN
    for part in evidence.system.under_test:
        if part.gate is not None and "question" in part.gate.name:
            yield f"The gate takes no answer to other questions: {part.gate.name}", "system", OPEN
    cells = [
        (f"Came back: {one[0]}", *one[1:]) for one in _credibility(evidence) if one[1] == "recorded-cells"
    ]
    yield from cells or [("No log of a cell came back: judge, monitor, certify --cell", "learned", DOUBT)]


Solutions = list[tuple[str, str, str]]  # text, place, state
Answers = Iterator[tuple[str, str, str]]  # text, place, state


def _hunt(evidence: Evidence) -> Answers:
    if evidence.search is not None:
        distinct = len(evidence.counterexamples)
        found = sum(not one.independent for one in evidence.counterexamples)
        words = f"Search of {evidence.search.runs} runs; {found} distinct counterexamples of it, and "
        yield f"{words}{distinct - found} of declared runs", "counterexamples", DOUBT if distinct else OPEN


def _domain(evidence: Evidence) -> Answers:
    if evidence.coverage.runs:
        words = f"Coverage: {len(evidence.coverage.cells)} cells in {evidence.coverage.runs} runs"
        yield words, "coverage", OPEN


def _credibility(evidence: Evidence) -> Answers:
    known = evidence.credibility
    if (agreement := known.agreement) is not None:
        state = DOUBT if agreement.optimistic or not agreement.present else DONE
        yield (
            f"Two worlds: {agreement.disagreements} of {agreement.verdicts} verdicts differ",
            "agreement",
            state,
        )
    for rerun in known.reruns:
        words = f"{rerun.title}: {rerun.changed} of {rerun.verdicts} verdicts change"
        yield words, rerun.place, DOUBT if rerun.changed else DONE
    for cell in known.cells:
        fine = cell.decided and not cell.differing and cell.present
        fine = fine and not cell.foreign_to(evidence.system.under_test)
        words = f"A recorded cell: {cell.differing} of {cell.decided} verdicts differ"
        yield words, "recorded-cells", DONE if fine else DOUBT
    if known.oracles:
        yield f"{len(known.oracles)} parts against other software", "oracles", OPEN


def _tools(evidence: Evidence) -> Answers:
    test = evidence.selftest
    if test is not None:
        every = 0 < len(test.faults) == test.caught and test.whole
        words = f"Seeded faults: {test.caught} of {len(test.faults)} caught"
        words += "" if test.whole else ", not all tried"
        yield words, "tools", DONE if every and not test.false_alarms and test.present else DOUBT


def _declared(evidence: Evidence) -> Answers:
    if digest := evidence.record.declaration_sha256:
        yield f"Declared as {digest[:12]}, if that was lodged before the runs", "plan", OPEN


def _calibration(evidence: Evidence) -> Answers:
    for one in evidence.calibration:
        decisions = count_words(one.decisions, "decision", "decisions")
        yield f"{one.stratum}: {decisions}, calibration {one.decided}", "calibration", one.decided


def _altered(evidence: Evidence) -> Answers:
    yield f"Root over all rows {evidence.record.rows_sha256[:12]}, to be sealed elsewhere", "provenance", OPEN


DEFEATERS: tuple[tuple[str, str, str, Callable[[Evidence], Answers]], ...] = (
    ("simulator", "The simulator is not the cell", "credibility", _credibility),
    ("domain", "The cell leaves the strata", "coverage", _domain),
    ("unmet", "Violations are left that no run met", "counterexamples", _hunt),
    ("judges", "The judges overlook a fault", "tools", _tools),
    ("certain", "The avoider is sure where it is wrong", "calibration", _calibration),
    ("fitted", "The plan was chosen after its runs", "plan", _declared),
    ("altered", "Rows were altered afterwards", "provenance", _altered),
)


def _defeaters(evidence: Evidence) -> Iterator[Element]:
    """What would undermine the top goal: green where all answers are, and no finding is open."""
    for name, text, place, known in DEFEATERS:
        if name == "certain" and not evidence.system.asks:
            continue
        answers = tuple(Element(ElementKind.ANSWER, *one) for one in known(evidence))
        places = {place, *(one.place for one in answers)} | ({"strata"} if name == "domain" else set())
        findings = sum(one.place in places for one in evidence.findings)
        states = {one.state for one in answers}
        state = DONE if states == {DONE} and not findings else DOUBT
        words = f"{text}: {count_words(findings, 'open finding', 'open findings')}" if findings else text
        yield Element(ElementKind.DEFEATER, words, place, state, answers, name=f"defeater: {name}")
