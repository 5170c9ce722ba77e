"""A question as a scenario file: a run of it asks that question first, or there is no file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import resolve_avoider, scenario_of_avoider
from safety_harness.admission.trial import run_trial
from safety_harness.cell.avoidance.avoider import Avoider, AvoiderAround, Proposal
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.lab.scoring.question_file import QuestionFile, question_file, seed_of
from safety_harness.extensions.lab.scoring.session import CLAIMS
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import Robot

HAND, TCP = np.array([0.83, -0.22, 0.21]), np.array([0.69, 0.02, 0.33])


def made(
    folder: Path,
    hand: np.ndarray = HAND,
    tcp: np.ndarray = TCP,
    seed: int = 5,
    avoider: Avoider | None = None,
) -> QuestionFile:
    avoider = avoider or resolve_avoider(scenario_of_avoider("mc-dropout"))
    options = {"title": "a question", "description": "for a test", "claims": CLAIMS}
    return question_file(folder / "worst.yaml", "mc-dropout", avoider, hand, tcp, seed, **options)  # type: ignore[arg-type]


def test_a_run_of_the_file_asks_the_question_first_with_its_seed(tmp_path: Path) -> None:
    file = made(tmp_path)
    assert file.path is not None
    file.path.write_text(file.text)
    scenario = read_scenario(file.path)
    trace = run_trial(admit(scenario), world=KINEMATIC)
    first = trace.decisions[0]
    assert first["time_s"] == 0.0
    assert np.abs(first["hand_position_in_base_m"] - HAND).max() < 0.001
    assert np.abs(first["tcp_position_in_base_m"] - TCP).max() < 1e-9
    assert first["seed"] == seed_of(5)
    assert len(trace.decisions) == 1
    expected = {claim.sentence: claim.expected for claim in scenario.claims}
    found = {one.sentence: one.evaluate(trace).verdict for one in admit(scenario).properties}
    assert expected == found
    assert set(expected.values()) <= {Verdict.HOLDS, Verdict.VIOLATED}


def test_a_question_of_a_ur5_s_cell_is_asked_by_a_ur5(tmp_path: Path) -> None:
    scenario = read_scenario(Path(__file__).parents[3] / "scenarios" / "robot-ur5.yaml")
    file = question_file(
        tmp_path / "worst.yaml",
        "opposite pose",
        resolve_avoider(scenario_of_avoider("opposite pose")),
        np.array([0.62, -0.25, 0.2]),
        np.array([0.5, 0.0, 0.28]),
        5,
        title="a question",
        description="for a test",
        claims=CLAIMS,
        settings=scenario.settings,
        robot=scenario.robot,
    )
    assert file.path is not None, file.remark
    file.path.write_text(file.text)
    assert read_scenario(file.path).robot is Robot.UR5


def test_an_avoider_that_takes_its_time_is_asked_the_question_all_the_same(tmp_path: Path) -> None:
    @dataclass(frozen=True, eq=False)
    class Slow(AvoiderAround):
        decision_time_s: float = 0.08

        def propose(self, **question: Any) -> Proposal:
            return self.avoider.propose(**question)

    slow = Slow(resolve_avoider(scenario_of_avoider("mc-dropout")))
    aside = TCP + [0.05, 0.1, 0.05]  # from where the arm servos while it waits
    assert made(tmp_path, tcp=aside, avoider=slow).path is not None


def test_a_tcp_from_which_the_object_is_out_of_view_gets_another_place_of_the_object(tmp_path: Path) -> None:
    aside = np.array([0.78, 0.26, 0.16])
    file = made(tmp_path, hand=aside + [0.25, 0.0, 0.0], tcp=aside)
    assert file.path is not None
    assert "object:" in file.text
    assert "object:" not in made(tmp_path).text


@pytest.mark.parametrize(
    ("hand", "why"),
    [(TCP + [0.0, 0.0, 0.05], "inside"), (TCP + [0.45, 0.0, 0.0], "has no question")],
    ids=["within the arm", "beyond the critical distance"],
)
def test_a_question_with_which_no_run_begins_has_no_file_and_a_reason(
    tmp_path: Path, hand: np.ndarray, why: str
) -> None:
    file = made(tmp_path, hand=hand)
    assert file.path is None
    assert why in file.remark
