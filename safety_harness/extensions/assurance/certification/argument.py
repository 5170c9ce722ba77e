"""The assurance argument in goal structuring notation (GSN), built from the evidence.

The argument for the top goal is divided by hazard, claim and stratum. If a part of the system is learned, a
second argument follows the stages of AMLAS.

- Goals are statements that should be true. Strategies divide a goal into further goals. Solutions are the
  evidence that supports a goal.
- Contexts, assumptions and justifications stand beside an element.
- Defeaters would undermine the top goal. The answers to a defeater stand below it. In GSN's dialectic
  extension, they are counter goals and counter solutions.
- A goal without support is undeveloped, and the picture marks it.

All texts come from the evidence. Therefore the argument shows a failure if the evidence shows it. The
author's ``notes`` appear beside the elements and have no effect on the result.
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
    by_severity,
)
from safety_harness.extensions.assurance.certification.system import DATA, LEARNING
from safety_harness.extensions.assurance.certification.verdicts import at_most, hourly, percent, worst_status
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
MOST_STRATA = 4  # elements below a claim, the most severe strata first; the last sums up the rest


class ElementKind(Enum):
    """The kinds of elements in GSN.

    The value of each kind is the letter with which the key of an element begins.
    """

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
    """An element of the argument.

    ``place`` is the id on the page to which the element links. ``state`` is the colour of the element's
    statement. ``below`` has the elements that support this element. If an element in ``below`` is a defeater
    or an answer, it challenges this element instead of supporting it. ``beside`` has the context of the
    element. ``key`` consists of the element's kind and number, which may change from run to run. ``name``
    stays the same, so that notes can refer to it.
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
        """True if the element is a goal, strategy or defeater and has no element below it."""
        return self.kind in UNDEVELOPED and not self.below

    def every(self) -> Iterator[Element]:
        """Yield this element, the elements beside it, and all elements below it."""
        yield self
        yield from self.beside
        for element in self.below:
            yield from element.every()


UNDEVELOPED = {
    ElementKind.GOAL: "undeveloped: without support",
    ElementKind.STRATEGY: "undeveloped: without support",
    ElementKind.DEFEATER: "without an answer",
}


def argument_of(evidence: Evidence) -> Element:
    """Return the top goal of the whole argument.

    The leaves of the argument link to the evidence on the page.
    """
    plan, system = evidence.plan, evidence.system
    domain = "Domain: " + ", ".join(item.name for item in evidence.strata)
    sure = f"{percent(plan.confidence)} for all {plan.bounds} bounds together, {plan.world}"
    by_hazard = Element(
        ElementKind.STRATEGY,
        "Argument by hazard, claim and stratum, with exact bounds from independent runs",
        "results",
        beside=(Element(ElementKind.CONTEXT, sure, "plan"),),
        below=tuple(_hazards(evidence)),
        name="by hazard",
    )
    known = evidence.learned
    stages = tuple(_stages(evidence)) if system.card or evidence.proven or (known and known.networks) else ()
    by_stage = Element(
        ElementKind.STRATEGY,
        "Argument by the stages of AMLAS, for the learned part",
        "system",
        below=stages,
        name="AMLAS",
    )
    if known and known.networks and not known.strata:  # a controller, which answers no avoider's questions
        by_stage = Element(ElementKind.GOAL, NOT_SUPERVISED, "learned", OPEN, name="AMLAS")
    top = Element(
        ElementKind.GOAL,
        f"{system.tested} keeps the plan's claims in the declared domain, as often as it requires"
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
    return _numbered(_noted(top, {item.element: item.text for item in evidence.notes}), Counter())


def _noted(element: Element, notes: dict[str, str]) -> Element:
    """Return a copy of ``element`` and of everything below it.

    A note in ``notes`` on an element becomes a justification beside the element.
    """
    text = notes.get(element.name, "") if element.name else ""
    note = (Element(ElementKind.JUSTIFICATION, f"The author: {text}", element.place),) if text else ()
    below = tuple(_noted(child, notes) for child in element.below)
    return replace(element, beside=element.beside + note, below=below)


def _numbered(element: Element, counts: Counter[ElementKind]) -> Element:
    """Return a copy of ``element`` and of everything below it, with keys.

    Each kind of element is numbered separately. The elements beside an element are numbered before the
    elements below it.
    """
    counts[element.kind] += 1
    key = f"{element.kind.value}{counts[element.kind]}"
    beside = tuple(_numbered(child, counts) for child in element.beside)
    return replace(
        element, key=key, beside=beside, below=tuple(_numbered(child, counts) for child in element.below)
    )


def _hazards(evidence: Evidence) -> Iterator[Element]:
    """Yield a goal for each hazard of the plan.

    Group the remaining claims by the text of their hazard, and yield a goal for each group.
    """
    for hazard in evidence.hazards:
        claims = [item for item in evidence.claims if item.number in hazard.claims]
        yield _hazard(hazard, claims, rated=bool(hazard.met) and not evidence.plan.model_only)
    named = {number for hazard in evidence.hazards for number in hazard.claims}
    unnamed = [item for item in by_severity(evidence.claims) if item.number not in named]
    for hazard_text in dict.fromkeys(item.hazard for item in unnamed):
        claims = [item for item in unnamed if item.hazard == hazard_text]
        below = tuple(_claim(item, ()) for item in claims)
        state = STATE[worst_status(item.standing for item in claims)]
        text = f"Kept rare: {hazard_text}"
        yield Element(ElementKind.GOAL, text, "hazards", state, below, name=f"hazard: {hazard_text}")


def _hazard(hazard: HazardEvidence, claims: list[ClaimEvidence], *, rated: bool) -> Element:
    """Return the goal for ``hazard``. Below this goal are the goals for its ``claims``.

    ``rated`` is true if the hazard's rates meet the limit in a world that is not simplified.
    """
    limit = "" if hazard.asked_an_hour is None else f", at most {hazard.asked_an_hour:g} an hour"
    rates = {
        row.claim: Element(
            ElementKind.SOLUTION, f"At most {hourly(row.an_hour)} an hour", "rates", DONE if rated else DOUBT
        )
        for row in hazard.rates
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
    state = STATE[worst_status(row.standing for row in claims)]
    return Element(
        ElementKind.GOAL,
        f"Kept rare: {hazard.name}{limit} ({hazard.event})",
        "rates",
        DOUBT if state == DONE and not rated else state,
        tuple(
            _claim(row, (rates[row.number],) if row.number in rates else ()) for row in by_severity(claims)
        ),
        tuple(beside),
        name=f"hazard: {hazard.name}",
    )


def _claim(claim: ClaimEvidence, rates: tuple[Element, ...]) -> Element:
    """Return the goal for ``claim``.

    The goal is supported by a solution for each stratum and by the solutions ``rates``. The stratum with the
    most severe status comes first.
    """
    place, state = f"claim-{claim.number}", STATE[claim.standing]
    target = "" if claim.target is None else f", violated in at most {percent(claim.target)}"
    tested = sorted(
        (row for row in claim.outcomes if row.tested), key=lambda row: -SEVERITY.index(row.standing)
    )
    # One place stays for the element that sums up the rest.
    many = tested if len(tested) <= MOST_STRATA else tested[: MOST_STRATA - 1]
    strata = [_stratum(row, place) for row in many]
    if rest := tested[len(many) :]:
        label = f"{len(rest)} more strata: {rest[0].standing.value} at worst"
        strata.append(Element(ElementKind.SOLUTION, label, place, STATE[rest[0].standing]))
    untested = [row.stratum for row in claim.outcomes if not row.tested]
    if strata and untested:  # a separate goal, which no element supports
        label = f"{', '.join(untested)}: never put to the test"
        strata.append(Element(ElementKind.GOAL, label, place, STATE[ClaimStatus.UNTESTED]))
    below = (*strata, *rates) if strata else ()
    return Element(
        ElementKind.GOAL, f"{claim.sentence}{target}", place, state, below, name=f"claim: {claim.sentence}"
    )


def _stratum(row: ClaimResult, place: str) -> Element:
    """Return the solution that states the result of a claim in one stratum."""
    bound = "" if row.bound is None else f", at most {at_most(row.bound.upper)}"
    text = (
        f"{row.stratum}: {row.violated} of {row.tested} tested runs violate it{bound}: {row.standing.value}"
    )
    return Element(ElementKind.SOLUTION, text, place, STATE[row.standing])


NOT_SUPERVISED = (
    "Not applicable, and open: AMLAS covers offline supervised learning. AMLAS-RL (arXiv 2507.08848) covers "
    "policies learned by reinforcement; this report does not apply it"
)


def _stages(evidence: Evidence) -> Iterator[Element]:
    """Yield the six stages of AMLAS, each with the evidence that this report has for the stage."""
    card, claims, proven = dict(evidence.system.card), evidence.claims, evidence.proven
    targets = sum(item.target is not None for item in claims)
    risks = f"{len(evidence.hazards)} hazards; {targets} of {len(claims)} claims have a target"
    runs = f"{sum(item.made for item in evidence.strata)} declared runs"
    hashes = [value for name, value in evidence.system.facts if "sha256" in value and name == "Avoider"]

    life = dict(evidence.learned.life) if evidence.learned else {}
    stated = [(f"{name}: {text}", "learned", OPEN) for name, text in life.items() if name.endswith("trained")]

    def carded(*begin: str) -> Solutions:
        return [(f"{name}: {text}", "system", OPEN) for name, text in card.items() if name.startswith(begin)]

    stages: tuple[tuple[str, Solutions], ...] = (
        (
            "scoping: the plan states where the learned part answers",
            [("The strata of the plan", "strata", OPEN)],
        ),
        (
            "safety requirements: they follow from the system's risk",
            [(risks, "rates", OPEN)] if evidence.hazards else [],
        ),
        ("data: the training data are known", carded(DATA, "Seen hands") + stated),
        ("learning: the training can be repeated", carded(LEARNING)),
        (
            "verification: the learned part meets its requirements",
            [
                (runs, "results", STATE[evidence.standing]),
                *([(f"{len(proven.claims)} claims about every question", "proven", OPEN)] if proven else []),
            ],
        ),
        (
            "deployment: the verified part answers in the cell, under a monitor",
            list(_deployment(evidence)) if evidence.learned else [],
        ),
    )
    for number, (text, solutions) in enumerate(stages, start=1):
        below = tuple(Element(ElementKind.SOLUTION, *item) for item in solutions)
        if number == len(stages) and below:
            below += (Element(ElementKind.GOAL, IN_THE_CELL, "learned", name="AMLAS stage 6, in the cell"),)
        # Learning yields the frozen network, which the hash identifies.
        frozen = tuple(Element(ElementKind.CONTEXT, item, "system") for item in hashes if number == 4)
        name = f"AMLAS stage {number}"
        yield Element(ElementKind.GOAL, f"Stage {number}, {text}", "system", OPEN, below, frozen, name=name)


IN_THE_CELL = (
    "Not covered here: the cell's controller loads this very file, a person reads the monitor and acts, and "
    "training has ended"
)


def _deployment(evidence: Evidence) -> Answers:
    """Yield answers about deployment.

    The answers state how a user detects a changed network, and give the result of each recorded cell.
    """
    yield "Frozen and known by its hash: another network needs another report", "learned", OPEN
    for part in evidence.system.under_test:
        if part.gate is not None and "question" in part.gate.name:
            yield f"The gate takes no answer to other questions: {part.gate.name}", "system", OPEN
    cells = [
        (f"Came back: {fact[0]}", *fact[1:]) for fact in _credibility(evidence) if fact[1] == "recorded-cells"
    ]
    yield from cells or [("The log of a cell is missing: judge, monitor, certify --cell", "learned", DOUBT)]


Solutions = list[tuple[str, str, str]]  # text, place, state
Answers = Iterator[tuple[str, str, str]]  # text, place, state


def _hunt(evidence: Evidence) -> Answers:
    """Yield the size of the search.

    Also yield the number of counterexamples from the search, and the number from the declared runs.
    """
    if evidence.search is not None:
        count = len(evidence.counterexamples)
        searched = sum(not example.independent for example in evidence.counterexamples)
        counts = searched, count - searched
        of_search, of_runs = (count_words(number, "counterexample", "counterexamples") for number in counts)
        text = f"Search of {evidence.search.runs} runs: {of_search}; declared runs: {of_runs}"
        yield text, "counterexamples", DOUBT if count else OPEN


def _domain(evidence: Evidence) -> Answers:
    """Yield the number of cells of the coverage map that contain runs."""
    if evidence.coverage.runs:
        text = f"Coverage: {len(evidence.coverage.cells)} cells in {evidence.coverage.runs} runs"
        yield text, "coverage", OPEN


def _credibility(evidence: Evidence) -> Answers:
    """Yield the result of each comparison that tests the simulator.

    The simulator is compared with the other world, with repeated runs, with recorded cells and with oracles.
    """
    known = evidence.credibility
    if (agreement := known.agreement) is not None:
        state = DOUBT if agreement.optimistic or not agreement.present else DONE
        yield (
            f"Two worlds: {agreement.disagreements} of {agreement.verdicts} verdicts differ",
            "agreement",
            state,
        )
    for rerun in known.reruns:
        text = f"{rerun.title}: {rerun.changed} of {rerun.verdicts} verdicts change"
        yield text, rerun.place, DOUBT if rerun.changed else DONE
    for cell in known.cells:
        fine = cell.decided and not cell.differing and cell.present
        fine = fine and not cell.foreign_to(evidence.system.under_test)
        text = f"A recorded cell: {cell.differing} of {cell.decided} verdicts differ"
        yield text, "recorded-cells", DONE if fine else DOUBT
    if known.oracles:
        yield f"{len(known.oracles)} parts against other software", "oracles", OPEN


def _tools(evidence: Evidence) -> Answers:
    """Yield how many seeded faults the self-test of the harness caught."""
    test = evidence.selftest
    if test is not None:
        every = 0 < len(test.faults) == test.caught and test.whole
        text = f"Seeded faults: {test.caught} of {len(test.faults)} caught"
        text += "" if test.whole else ", not all tried"
        yield text, "tools", DONE if every and not test.false_alarms and test.present else DOUBT


def _declared(evidence: Evidence) -> Answers:
    """Yield the hash of the declaration, if the plan was declared."""
    if digest := evidence.record.declaration_sha256:
        yield f"Declared as {digest[:12]}, if that was lodged before the runs", "plan", OPEN


def _calibration(evidence: Evidence) -> Answers:
    """Yield, for each stratum, the verdict on the avoider's intervals."""
    for check in evidence.calibration:
        decisions = count_words(check.decisions, "decision", "decisions")
        yield f"{check.stratum}: {decisions}, calibration {check.decided}", "calibration", check.decided


def _altered(evidence: Evidence) -> Answers:
    """Yield the root hash over all rows.

    Only a seal that is stored outside the report can protect this hash.
    """
    yield f"Root over all rows {evidence.record.rows_sha256[:12]}, to be sealed elsewhere", "provenance", OPEN


DEFEATERS: tuple[tuple[str, str, str, Callable[[Evidence], Answers]], ...] = (
    ("simulator", "The simulator is not the cell", "credibility", _credibility),
    ("domain", "The cell leaves the strata", "coverage", _domain),
    ("unmet", "Violations remain that no run met", "counterexamples", _hunt),
    ("judges", "The judges overlook a fault", "tools", _tools),
    ("certain", "The avoider is sure where it is wrong", "calibration", _calibration),
    ("fitted", "The plan was chosen after its runs", "plan", _declared),
    ("altered", "Rows were altered afterwards", "provenance", _altered),
)


def _defeaters(evidence: Evidence) -> Iterator[Element]:
    """Yield each defeater of the top goal.

    A defeater is green only if all its answers are green and it has no open finding.
    """
    for name, text, place, known in DEFEATERS:
        if name == "certain" and not evidence.system.asks:
            continue
        answers = tuple(Element(ElementKind.ANSWER, *item) for item in known(evidence))
        places = {place, *(item.place for item in answers)} | ({"strata"} if name == "domain" else set())
        findings = sum(item.place in places for item in evidence.findings)
        states = {item.state for item in answers}
        state = DONE if states == {DONE} and not findings else DOUBT
        label = f"{text}: {count_words(findings, 'open finding', 'open findings')}" if findings else text
        yield Element(ElementKind.DEFEATER, label, place, state, answers, name=f"defeater: {name}")
