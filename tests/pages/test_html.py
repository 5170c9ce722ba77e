from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import factory
import numpy as np
import pytest
from page import Node, parse

from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.pages.page_parts import asset, templates
from safety_harness.extensions.pages.run_page import MOST_IN_FULL, notes, render
from safety_harness.extensions.pages.svg import Ink
from safety_harness.report.decisions import MOST_DECISION_ROWS
from safety_harness.report.evidence import JudgedRun, notes_of
from safety_harness.scenario.faults import CameraBlind, Joint, JointStuck
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import Robot
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.records import DECISION, TICK

WHEN = datetime(2025, 11, 21, 9, 30, tzinfo=UTC)
SCENARIOS = Path(__file__).parents[2] / "scenarios"


def text_for(runs: Sequence[JudgedRun], *, title: str = "A report", interrupted: bool = False) -> str:
    return render(runs, title=title, command="harness run", interrupted=interrupted, generated_at=WHEN)


def banners(page: Node) -> list[str]:
    summary = page.all("section", "summary")[0]
    found = [node for node in summary.walk() if "banner" in node.attributes.get("class", "").split()]
    return [banner.all("strong")[0].text for banner in found]


def rows(page: Node) -> list[list[str]]:
    table = page.all("table", "verdicts")[0]
    body = table.all("tbody")[0]
    return [[cell.text for cell in row.children if isinstance(cell, Node)] for row in body.all("tr")]


@pytest.fixture(scope="module")
def full_text() -> str:
    runs = [factory.holds_run(), factory.violated_run(), factory.no_hands_run(), factory.truncated_run()]
    return text_for(runs, interrupted=True)


@pytest.fixture(scope="module")
def full(full_text: str) -> Node:
    return parse(full_text)


@pytest.fixture(scope="module")
def hostile_text() -> str:
    return text_for([factory.hostile_run()], title=f"page {factory.HOSTILE}")


def test_each_template_is_compiled_once() -> None:
    assert templates().get_template("report.html.j2") is templates().get_template("report.html.j2")


def test_every_scenario_and_claim_has_its_row_with_verdict_expectation_margin_and_moment(full: Node) -> None:
    found = rows(full)
    assert len(found) == 7
    assert found[2] == [
        "Two hands from both sides, the controller short-sighted two-hands "
        "1 of 3 decisions fell back to the opposite pose 1 of 3 decisions stopped the arm",
        f"Claim 1 {factory.APART}",
        "violated",
        "≠ holds",
        "−37.1 mm",
        "8.600 s",
        "right hand 112.9 mm from wrist 1",
    ]
    assert found[5][2:6] == ["inconclusive", "inconclusive", "–", "–"]


def test_a_scenario_is_named_with_its_file(tmp_path: Path) -> None:
    run = factory.holds_run()
    scenario = replace(run.trace.scenario, file=tmp_path / "reach-in.yaml")
    page = parse(text_for([replace(run, trace=replace(run.trace, scenario=scenario))]))
    assert [node.text for node in page.all("code", "file")] == [
        "reach-in.yaml"
    ] * 2  # in the table, where the second claim leaves it out, and in its section


def test_the_number_of_a_claim_stands_apart_from_its_sentence(full: Node) -> None:
    for row in full.one("run-2").all("ol", "claims")[0].all("li"):
        number, sentence = row.all("span", "claim-number")[0], row.all("p", "sentence")[0]
        assert number.text.removeprefix("Claim ").isdigit()
        assert number not in list(sentence.walk())


def test_the_avoider_its_decisions_and_their_outcomes_are_summed_up_first(full: Node) -> None:
    summary = full.all("dl", "avoiders")[0]
    terms = {node.all("dt")[0].text: node.all("dd")[0].text for node in summary.all("div")}
    assert terms == {
        "Avoider": "opposite",
        "Decisions": "8",  # the run that was cut short has only two of three
        "Proposals at the gate": "overruled 5 of 8 proposals (62.5 %): 3 path unreachable, 2 unreachable, "
        "2 table; 3 replaced by the opposite pose, 2 by a stop",
        "Faults: no usable answer": "0 0 %",
        "Computing time": "opposite: computing time not modelled",
    }


def test_beside_the_verdicts_stands_what_the_capsules_add(full: Node) -> None:
    section = next(node for node in full.all("section") if node.attributes["aria-labelledby"] == "verdicts")
    (note,) = section.all("p", "banner")
    assert "68.4 mm at the upper arm" in note.text


def test_every_row_leads_to_the_section_of_its_scenario(full: Node) -> None:
    sections = {article.attributes["id"]: article for article in full.all("article")}
    rows = full.all("table", "verdicts")[0].all("tbody")[0].all("tr")
    for row in (row for row in rows if "again" not in row.attributes.get("class", "")):
        (link,) = row.all("a")
        heading = sections[link.attributes["href"].removeprefix("#")].all("h2")[0]
        assert heading.text == link.text


def test_a_verdict_is_a_word_and_a_symbol_never_a_colour_alone(full: Node) -> None:
    shown = full.all("span", "verdict")
    assert len(shown) == 14 + 1  # each claim in the table and in its section, the worst violation on top
    for verdict in shown:
        assert verdict.text in {each.value for each in Verdict}
        assert verdict.all("use")[0].attributes["href"] == f"#icon-{verdict.text}"
    assert len({full.one(f"icon-{each.value}").all("path")[0].attributes["d"] for each in Verdict}) == 3


def test_interruption_differences_doubt_and_truncation_are_said_first(full: Node) -> None:
    answer = "5 of 7 verdicts as expected (3 hold, 2 violated, 2 inconclusive)."
    assert banners(full) == ["Interrupted.", answer, "Cut short."]
    assert "no evidence of safety" in full.all("div", "grave")[0].text


def test_the_worst_violation_stands_on_top_with_margin_moment_part_contact_and_picture(full: Node) -> None:
    (box,) = full.all("div", "answer")
    assert "grave" in box.attributes["class"]
    first, *_ = (row for row in full.all("tr", "differs") if row.all("span", "violated"))
    assert all(cell.text in box.text for cell in first.all("td", "number"))
    assert first.all("td")[-1].text in box.text  # the reason, which names the part
    assert len(box.all("svg")) == 2  # the verdict's sign and the picture
    assert parse(text_for([factory.holds_run()])).all("div", "answer") == []


def test_a_report_in_which_all_came_out_as_expected_says_just_that() -> None:
    page = parse(text_for([factory.holds_run()]))
    assert banners(page) == ["2 of 2 verdicts as expected (2 hold)."]
    assert page.all("p", "fine")


def test_a_report_with_an_expected_inconclusive_claim_is_not_all_green() -> None:
    page = parse(text_for([factory.holds_run(), factory.no_hands_run()]))
    assert banners(page) == ["3 of 3 verdicts as expected (2 hold, 1 inconclusive)."]
    assert "no evidence of safety" in page.all("p", "banner")[0].text
    assert not page.all("p", "fine")


def test_a_foreseen_violation_is_not_shown_as_green() -> None:
    run = factory.violated_run()
    claims = tuple(replace(claim, expected=Verdict.VIOLATED) for claim in run.trace.scenario.claims[:2])
    scenario = replace(run.trace.scenario, claims=claims)
    run = JudgedRun(replace(run.trace, scenario=scenario), run.evaluations[:2], "again")
    page = parse(text_for([run]))
    assert banners(page) == ["2 of 2 verdicts as expected (2 violated)."]
    assert not page.all("p", "fine")


def test_no_run_or_no_claim_is_no_evidence() -> None:
    assert banners(parse(text_for([]))) == ["No evidence."]
    unclaimed = JudgedRun(factory.trace(factory.scenario(), ticks=20), (), "again")
    assert "No evidence." in banners(parse(text_for([unclaimed])))
    mixed = banners(parse(text_for([factory.holds_run(), unclaimed])))
    assert "Nothing claimed." in mixed
    assert not parse(text_for([factory.holds_run(), unclaimed])).all("p", "fine")


def test_the_decisions_are_listed_with_triggers_outcomes_and_failed_checks(full: Node) -> None:
    table = full.one("run-2").all("table", "decisions")[0]
    cells = [[cell.text for cell in row.all("th") + row.all("td")] for row in table.all("tbody")[0].all("tr")]
    assert [row[2] for row in cells] == ["hand entered", "hand still there", "another hand"]
    assert [row[6] for row in cells] == ["11.0 ≤ 12.5"] * 3
    assert [row[7] for row in cells] == ["proposed position", "opposite pose", "protective stop"]
    assert cells[2][8] == "proposed: unreachable, table; opposite: unreachable"
    assert cells[2][9] == "–"
    decision = factory.violated_run().trace.decisions[0]
    numbers = [int(word.replace("−", "-")) for word in cells[0][3].split(",")]
    assert numbers == np.rint(decision["hand_position_in_base_m"] * 1e3).tolist()


def test_limits_settings_notes_provenance_and_replay_are_there(full: Node) -> None:
    section = full.one("run-2")
    text = section.text
    assert "avoidance." in text
    for expected in ("400 mm", "250 mm", "TCP speed", "TCP acceleration", "3 gaps of at most 41 ms"):
        assert expected in text
    for expected in ("0123456789abcdef", "kinematic", "Linux-x86_64", "numpy 2.4.6", "2501 of 2501"):
        assert expected in text
    assert section.all("code", "copy")[0].text == factory.violated_run().replay_command
    assert "All settings have their defaults" in full.one("run-1").text


@pytest.mark.parametrize("told", [True, False])
def test_what_was_bridged_in_a_recording_is_said_once(told: bool) -> None:
    hands = read_scenario(SCENARIOS / "recorded-giving.yaml").hands
    run = factory.no_hands_run()
    trace = replace(run.trace, scenario=replace(run.trace.scenario, hands=hands))
    (note,) = notes_of(trace.scenario)
    run = replace(run, trace=trace, notes=(note,) if told else ())
    assert notes(run) == [note]


def test_a_page_says_that_a_recorded_hand_is_a_wrist(full_text: str) -> None:
    run = factory.no_hands_run()
    hands = read_scenario(SCENARIOS / "recorded-giving.yaml").hands
    trace = replace(run.trace, scenario=replace(run.trace.scenario, hands=hands))
    words = "Recorded hands are wrists."
    assert words in text_for([replace(run, trace=trace)])
    assert words not in full_text


def test_the_scenario_is_there_as_a_file_that_can_be_saved_again(full: Node) -> None:
    written = full.one("run-2").all("pre")[0].children[0]
    assert written == write_scenario(factory.violated_run().trace.scenario)


def test_the_ticks_of_each_limit_are_counted(full: Node) -> None:
    acted = factory.holds_run().trace.ticks["limits"]
    (row,) = [row for row in full.one("run-1").all("tr") if row.text.startswith("TCP speed")]
    assert row.all("td")[0].text == str(int((acted & 1 != 0).sum()))


def test_a_scenario_without_hands_has_neither_hands_nor_decisions(full: Node) -> None:
    section = full.one("run-3")
    assert "The run has no decision." in section.text
    assert "no hand was present" in section.text
    assert not section.all("table", "decisions")


def test_a_trace_without_ticks_says_so_instead_of_drawing() -> None:
    source = factory.scenario(claims=(factory.claim(factory.APART),))
    empty = replace(
        factory.trace(source, ticks=1), ticks=np.zeros(0, TICK), decisions=np.zeros(0, DECISION), ended="?"
    )
    verdict = factory.evaluation(factory.APART, Verdict.INCONCLUSIVE, margin=None, worst_time_s=None)
    page = parse(text_for([JudgedRun(empty, (verdict,), "again")]))
    assert "The trace has no ticks" in page.one("run-1").text
    assert not page.one("run-1").all("figure")


def test_a_thinned_curve_says_that_it_is_thinned(full: Node) -> None:
    assert "the smallest and the largest value of every 6 ticks" in full.one("run-2").text
    assert "Every tick is drawn." in full.one("run-4").text


def test_a_table_that_leaves_decisions_out_says_so() -> None:
    run = factory.holds_run()
    many = np.concatenate([run.trace.decisions] * 40)
    page = parse(text_for([replace(run, trace=replace(run.trace, decisions=many))]))
    table = page.all("table", "decisions")[0]
    assert len(table.all("tbody")[0].all("tr")) == MOST_DECISION_ROWS
    assert f"The first {MOST_DECISION_ROWS} of 120 decisions" in table.all("caption")[0].text


def test_markup_in_any_text_of_the_user_is_shown_and_not_obeyed(hostile_text: str) -> None:
    assert hostile_text.count("<script") == 1  # the page's own
    assert "<b>" not in hostile_text
    page = parse(hostile_text)
    for prefix in ("page", "title", "about", "hand claim", "hand read", "reason", "note", "replay", "ended"):
        assert f"{prefix} {factory.HOSTILE}" in page.text, prefix


def test_the_page_asks_nothing_of_the_network(full_text: str, full: Node) -> None:
    assert "http:" not in full_text
    assert "https:" not in full_text
    assert "@import" not in full_text
    for node in full.walk():
        for name in ("src", "href", "xlink:href", "action", "srcset", "poster"):
            assert re.match(r"#|data:,$", node.attributes.get(name, "#")), (node.tag, node.attributes)
    assert set(re.findall(r"url\(\s*['\"]?(.)", full_text)) <= {"#"}


def test_ids_are_unique_and_everything_pointed_at_exists(full: Node) -> None:
    ids = [node.attributes["id"] for node in full.walk() if "id" in node.attributes]
    assert len(ids) == len(set(ids))
    for node in full.walk():
        for name in ("href", "aria-labelledby"):
            for target in node.attributes.get(name, "").split():
                assert target == "data:," or target.removeprefix("#") in ids


def test_headings_descend_one_level_at_a_time_and_tables_have_captions(full: Node) -> None:
    levels = [int(node.tag[1]) for node in full.walk() if re.fullmatch(r"h[1-6]", node.tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    for table in full.all("table"):
        assert table.all("caption")[0].text
        assert all(cell.attributes.get("scope") in ("col", "row") for cell in table.all("th"))


def test_every_drawing_says_what_it_is(full: Node) -> None:
    drawings = [node for node in full.all("svg") if node.attributes.get("role") == "img"]
    assert len(drawings) == 4 * 5 + 1  # the worst moment on top
    for drawing in drawings:
        assert drawing.all("title")[0].text
        assert drawing.all("desc")[0].text
    assert all(figure.all("figcaption")[0].text for figure in full.all("figure"))


def test_every_ink_has_a_value_for_light_and_for_dark_paper() -> None:
    style = asset("report.css")
    light, dark = style.split("prefers-color-scheme: dark", 1)
    for ink in Ink:
        assert f"{ink.variable}:" in light, ink
        assert ink is Ink.PAPER or f"{ink.variable}:" in dark, ink  # follows the page's paper by itself


def test_the_same_runs_give_the_same_bytes() -> None:
    assert text_for([factory.holds_run()]) == text_for([factory.holds_run()])


def test_the_footer_says_that_it_is_no_certificate(full: Node) -> None:
    footer = full.all("footer")[0].text
    for expected in ("simulated", "no certificate", "contact forces", "fingers", "real sensors"):
        assert expected in footer


def test_the_defaults_are_the_reference_for_changed_settings() -> None:
    assert factory.holds_run().trace.scenario.settings == DEFAULTS


def test_a_scenario_with_faults_has_a_lane_and_a_note_for_each_and_its_robot_stands_among_the_changes() -> (
    None
):
    run = factory.holds_run()
    faults = (CameraBlind(from_s=1.0, for_s=0.5), JointStuck(joint=Joint.WRIST_1, from_s=2.0))
    ticks = run.trace.ticks.copy()
    ticks["faults"][125:188] = 1
    scenario = replace(run.trace.scenario, faults=faults, robot=Robot.UR5)
    page = text_for([replace(run, trace=replace(run.trace, scenario=scenario, ticks=ticks))])
    plain = text_for([run])
    assert "Fault: camera sees nothing, from 1 s until 1.5 s. It acted on 63 ticks, first at 1.000 s." in page
    assert "Fault: wrist 1 joint is stuck, from 2 s. It acted on 0 ticks, so it changed nothing." in page
    assert ">faults<" in page
    assert ">faults<" not in plain
    assert "Fault:" not in plain
    assert "UR5" in page
    assert "UR5" not in parse(plain).all("main")[0].text


def test_scenarios_of_one_matrix_are_told_apart() -> None:
    run = factory.holds_run()
    scenario = replace(run.trace.scenario, file=Path("visit.yaml"), name="visit[late,far]")
    of_matrix = replace(run, trace=replace(run.trace, scenario=scenario))
    assert "visit.yaml [late,far]" in text_for([of_matrix])


def test_how_often_each_claim_was_put_to_the_test_is_a_table(full: Node) -> None:
    (table,) = [node for node in full.all("table") if "In run" in [h.text for h in node.all("th")]]
    heads = [row.all("th")[0].text for row in table.all("tr")[1:]]
    assert len(heads) == len(set(heads)) > 0


def test_a_claim_that_was_never_put_to_the_test_is_said_in_a_banner() -> None:
    run = factory.no_hands_run()
    (claim,) = run.trace.scenario.claims
    expecting = replace(run.trace.scenario, claims=(replace(claim, expected=Verdict.HOLDS),))
    never = (replace(run.evaluations[0], exercised=0),)
    idle = replace(run, trace=replace(run.trace, scenario=expecting), evaluations=never)
    assert "Never put to the test" in text_for([idle])
    assert f"{idle.trace.scenario.name}: {never[0].reason}" in text_for([idle])
    knowing = replace(run.trace.scenario, claims=(replace(claim, expected=Verdict.INCONCLUSIVE),))
    silent = replace(idle, trace=replace(run.trace, scenario=knowing))
    assert "Never put to the test" not in text_for([silent])


def test_each_of_eight_hands_has_an_ink_of_its_own_in_the_key_and_in_the_drawings() -> None:
    run = factory.holds_run()
    hands = tuple(factory.hand(f"hand {number}") for number in range(1, 9))
    crowded = replace(run, trace=factory.trace(replace(run.trace.scenario, hands=hands)))
    page = text_for([crowded])
    drawings = "".join(re.findall(r"<svg.*?</svg>", page, re.DOTALL))
    for number in range(1, 9):
        assert f">hand {number}<" in page
        assert f"var(--fig-hand-{number})" in drawings
    assert "var(--fig-hand-3)" not in text_for([run])


def test_of_many_runs_those_that_matter_most_are_drawn() -> None:
    expected = factory.holds_run()
    runs = [replace(expected, trace_file=Path(f"traces/run {k}.trace")) for k in range(MOST_IN_FULL + 5)]
    runs[-2] = factory.violated_run()
    page = parse(text_for(runs))
    drawn = [bool(article.all("div", "drawing")) for article in page.all("article")]
    assert sum(drawn) == MOST_IN_FULL
    assert drawn[-2]
    (dropped, *_) = (k for k, is_drawn in enumerate(drawn) if not is_drawn)
    words = page.one(f"run-{dropped + 1}").text
    assert f"safety-harness judge 'traces/run {dropped}.trace' --out 'run {dropped}'" in words
    assert f"{MOST_IN_FULL} of {len(runs)} runs are drawn: first cut-short or unexpected runs" in page.text
