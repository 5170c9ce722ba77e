"""Users' controllers in lanes: the traces of one by one, bit for bit, and what one does costs its own run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, hand, scenario
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.repeatability import Repeatability
from safety_harness.admission.trial import run_all, run_kinematic, run_many
from safety_harness.base.exceptions import ControllerError
from safety_harness.cell.controller.answers import LaneAnswers, columns_of
from safety_harness.cell.controller.stop_when_near import StopWhenNear
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.scenario.faults import HandSensorBlind
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.scenario.moves import MoveTo
from safety_harness.scenario.shield import Shield
from safety_harness.seams.contract import Move, Moves, Seen, Stop
from safety_harness.seams.rows import SeenLayout
from safety_harness.trace.compare import first_difference
from safety_harness.trace.trace import Trace

FILE = """
import os
import numpy as np
from safety_harness import Move, Stop
from safety_harness.seams.contract import Moves

class Plain:
    name, sees = "plain", ("joints", "hands")
    def reset(self, *, settings, arm, start, seed):
        self.ticks, self.gain, self.seed = 0, 1e-3 * (seed % 7), seed
    def act(self, seen):
        self.ticks += 1
        return Move(joint_velocity_radps=self.gain * np.cos(seen.joint_position_rad + 0.1 * self.ticks))

class Together(Plain):
    name = "together"
    def act_many(controllers, seen):
        for one in controllers: one.ticks += 1
        ticks = np.array([[0.1 * one.ticks] for one in controllers])
        gain = np.array([[one.gain] for one in controllers])
        return Moves(joint_velocity_radps=gain * np.cos(seen["joint_position_rad"] + ticks))

class Otherwise(Together):
    name = "otherwise"
    def act_many(controllers, seen):
        return Moves(stop=np.ones(len(controllers), bool))

class Amiss(Together):
    name = "amiss"
    def act_many(controllers, seen):
        return Moves(tcp_velocity_mps=np.zeros(3))

class Bad(Plain):
    name = "bad"
    def act(self, seen):
        if self.gain > 3e-3 and self.ticks == 2:
            return self.fail()
        return super().act(seen)

class Raises(Bad):
    def fail(self): raise ValueError(f"gain {self.gain}")

class Nan(Bad):
    def fail(self): return Move(tcp_velocity_mps=[0.0, float("nan"), 0.0])

class Words(Bad):
    def fail(self): return Move(tcp_velocity_mps=["a", "b", "c"])

class Leaves(Bad):
    def fail(self): os._exit(3)
"""
EXAMPLE = f"{Path(__file__).parents[3] / 'examples' / 'stop_and_go_together.py'}:StopAndGo"
OTHER = hand(MoveTo(position_in_base_m=(0.85, 0.3, 0.3), speed_mps=1.2), at=(1.2, 0.8, 0.3), name="left")


def driven_by(controller: str, *plain: Scenario) -> list[Admitted]:
    """Admitted once, so that they share their controllers."""
    admitter = Admitter()
    return [
        admitter.admit(replace(one, controller=controller, avoider=NO_AVOIDER, name=f"{one.name} {k}"))
        for k, one in enumerate(plain)
    ]


def varied() -> list[Scenario]:
    """Short and long, with none to two hands, a fault, a shield."""
    blind = (HandSensorBlind(from_s=0.05, for_s=0.1),)
    return [
        scenario(VISIT, duration_s=0.4, seed=1),
        scenario(duration_s=0.08, seed=2),
        scenario(VISIT, OTHER, duration_s=0.3, seed=3),
        replace(scenario(VISIT, duration_s=0.2, seed=4), faults=blind),
        replace(scenario(VISIT, duration_s=0.2, seed=5), shield=Shield()),
        scenario(OTHER, duration_s=0.16, seed=6),
    ]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("lanes") / "mine.py"
    file.write_text(FILE)
    return file


def assert_alike(found: Sequence[Trace | Exception], expected: Sequence[Trace | Exception]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        if isinstance(other, Exception):
            assert str(one) == str(other)
            continue
        assert isinstance(one, Trace), one
        assert first_difference(one, other) is None
        assert one.system == other.system


def one_by_one(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
    found: list[Trace | Exception] = []
    for one in admitted:
        try:
            found.append(run_kinematic(one))
        except ControllerError as error:
            found.append(error)
    return found


@pytest.mark.parametrize("who", ["stop when near", "Plain", "Together", EXAMPLE])
def test_lanes_are_the_runs_one_by_one(file: Path, who: str) -> None:
    admitted = driven_by(f"{file}:{who}" if who.isalpha() else who, *varied())
    expected = one_by_one(admitted)
    assert not any(isinstance(one, Exception) for one in expected)
    assert_alike(list(run_all(admitted, KINEMATIC)), expected)
    assert_alike(list(run_many(admitted[::-1])), expected[::-1])


@pytest.mark.parametrize(
    ("who", "why"),
    [
        ("Raises", "ValueError: gain"),
        ("Nan", "not finite"),
        ("Words", "real numbers"),
        ("Leaves", "exit status 3"),
    ],
)
def test_what_one_does_costs_its_own_run_with_the_same_words(file: Path, who: str, why: str) -> None:
    admitted = driven_by(f"{file}:{who}", *varied()[:4])
    expected = one_by_one(admitted)
    failed = [one for one in expected if isinstance(one, Exception)]
    assert 0 < len(failed) < len(expected)
    assert all(why in str(one) for one in failed)
    assert_alike(list(run_all(admitted, KINEMATIC)), expected)


def test_an_act_many_that_answers_amiss_is_not_believed(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    admitted = driven_by(f"{file}:Amiss", *varied()[:3])
    assert_alike(list(run_all(admitted, KINEMATIC)), one_by_one(admitted))
    assert "other than real numbers of the shape" in caplog.text


def test_an_act_many_that_is_not_act_is_named(file: Path) -> None:
    again = Repeatability()
    for run in run_many(driven_by(f"{file}:Otherwise", *varied()[:2])):
        again.add(run)
    found = again.check()
    assert found.differing == 2
    assert "act_many" in found.words


NUMBERS = st.floats(-1.0, 1.0)


@settings(max_examples=30)
@given(st.lists(st.tuples(*[NUMBERS] * 9), min_size=1, max_size=5), st.floats(0.05, 1.5), st.integers(0, 2))
def test_stop_when_near_answers_together_as_one_by_one(
    drawn: list[tuple[float, ...]], near_m: float, hands: int
) -> None:
    layout = SeenLayout(2, 6, StopWhenNear.sees)
    rows = np.zeros((len(drawn), layout.wanted))
    controllers = [StopWhenNear() for _ in drawn]
    for row, controller, numbers in zip(rows, controllers, drawn, strict=True):
        axis = np.array(numbers[:3])
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, :3] += 0.1 * np.cross(np.eye(3), axis)
        pose[:3, 3] = numbers[3:6]
        row[13:29], row[29:32] = pose.reshape(-1), numbers[3:6]
        row[32:33].view(np.int64)[0] = hands
        row[33:36], row[36:39] = numbers[6:9], numbers[:3]
        controller._target_in_base_m, controller._gain, controller._near_m = axis, numbers[0], near_m
        controller._numbers = (*axis.tolist(), numbers[0], near_m)
    together, apart = LaneAnswers(len(drawn), 6, ("mode",)), LaneAnswers(len(drawn), 6, ("mode",))
    moves = StopWhenNear.act_many(controllers, columns_of(rows, 0.008, layout))
    together.take_many(range(len(drawn)), moves)
    for lane, (controller, row) in enumerate(zip(controllers, rows, strict=True)):
        action = controller.act(Seen.of_row(0.0, 0.008, layout, row))
        assert isinstance(action, Move | Stop)
        apart.take(lane, action)
    for one, other in zip(together.columns, apart.columns, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize(
    ("moves", "why"),
    [
        (Stop(), "no Moves"),
        (Moves(tcp_velocity_mps=np.zeros((3, 3))), r"shape \(2, 3\)"),
        (Moves(stop=np.zeros(2)), "2 truths"),
        (
            Moves(tcp_velocity_mps=np.zeros((2, 3)), joint_velocity_radps=np.zeros((2, 6))),
            "of both the TCP and the joints",
        ),
    ],
)
def test_moves_that_are_none_are_refused(moves: object, why: str) -> None:
    with pytest.raises(ControllerError, match=why):
        LaneAnswers(2, 6, ()).take_many([0, 1], moves)
    with pytest.raises(ControllerError, match="reported no Mode"):
        LaneAnswers(2, 6, ("mode",)).take_many([0, 1], Moves(mode=np.array([0, 9])))
