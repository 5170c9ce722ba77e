"""A controller in a Python file, in a process of its own: what goes wrong there costs an episode."""

from __future__ import annotations

import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import Admitted, Admitter, admit
from safety_harness.admission.trial import run_all, run_kinematic
from safety_harness.base.exceptions import ControllerError, InadmissibleError
from safety_harness.cell.controller.out_of_process.remote import RemoteController
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Mode

WALL_LIMIT_S = 0.5
MINE = """
import ctypes, os, signal, sys, time
import numpy as np
from safety_harness import Move, Report, Stop
from safety_harness.seams.contract import Decision
from safety_harness.trace.records import DecisionOutcome, Mode

class Sees:
    name = "sees all"
    sees = ("joints", "hands", "hand boxes", "object", "predicted hands")
    reports = ("mode", "decisions", "doubt")
    def reset(self, *, settings, arm, start, seed):
        self.told = [*arm.joint_names, arm.velocity_limit_radps.sum(), start.joint_position_rad.sum(), seed]
        self.gain = settings.servo.gain_far
        self.ticks = 0
    def act(self, seen):
        self.ticks += 1
        numbers = [seen.hand_boxes.boxes.sum(), np.nan_to_num(seen.object.feature_error).sum()]
        numbers += [one.covariance.sum() + one.number for one in seen.predicted_hands]
        numbers += [one.position_in_base_m.sum() for one in seen.hands]
        decision = None
        if self.ticks == 30:
            hand = seen.predicted_hands[0].position_in_base_m
            decision = Decision(hand_position_in_base_m=hand, proposed_position_in_base_m=hand + 0.1,
                                chosen_position_in_base_m=hand + 0.1, spread_m=np.full(3, 0.002),
                                spread_threshold_m=0.01, outcome=DecisionOutcome.PROPOSED)
        report = Report(mode=Mode.REPULSING if self.ticks > 30 else Mode.SERVOING, decision=decision)
        if self.ticks > 50:
            return Stop(report=report)
        v = 1e-3 * np.cos(np.arange(len(seen.joint_position_rad)) + sum(numbers) + seen.time_s)
        return Move(joint_velocity_radps=v * self.gain, report=report)

class Bad:
    name, sees, episodes = "bad", ("joints",), 0
    def reset(self, *, settings, arm, start, seed):
        self.seed, self.ticks = seed, 0
        Bad.episodes += 1
    def act(self, seen):
        self.ticks += 1
        print("what it prints is no answer")
        if self.ticks == 3:
            with open(__file__ + ".what") as what:
                return getattr(self, what.read())()
        return Move(tcp_velocity_mps=[0, 0, 0.01])
"""
LACKING = """
class Mine:
    name, sees = "mine", ()
    def reset(self, **start): ...
"""
NOISE = """for fd in range(3, 500):
        try: os.write(fd, b'noise' * 20)
        except OSError: pass"""
LONG = NOISE.replace("b'noise' * 20", "b'AVO2' + b'\\xff' * 4")
BAD = {
    "leave": ("import os; os._exit(4)", "act: its process ended with exit status 4"),
    "crash": ("import ctypes; ctypes.string_at(0)", "act: its process was ended by SIGSEGV"),
    "hang": ("while True: pass", f"act: it gave no answer within {WALL_LIMIT_S:g} s of wall time"),
    "memory": ("bytearray(5 << 30)", "act raised: MemoryError"),
    "object": (
        "return Move(tcp_velocity_mps=object())",
        "returned a tcp_velocity_mps other than real",
    ),
    "words": (
        "return Move(tcp_velocity_mps=['a', 'b', 'c'])",
        "returned a tcp_velocity_mps other than real",
    ),
    "many": ("return Move(joint_velocity_radps=np.zeros(100_000))", "float64 of the shape (100000,)"),
    "noise": (NOISE, "nonsense"),
    "long": (LONG, "nonsense"),
}


def driven_by(reference: str, plain: Scenario | None = None) -> Scenario:
    """A scenario of a few ticks, with a short wall limit."""
    plain = plain or scenario(duration_s=0.04)
    clock = replace(plain.settings.clock, wall_limit_s=WALL_LIMIT_S)
    settings = replace(plain.settings, clock=clock)
    return replace(plain, settings=settings, controller=reference, avoider=NO_AVOIDER)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the file, in which a method of ``Bad`` is one of ``BAD``."""
    folder = tmp_path_factory.mktemp("python-files")
    ways = "".join(f"    def {name}(self):\n     {code}\n" for name, (code, _) in BAD.items())
    (folder / "mine.py").write_text(MINE + ways + "    def good(self): return Stop()\n")
    return folder


@pytest.fixture(scope="module")
def bad(folder: Path) -> Admitted:
    """The one that ``what`` tells how to be."""
    return Admitter().admit(driven_by(f"{folder / 'mine.py'}:Bad"))


def test_all_that_is_seen_and_reported_goes_through_the_pipe(folder: Path) -> None:
    plain = scenario(VISIT, duration_s=0.8)
    there = run_kinematic(Admitter().admit(driven_by(f"{folder / 'mine.py'}:Sees", plain)))
    found: dict[str, type] = {}
    exec(MINE, found)
    here = run_kinematic(admit(replace(plain, settings=there.scenario.settings), controller=found["Sees"]()))
    assert first_difference(here, there) is None
    assert len(there.decisions) == 1
    assert (there.ticks["mode"] == Mode.REPULSING).any()
    assert np.ptp(there.ticks["joint_position_rad"], axis=0).max() > 0


@pytest.mark.parametrize("what", [*BAD])
def test_what_it_does_costs_its_episode_alone(folder: Path, bad: Admitted, what: str) -> None:
    (folder / "mine.py.what").write_text(what)
    with pytest.raises(ControllerError) as failed:
        run_kinematic(bad)
    assert BAD[what][1] in str(failed.value)
    assert "Traceback" not in str(failed.value)
    (folder / "mine.py.what").write_text("good")
    assert len(run_kinematic(bad).ticks) == bad.scenario.ticks + 1


def test_in_a_campaign_the_others_run_once(folder: Path) -> None:
    (folder / "mine.py.what").write_text("object")
    three = [Admitter().admit(driven_by(f"{folder / 'mine.py'}:{name}")) for name in ("Sees", "Bad", "Sees")]
    first, second, third = run_all(three, KINEMATIC)
    assert isinstance(second, ControllerError)
    assert not isinstance(first, Exception)
    assert not isinstance(third, Exception)
    assert first_difference(first, third) is None


def test_a_file_is_executed_elsewhere(folder: Path, bad: Admitted, caplog: pytest.LogCaptureFixture) -> None:
    assert bad.driver is not None
    assert isinstance(bad.driver.controller, RemoteController)
    assert not any(str(getattr(one, "__file__", "")).endswith("mine.py") for one in sys.modules.values())
    (folder / "mine.py.what").write_text("good")
    with caplog.at_level(logging.WARNING):
        assert run_kinematic(Admitter().admit(bad.scenario)).complete
    assert "mine.py wrote: what it prints is no answer" in caplog.text


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("raise ValueError('no')", "ValueError: no"),
        ("import os; os._exit(0)", "ended with exit status 0"),
        (LACKING, "method act"),
        (LACKING + "    sees = ('truth',)\n    def act(self, seen): ...\n", "truth"),
    ],
)
def test_a_file_without_a_controller_is_refused(tmp_path: Path, source: str, why: str) -> None:
    (tmp_path / "mine.py").write_text(source)
    with pytest.raises(InadmissibleError) as refused:
        Admitter().admit(driven_by(f"{tmp_path / 'mine.py'}:Mine"))
    assert why in str(refused.value)
