from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

from made_up_evidence import evidence

from safety_harness.certification.argument import Element, ElementKind, _Layout, argument_of, argument_svg
from safety_harness.certification.evidence import Evidence
from safety_harness.certification.tools import CoverageOfRuns, Credibility


def every(element: Element) -> list[Element]:
    return [element, *(one for child in (*element.beside, *element.below) for one in every(child))]


def without_evidence() -> Evidence:
    none = Credibility(agreement=None, reruns=(), oracles=(), oracles_measured_with="", absent=())
    empty = CoverageOfRuns(runs=0, without_hand=0, cells=(), about="")
    return replace(evidence(counterexamples=0), credibility=none, selftest=None, search=None, coverage=empty)


def test_every_goal_leads_to_solutions_or_is_marked_in_the_picture_as_undeveloped() -> None:
    for one in (evidence(), without_evidence()):
        drawn = argument_svg(argument_of(one), prefix="a-")
        open_goals = 0
        for element in every(argument_of(one)):
            if element.kind in (ElementKind.GOAL, ElementKind.STRATEGY):
                leaves = [
                    inner for inner in every(element) if not inner.below and inner not in element.beside
                ]
                solved = any(inner.kind is ElementKind.SOLUTION for inner in leaves)
                assert solved or any(inner.undeveloped for inner in leaves), element.text
                open_goals += element.undeveloped
            else:
                assert not element.below, element.text
        assert drawn.count("<title>undeveloped: nothing supports it") == open_goals > 0


def test_a_trial_of_the_harness_is_fine_only_if_it_is_whole_present_and_caught_every_fault() -> None:
    known = evidence().selftest
    assert known is not None
    caught = tuple(fault for fault in known.faults if fault.caught_by)
    fine = replace(known, faults=caught, false_alarms=(), present=True, whole=True)
    others = (
        replace(fine, faults=()),
        replace(fine, faults=known.faults),
        replace(fine, false_alarms=("loud",)),
        replace(fine, present=False),
        replace(fine, whole=False),
    )
    states = []
    for test in (fine, *others):
        (leaf,) = [
            one
            for one in every(argument_of(replace(evidence(), selftest=test)))
            if one.text.startswith("Seeded faults")
        ]
        states.append(leaf.state)
    assert states == ["holds", *["inconclusive"] * len(others)]


def test_a_goal_without_evidence_is_undeveloped() -> None:
    undeveloped = {one.text for one in every(argument_of(without_evidence())) if one.undeveloped}
    assert "The simulator may be believed for these claims" in undeveloped
    assert "What judges would notice a fault" in undeveloped
    assert not any("hand distance" in text for text in undeveloped)


def test_a_claim_that_was_never_tested_has_no_solution() -> None:
    (goal,) = [one for one in every(argument_of(evidence())) if one.text.startswith("stops within")]
    assert goal.undeveloped
    assert goal.state == "violated"


def test_the_top_goal_says_what_the_gravest_claim_says() -> None:
    assert argument_of(evidence()).state == "violated"
    assert argument_of(evidence(only_shown=True)).state == "holds"


def test_keys_are_unique() -> None:
    keys = [one.key for one in every(argument_of(evidence()))]
    assert len(keys) == len(set(keys))


def test_no_two_boxes_of_the_picture_overlap_and_all_lie_within_it() -> None:
    layout = _Layout(argument_of(evidence()))
    boxes = sorted(layout.boxes, key=lambda box: (box.x, box.y))
    for box in boxes:
        assert box.x >= 0.0
        assert box.y >= 0.0
        assert box.x + box.width <= layout.width
        assert box.y + box.height <= layout.height
    for k, one in enumerate(boxes):
        for other in boxes[k + 1 :]:
            apart_x = one.x + one.width <= other.x or other.x + other.width <= one.x
            apart_y = one.y + one.height <= other.y or other.y + other.height <= one.y
            assert apart_x or apart_y, (one.element.key, other.element.key)
    assert len(list(pairwise(boxes))) > 10


def test_the_picture_is_markup_in_which_names_are_text() -> None:
    drawn = argument_svg(argument_of(evidence()), prefix="a-")
    root = ElementTree.fromstring(drawn)
    assert not any(element.tag.endswith("script") for element in root.iter())
    assert "<b>" not in drawn
    links = re.findall(r'href="#([^"]+)"', drawn)
    assert len(links) == len(every(argument_of(evidence())))
