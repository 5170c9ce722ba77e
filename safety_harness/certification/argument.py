"""The assurance argument in goal structuring notation, made from the evidence: what is claimed, on what.

Goals are what should be true, strategies how a goal is broken down, solutions the evidence it rests on;
contexts and assumptions stand beside.  A goal without a solution is undeveloped and is drawn so.  The words
on goals are the evidence's own: an argument whose evidence fails shows it.

In the picture goals are boxes, strategies slanted, solutions circles, contexts rounded.  A goal stands above
the strategies that support it; what supports a strategy stands below it in rows, each with its solutions to
the right, so that the picture is as wide as a page.  Contexts and assumptions stand beside.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from html import escape

from markupsafe import Markup

from safety_harness.certification.evidence import ClaimEvidence, ClaimStatus, Evidence, by_gravity
from safety_harness.certification.verdicts import percent
from safety_harness.report.page_parts import templates
from safety_harness.report.svg import plain

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


@dataclass(frozen=True)
class Element:
    """One element: ``place`` is the id on the page that it leads to, ``state`` the colour of what it says.

    ``below`` supports it, ``beside`` is what it is to be read in.  ``key`` has its kind and number.
    """

    kind: ElementKind
    text: str
    place: str
    state: str = OPEN
    below: tuple[Element, ...] = ()
    beside: tuple[Element, ...] = ()
    key: str = ""

    @property
    def undeveloped(self) -> bool:
        """A goal or strategy that nothing supports."""
        return self.kind in (ElementKind.GOAL, ElementKind.STRATEGY) and not self.below


def argument_of(evidence: Evidence) -> Element:
    """The whole argument; its leaves lead to the parts of the page that hold their evidence."""
    plan, system = evidence.plan, evidence.system
    domain = "Domain: " + ", ".join(one.name for one in evidence.strata)
    cell = "Hands, braking and arm are as the assumptions say"
    sure = f"{percent(plan.confidence)} for all {plan.bounds} bounds together, {plan.world}"
    by_claims = Element(
        ElementKind.STRATEGY,
        "By claim and stratum, with exact bounds from independent runs",
        "results",
        beside=(Element(ElementKind.CONTEXT, sure, "plan"),),
        below=tuple(map(_of_claim, by_gravity(evidence.claims))),
    )
    means = (
        ("Ways to violate a claim are known and explained", "counterexamples", DOUBT, _hunt),
        ("The simulator may be believed for these claims", "credibility", OPEN, _credibility),
        ("What judges would notice a fault", "tools", OPEN, _tools),
    )
    by_means = Element(
        ElementKind.STRATEGY,
        "By what could make the bounds misleading",
        "not-shown",
        below=tuple(
            Element(ElementKind.GOAL, text, place, state, tuple(support(evidence)))
            for text, place, state, support in means
        ),
    )
    top = Element(
        ElementKind.GOAL,
        f"{system.tested} keeps the plan's claims in the declared domain, as often as it asks"
        + (f"; {evidence.fallback}" if evidence.fallback else ""),
        "claims",
        STATE[evidence.standing],
        below=(by_claims, by_means),
        beside=(
            Element(ElementKind.CONTEXT, domain, "strata"),
            Element(ElementKind.CONTEXT, f"System: {system.tested} on {system.robot}", "system"),
            Element(ElementKind.ASSUMPTION, cell, "assumptions"),
        ),
    )
    return _numbered(top, Counter())


def _numbered(element: Element, counts: Counter[ElementKind]) -> Element:
    """With keys, counted by kind: what stands beside an element before what stands below it."""
    counts[element.kind] += 1
    key = f"{element.kind.value}{counts[element.kind]}"
    beside = tuple(_numbered(one, counts) for one in element.beside)
    return replace(
        element, key=key, beside=beside, below=tuple(_numbered(one, counts) for one in element.below)
    )


def _of_claim(claim: ClaimEvidence) -> Element:
    place, state = f"claim-{claim.number}", STATE[claim.standing]
    target = "" if claim.target is None else f", violated in at most {percent(claim.target)}"
    runs = sum(outcome.tested for outcome in claim.outcomes)
    words = f"{runs} runs put it to the test: {claim.standing.value}"
    tested = (Element(ElementKind.SOLUTION, words, place, state),) if runs else ()
    return Element(ElementKind.GOAL, f"{claim.sentence}{target}", place, state, tested)


def _hunt(evidence: Evidence) -> Iterator[Element]:
    if evidence.search is not None:
        distinct = len(evidence.counterexamples)
        words = f"Search of {evidence.search.runs} runs; {distinct} distinct counterexamples in all"
        yield Element(ElementKind.SOLUTION, words, "counterexamples", DOUBT if distinct else OPEN)
    if evidence.coverage.runs:
        words = f"Coverage: {len(evidence.coverage.cells)} cells in {evidence.coverage.runs} runs"
        yield Element(ElementKind.SOLUTION, words, "coverage")


def _credibility(evidence: Evidence) -> Iterator[Element]:
    known = evidence.credibility
    if (agreement := known.agreement) is not None:
        state = DOUBT if agreement.optimistic or not agreement.present else DONE
        words = f"Two worlds: {agreement.disagreements} of {agreement.verdicts} verdicts differ"
        yield Element(ElementKind.SOLUTION, words, "agreement", state)
    for rerun in known.reruns:
        words = f"{rerun.title}: {rerun.changed} of {rerun.verdicts} verdicts change"
        yield Element(ElementKind.SOLUTION, words, rerun.place, DOUBT if rerun.changed else DONE)
    for cell in known.cells:
        words = f"A recorded cell: {cell.differing} of {cell.decided} verdicts differ"
        fine = cell.decided and not cell.differing and cell.present
        yield Element(ElementKind.SOLUTION, words, "recorded-cells", DONE if fine else DOUBT)
    if known.oracles:
        yield Element(ElementKind.SOLUTION, f"{len(known.oracles)} parts against other software", "oracles")


def _tools(evidence: Evidence) -> Iterator[Element]:
    test = evidence.selftest
    if test is not None:
        every = 0 < len(test.faults) == test.caught and test.whole
        words = f"Seeded faults: {test.caught} of {len(test.faults)} caught"
        words += "" if test.whole else ", not all tried"
        fine = every and not test.false_alarms and test.present
        yield Element(ElementKind.SOLUTION, words, "tools", DONE if fine else DOUBT)


WIDTH, PAD, LINE, GAP_X, GAP_Y = 176.0, 10.0, 15.0, 22.0, 46.0
LETTERS = 25  # in a line of a box


class _Box:
    """An element with its place: the left upper corner and the size; its words are markup."""

    def __init__(self, element: Element, x: float, y: float) -> None:
        kind = element.kind.name.lower()
        self.element, self.x, self.y, self.width = element, x, y, WIDTH
        lines = textwrap.wrap(plain(element.text, longest=140), LETTERS) or [""]
        self.lines = [Markup(escape(line)) for line in (f"{element.key} \u00b7 {kind}", *lines)]
        self.height = 2 * PAD + LINE * len(self.lines)
        self.middle, self.bottom = x + WIDTH / 2.0, y + self.height


def _own_width(element: Element) -> float:
    return WIDTH + (WIDTH + GAP_X if element.beside else 0.0)


def _width(element: Element) -> float:
    """With all that supports it."""
    if element.kind is ElementKind.STRATEGY:
        return max(_own_width(element), 2 * (GAP_X + WIDTH))
    below = sum(map(_width, element.below)) + GAP_X * max(len(element.below) - 1, 0)
    return max(_own_width(element), below)


class _Layout:
    """Places every element, and remembers what is joined to what."""

    def __init__(self, top: Element) -> None:
        self.boxes: list[_Box] = []
        self.arrows: list[tuple[list[tuple[float, float]], str]] = []  # a line, the marker at its end
        self.width = _width(top) + 2 * GAP_X
        self.height = self._place(top, GAP_X, GAP_X)[1] + GAP_X

    def _place(self, element: Element, left: float, top: float) -> tuple[_Box, float]:
        """Put ``element`` and all below it; returns its box and how far down all of it goes."""
        box = self._box(element, left, top)  # it begins where a narrow screen does
        bottom = max(self._to_the_right(box, element.beside, "ring") - 8.0, box.bottom)
        if element.kind is ElementKind.STRATEGY:
            return box, self._rows(box, left, bottom + GAP_Y * 0.6)
        lowest, start = bottom, left
        for one in element.below:
            placed, end = self._place(one, start, bottom + GAP_Y)
            level = placed.y - GAP_Y / 2.0
            below = (box.middle, box.bottom), (box.middle, level)
            self.arrows.append(([*below, (placed.middle, level), (placed.middle, placed.y)], "tip"))
            lowest, start = max(lowest, end), start + _width(one) + GAP_X
        return box, lowest

    def _to_the_right(self, box: _Box, elements: tuple[Element, ...], tip: str) -> float:
        """Put elements beside a box, one below the other; returns where another one would stand."""
        y = box.y
        for one in elements:
            beside = self._box(one, box.x + WIDTH + GAP_X, y)
            centre = beside.y + beside.height / 2.0
            start = box.x + WIDTH, min(centre, box.bottom - 4.0)
            self.arrows.append(([start, (beside.x, centre)], tip))
            y += beside.height + 8.0
        return y

    def _rows(self, box: _Box, left: float, y: float) -> float:
        """What supports a strategy, one below the other, each with its own support to the right."""
        rail = min(left, box.x) + 6.0
        centre = box.bottom
        for one in box.element.below:
            placed = self._box(one, left + GAP_X, y)
            end = placed.bottom + (8.0 if one.undeveloped else 0.0)
            centre = placed.y + placed.height / 2.0
            self.arrows.append(([(rail, centre), (placed.x, centre)], "tip"))
            y = max(self._to_the_right(placed, one.below, "tip"), end + 12.0)
        joint = (box.middle, box.bottom + 10.0), (rail, box.bottom + 10.0)
        self.arrows.append(([(box.middle, box.bottom), *joint, (rail, centre)], ""))
        return y

    def _box(self, element: Element, x: float, y: float) -> _Box:
        self.boxes.append(_Box(element, x, y))
        return self.boxes[-1]


def argument_svg(top: Element, *, prefix: str) -> str:
    """The picture as an ``<svg>`` element; every element is a link to its place on the page."""
    drawn = templates().get_template("argument.svg.j2")
    return drawn.render(layout=_Layout(top), prefix=prefix, pad=PAD, line_height=LINE)
