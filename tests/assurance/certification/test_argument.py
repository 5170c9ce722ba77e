from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import pytest
from made_up_evidence import HOSTILE, STRATA, evidence
from ruamel.yaml import YAML

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.certification.argument import (
    MOST_STRATA,
    Element,
    ElementKind,
    argument_of,
)
from safety_harness.extensions.assurance.certification.argument_files import (
    NOTES,
    gsn_text,
    notes_text,
    read_notes,
)
from safety_harness.extensions.assurance.certification.argument_picture import _Layout, argument_svg
from safety_harness.extensions.assurance.certification.evidence import (
    ArgumentNote,
    ClaimStatus,
    Evidence,
    OpenFinding,
)
from safety_harness.extensions.assurance.certification.findings import of_hazards
from safety_harness.extensions.assurance.certification.tools import CoverageOfRuns, Credibility


def every(element: Element) -> list[Element]:
    return list(element.every())


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
            elif element.kind is ElementKind.DEFEATER:
                assert all(inner.kind is ElementKind.ANSWER for inner in element.below)
            else:
                assert not element.below, element.text
        assert drawn.count("<title>undeveloped: without support") == open_goals > 0


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
    assert "The simulator is not the cell" in undeveloped
    assert "The judges overlook a fault" in undeveloped
    assert not any("hand distance" in text for text in undeveloped)


def test_the_top_is_argued_by_hazard_then_claim_then_stratum_with_a_rate_an_hour() -> None:
    top = argument_of(evidence())
    by_hazard = top.below[0]
    first, second, *others = by_hazard.below
    assert first.text.startswith("Kept rare: crushed hand, at most 1e-06 an hour")
    assert [one.kind.name for one in first.beside] == ["CONTEXT", "JUSTIFICATION", "ASSUMPTION"]
    refuted, shown = first.below
    assert [one.text.split(":")[0] for one in refuted.below] == [*STRATA, "At most 0.085 an hour"]
    assert (refuted.state, shown.state, first.state) == ("violated", "holds", "violated")
    assert second.undeveloped
    assert [len(one.below) for one in others] == [4], "claims under no hazard of the plan, by their words"


def test_a_hazard_whose_rate_is_not_what_is_asked_is_open_though_its_claims_are_shown() -> None:
    known = evidence()
    (hazard, _) = known.hazards
    only = replace(hazard, claims=(2,), rates=hazard.rates[1:])
    states = []
    for one in (only, replace(only, asked_an_hour=0.01), replace(only, rates=())):
        found = argument_of(replace(known, hazards=(one,)))
        states.append(found.below[0].below[0].state)
    assert states == ["inconclusive", "holds", "inconclusive"]


def test_a_rate_of_the_model_alone_is_not_shown_by_its_number() -> None:
    known = evidence()
    (hazard, _) = known.hazards
    kept = replace(hazard, asked_an_hour=1e6)
    assert kept.met
    for model_only, state in ((False, "holds"), (True, "inconclusive")):
        one = replace(known, hazards=(kept,), plan=replace(known.plan, model_only=model_only))
        found = [e for e in argument_of(one).every() if e.text.endswith("an hour") and e.place == "rates"]
        assert {e.state for e in found if e.kind is ElementKind.SOLUTION} == {state}
        texts = [finding.text for finding in of_hazards(one.hazards, model_only=model_only)]
        assert len(texts) == model_only
        assert all("of the model alone" in text for text in texts)


def test_a_rate_that_is_missing_says_what_is_not_known() -> None:
    (hazard, _) = evidence().hazards
    (finding,) = of_hazards((replace(hazard, approaches="", rates=()),), model_only=False)
    assert finding.text.endswith("is not shown: nobody said how often people come near (approaches)")


def test_more_strata_than_fit_are_told_together_the_gravest_alone() -> None:
    known = evidence()
    claim = known.claims[0]
    fine = replace(claim.outcomes[0], standing=ClaimStatus.SHOWN)
    many = replace(claim, outcomes=(*(fine for _ in range(9)), claim.outcomes[0]))
    (goal,) = [
        one
        for one in every(argument_of(replace(known, claims=(many, *known.claims[1:]))))
        if one.text.startswith("hand distance")
    ]
    texts = [one.text for one in goal.below]
    assert "refuted" in texts[0]
    assert texts[MOST_STRATA - 1] == "7 more strata: shown at worst"


def test_the_stages_of_the_learned_part_stand_where_something_is_learned() -> None:
    known = evidence()
    (stages,) = [one for one in argument_of(known).below if "AMLAS" in one.text]
    assert len(stages.below) == 6
    *_, deployment = stages.below
    texts = [one.text for one in deployment.below]
    assert [one.undeveloped for one in deployment.below] == [False] * (len(texts) - 1) + [True]
    assert any("its hash" in text for text in texts)
    assert any(text.startswith(("The log of a cell is missing", "Came back: ")) for text in texts)
    assert texts[-1].startswith("Not covered here: the cell's controller loads this very file")
    *_, unstated = next(
        one for one in argument_of(replace(known, learned=None)).below if "AMLAS" in one.text
    ).below
    assert unstated.undeveloped
    without = replace(known, proven=None, learned=None, system=replace(known.system, card=()))
    assert not any("AMLAS" in one.text for one in every(argument_of(without)))


def test_a_defeater_is_green_only_where_all_answers_are_and_no_finding_is_open() -> None:
    known = evidence().selftest
    assert known is not None
    caught = tuple(fault for fault in known.faults if fault.caught_by)
    fine = replace(known, faults=caught)
    finding = OpenFinding(text="something", place="tools")
    states = []
    for test, findings in ((fine, ()), (fine, (finding,)), (known, ()), (None, ())):
        whole = replace(evidence(), selftest=test, findings=findings)
        (judges,) = [one for one in every(argument_of(whole)) if one.name == "defeater: judges"]
        states.append(judges.state)
    assert states == ["holds", "inconclusive", "inconclusive", "inconclusive"]


def test_a_note_of_the_author_stands_beside_and_changes_no_state() -> None:
    whole = evidence()
    without = replace(whole, notes=())
    noted, plain = (every(argument_of(one)) for one in (whole, without))
    assert [one.state for one in noted if "The author" not in one.text] == [one.state for one in plain]
    (note,) = [
        one for one in noted if one not in plain and one.kind is ElementKind.JUSTIFICATION and not one.below
    ]
    assert note.text == f"The author: asked {HOSTILE}"


def test_notes_are_read_again_as_they_were_written(tmp_path: Path) -> None:
    texts = ("one line", "several\n  lines: # with <b>\n\nand a gap", '"quoted" \\ back', "\u00e9\u4e2d")
    known = evidence()
    names = [one.name for one in every(argument_of(known)) if one.name]
    notes = tuple(ArgumentNote(element=a, text=b) for a, b in zip(names, texts, strict=False)) + (
        ArgumentNote(element="gone: once there", text="kept"),
    )
    (tmp_path / NOTES).write_text(notes_text(replace(known, notes=notes)), "utf-8")
    assert read_notes(tmp_path) == notes


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- a list\n", "a mapping"),
        ('"top": [a]\n', "top"),
        ('"top": "a\n', "well-formed YAML"),
        (f'"top": {"x" * 2001}\n', "2000 characters"),
        ('"top": "a\\tb"\n', "U+0009"),
    ],
)
def test_a_file_of_notes_that_cannot_be_read_is_refused_with_its_place(
    tmp_path: Path, text: str, said: str
) -> None:
    (tmp_path / NOTES).write_text(text)
    with pytest.raises(InputError) as caught:
        read_notes(tmp_path)
    assert said in str(caught.value)
    assert NOTES in str(caught.value)


def test_the_export_keeps_the_rules_that_gsn2x_checks() -> None:
    """V01, V02, V04 to V06, V10, V12 and C01 to C04 of its documented checks."""
    for whole in (evidence(), evidence(only_shown=True), without_evidence()):
        found = YAML(typ="safe", pure=True).load(gsn_text(whole, "evidence.html"))
        kinds = {key: re.match(r"[A-Z][A-Za-z]*", key)[0] for key in found}  # type: ignore[index]
        assert set(kinds.values()) <= {one.value for one in ElementKind}
        support = {key: one.get("supportedBy", []) for key, one in found.items()}
        beside = {key: one.get("inContextOf", []) for key, one in found.items()}
        for key, one in found.items():
            assert set(one) <= {
                *("text", "url", "supportedBy", "inContextOf", "undeveloped", "challenges", "defeated")
            }
            if kinds[key] in ("G", "S", "CG"):
                assert bool(support[key]) != one.get("undeveloped", False)
            assert {kinds[other] for other in support[key]} <= {"G", "S", "Sn"}
            assert {kinds[other] for other in beside[key]} <= {"C", "A", "J"}
            assert len(set(support[key] + beside[key])) == len(support[key] + beside[key])
            assert ("challenges" in one) == (kinds[key] in ("CG", "CSn"))
            assert one.get("challenges", "G1") in found
            if one.get("defeated"):
                assert any(other.get("challenges") == key for other in found.values())
        below = {other for key in found for other in support[key] + beside[key]}
        assert [key for key in found if key not in below and "challenges" not in found[key]] == ["G1"]


def test_a_claim_that_was_never_tested_has_no_solution() -> None:
    (goal,) = [one for one in every(argument_of(evidence())) if one.text.startswith("stops within")]
    assert goal.undeveloped
    assert goal.state == "violated"


def test_a_stratum_that_was_never_tested_is_a_goal_that_nothing_supports() -> None:
    known = evidence()
    claim = known.claims[0]
    first = claim.outcomes[0]
    untested = replace(first, stratum="far", untested=first.runs, standing=ClaimStatus.UNTESTED)
    changed = replace(claim, outcomes=(*claim.outcomes, untested))
    top = argument_of(replace(known, claims=(changed, *known.claims[1:])))
    (goal,) = [one for one in every(top) if one.text == "far: never put to the test"]
    assert (goal.undeveloped, goal.state) == (True, "violated")


def test_a_rate_is_never_said_to_be_lower_than_it_is() -> None:
    known = evidence()
    (hazard, _) = known.hazards
    exact = replace(hazard, rates=tuple(replace(one, an_hour=9.97146e-07) for one in hazard.rates))
    texts = {one.text for one in every(argument_of(replace(known, hazards=(exact,))))}
    assert "At most 9.98e-07 an hour" in texts


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


def test_a_policy_is_not_argued_by_the_stages_of_supervised_learning() -> None:
    """AMLAS does not cover a controller learned by reinforcement: not applicable, and open."""
    known = evidence()
    assert known.learned is not None
    policy = replace(known, learned=replace(known.learned, strata=()))
    (amlas,) = [one for one in argument_of(policy).below if "AMLAS" in one.text]
    assert amlas.text.startswith("Not applicable, and open: AMLAS covers offline supervised learning.")
    assert amlas.undeveloped
    assert amlas.below == ()
