"""A recorded cell beside the worlds, as a report's credibility has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import page
import pytest
from made_up_comparison import SYSTEM, cell
from made_up_evidence import evidence
from typer.testing import CliRunner

from safety_harness.admission.driving import named_system
from safety_harness.base.shipped.contents import located
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.certification.argument import DONE, DOUBT, argument_of
from safety_harness.extensions.assurance.certification.credibility import NO_CELL, credibility_of
from safety_harness.extensions.assurance.certification.evidence import Evidence
from safety_harness.extensions.assurance.certification.findings import of_worlds
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.assurance.certification.tools import HarnessTrials, RecordedCell, read_cell
from safety_harness.extensions.field.recorded.compare import as_json
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import OwnRobot, Seat, StopTimes, YesNo
from safety_harness.trace.system import Component

OTHERS = [
    ("robot", replace(SYSTEM, robot=Component(name="UR5", sha256="5" * 64))),
    ("avoider", replace(SYSTEM, avoider=Component(name="mc-dropout", sha256="5" * 64))),
    ("controller", replace(SYSTEM, controller=Component(name="stop when near"))),
    ("settings", replace(SYSTEM, settings=Component(name="settings", sha256="5" * 64))),
]


def with_cells(*cells: RecordedCell) -> Evidence:
    whole = evidence(counterexamples=0)
    return replace(whole, credibility=replace(whole.credibility, cells=cells))


def test_the_page_has_what_was_compared_and_no_longer_says_that_nothing_was() -> None:
    text = render(with_cells(cell()), {})
    words = page.parse(text).text
    assert "Validation against a recorded cell" in words
    assert "0 verdicts of 1 differ" in words
    assert "elbow_joint: mean 0.115 deg (0.057 deg to 0.172 deg)" in words
    assert "not estimated: the joints stand" in words
    assert "does not compare the simulator with a real cell" not in words
    assert "Each comparison is about one recording only." in words


@pytest.mark.parametrize(
    ("one", "found", "state"),
    [
        (cell(), "", DONE),
        (cell(Verdict.VIOLATED), "1 of 1 verdicts of LOG.yaml differ in simulation", DOUBT),
        (cell(present=False), "held against LOG.yaml with another source", DOUBT),
        (cell(Verdict.INCONCLUSIVE), "", DOUBT),
        (cell(system=None), "which arm, controller and settings it is of is not noted", DOUBT),
        *(
            (cell(system=changed), f"no cell of the tested system: {name}: ", DOUBT)
            for name, changed in OTHERS
        ),
    ],
    ids=["same", "contradicted", "other source", "undecided", "not noted", *(name for name, _ in OTHERS)],
)
def test_a_contradicted_verdict_and_another_source_are_open_findings(
    one: RecordedCell, found: str, state: str
) -> None:
    whole = with_cells(one)
    findings = of_worlds(whole.credibility, whole.system.under_test)
    texts = [finding.text for finding in findings if finding.place == "recorded-cells"]
    assert len(texts) == bool(found)
    assert found in "".join(texts)
    leaves = [element for element in _every(argument_of(whole)) if element.text.startswith("A recorded cell")]
    assert [element.state for element in leaves] == [state]


SAID = [  # of the same URDF: all but where its files lie makes another arm
    ({"tool": None}, "robot: "),
    ({"seat": Seat(yaw_rad=0.1)}, "robot: "),
    ({"soft_limits": YesNo.YES}, "robot: "),
    ({"braking": StopTimes(reaction_time_s=0.1, stop_time_s=0.9)}, "robot: "),
    ({"capsules_sha256": "5" * 64}, "robot: "),
    ({"capsules": "elsewhere/iiwa14.capsules.json", "files": ()}, ""),
]


@pytest.mark.parametrize(("said", "found"), SAID, ids=[next(iter(one)) for one, _ in SAID])
def test_an_own_arm_is_the_same_with_its_tool_seat_limits_and_capsules_only(
    said: dict[str, object], found: str
) -> None:
    scenario = read_scenario(located("shipped:robot-iiwa14"))
    assert isinstance(scenario.robot, OwnRobot)
    other = replace(scenario, robot=replace(scenario.robot, **said))  # type: ignore[arg-type]
    foreign = cell(system=named_system(other)).foreign_to([named_system(scenario)])
    assert foreign[: len("robot: ")] == found


def _every(element: object) -> list[object]:
    below = (*element.beside, *element.below)  # type: ignore[attr-defined]
    return [element, *(one for child in below for one in _every(child))]


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "compare-worlds.json"
    for one in (cell(), cell(present=False)):
        file.write_text(as_json(one.comparison))
        read = read_cell(file)
        assert read.comparison == one.comparison
        assert read.present == one.present


def test_only_a_report_without_one_says_that_no_real_cell_was_measured() -> None:
    assert NO_CELL in credibility_of([], HarnessTrials()).absent
    known = credibility_of([], HarnessTrials(cells=(cell(),)))
    assert NO_CELL not in known.absent
    assert known.cells == (cell(),)


def test_what_is_no_comparison_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    file = tmp_path / "compare-worlds.json"
    file.write_text("{}")
    words = ["certify", "shipped:plans/certify-in-a-minute.yaml", "--cell", str(file)]
    found = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "report")])
    assert found.exit_code == 2
    assert "safety-harness recorded cell 1" in found.output
    assert not (tmp_path / "report").exists()
