"""A controller whose answers cost simulated time: until an answer counts, the last one goes on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from hashlib import sha256
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic, run_many, run_trial
from safety_harness.base.exceptions import ControllerError, InadmissibleError
from safety_harness.base.settings import DecisionCost, DecisionTimes, Measured
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.report.decisions import computing_time_lines
from safety_harness.scenario.model import NO_AVOIDER, Driver, Scenario
from safety_harness.seams.contract import Decision, Move, Report, Seen, Stop, acts_per_answer_of, reports_of
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

PERIOD_S, TICKS = 0.008, 75  # of the run
WORLDS = pytest.mark.parametrize("world", [KINEMATIC, PYBULLET], ids=str)


@dataclass
class Counts:
    """Its n-th call turns every joint at n mrad/s, in an array that it uses again."""

    name: str = "counts"
    sees: tuple[str, ...] = ("joints",)
    reports: tuple[str, ...] = ("mode", "decisions")
    acts_per_answer: int = 1
    asked_s: list[float] = field(default_factory=list)
    speeds: Any = field(default_factory=lambda: np.zeros(6))
    place: Any = field(default_factory=lambda: np.zeros(3))

    def reset(self, **_: Any) -> None:
        self.asked_s = []

    def act(self, seen: Seen) -> Move | Stop:
        self.asked_s.append(seen.time_s)
        self.speeds[:] = 1e-3 * len(self.asked_s)
        self.place[:] = len(self.asked_s)
        decision = Decision(
            hand_position_in_base_m=self.place,
            proposed_position_in_base_m=self.place,
            chosen_position_in_base_m=self.place,
        )
        report = Report(mode=Mode(len(self.asked_s) % 2), decision=decision)
        return Move(joint_velocity_radps=self.speeds, report=report)


def timed(cost: Any, case: Scenario | None = None) -> Scenario:
    """A scenario in which answers cost ``cost``: a number [s], several quantiles [s], or anything else."""
    case = case or replace(scenario(duration_s=PERIOD_S * TICKS), avoider=NO_AVOIDER)
    if isinstance(cost, float | tuple):
        cost = DecisionTimes(quantiles_s=(cost,) if isinstance(cost, float) else cost)
    avoidance = replace(case.settings.avoidance, decision_time=cost)
    return replace(case, settings=replace(case.settings, avoidance=avoidance))


def run_of(cost: Any, controller: Any, world: WorldEntry = KINEMATIC) -> Trace:
    return run_trial(admit(timed(cost), controller=controller), world=world)


def expected(waits: int, acts: int) -> list[int]:
    """The call whose answer holds at each tick, by a clock of its own; 0: none so far."""
    held, calls, arrives = [0], 0, -1
    for tick in range(TICKS + 1):
        now = held[-1]
        if tick == arrives:
            now, arrives = calls, -1
            if calls % acts:
                held.append(now)
                continue
        if arrives < 0:
            calls += 1
            if calls % acts == 1 % acts and waits:
                arrives = tick + waits
            else:
                now = calls
        held.append(now)
    return held[1:]


@WORLDS
@pytest.mark.parametrize("acts", [1, 4])
@pytest.mark.parametrize("cost_s", [0.008, 0.04, 0.041, 0.056])
def test_an_answer_counts_after_its_time_and_lasts_until_the_next(
    world: WorldEntry, cost_s: float, acts: int
) -> None:
    controller = Counts(acts_per_answer=acts)
    trace = run_of(cost_s, controller, world)
    waits = {0.008: 1, 0.04: 5, 0.041: 6, 0.056: 7}[cost_s]
    held = np.array(expected(waits, acts))
    assert np.array_equal(trace.ticks["demanded_joint_velocity_radps"], 1e-3 * held[:, None] + np.zeros(6))
    told = held > 0
    assert np.array_equal(trace.ticks["mode"][told], held[told] % 2)
    ticks = np.flatnonzero(np.diff(held, prepend=0))
    assert np.array_equal(trace.decisions["tick"], ticks)
    assert np.array_equal(trace.decisions["chosen_position_in_base_m"], held[ticks, None] + np.zeros(3))
    if acts == 1:
        assert controller.asked_s == pytest.approx(PERIOD_S * waits * np.arange(1 + TICKS // waits))


@WORLDS
def test_no_time_changes_no_bit(world: WorldEntry) -> None:
    runs = [run_of(cost, Counts(), world) for cost in (DecisionCost.AS_DECLARED, 0.0)]
    for ticks in ("ticks", "decisions"):
        first, second = (getattr(run, ticks) for run in runs)
        assert all(first[name].tobytes() == second[name].tobytes() for name in first.dtype.names)
    assert runs[0].ticks["demanded_joint_velocity_radps"][0, 0] == 1e-3


def test_drawn_times_are_of_the_seed_and_each_is_the_ticks_between_two_calls() -> None:
    first, second = (Counts(), Counts())
    runs = [run_of((0.005, 0.05), one) for one in (first, second)]
    assert first_difference(*runs) is None
    waits = np.diff(first.asked_s) / PERIOD_S
    assert first.asked_s == second.asked_s
    assert {*np.round(waits)} <= {*range(1, ceil(0.05 / PERIOD_S) + 1)}
    assert len({*np.round(waits)}) > 2


@WORLDS
def test_a_stop_waits_and_lasts_like_any_answer(world: WorldEntry) -> None:
    class Stops(Counts):
        def act(self, seen: Seen) -> Move | Stop:
            return super().act(seen) if not 0.19 < seen.time_s < 0.21 else Stop(report=Report(mode=Mode(2)))

    moves = run_of(0.04, Stops(), world).ticks["mode"]
    assert [*np.flatnonzero(moves == 2)] == [*range(30, 35)]


def test_every_part_of_an_answer_is_of_the_view_that_the_answer_was_computed_from() -> None:
    """A controller that claims more parts than it has gains nothing: what it sees only grows older."""

    class Looks(Counts):
        def act(self, seen: Seen) -> Move:
            return Move(joint_velocity_radps=np.full(6, 1e-3 * seen.time_s))

    trace = run_of(0.024, Looks(acts_per_answer=4, reports=()))
    seen_s = 1e3 * trace.ticks["demanded_joint_velocity_radps"][:, 0]
    cycle = [PERIOD_S * 7 * (k // 7) for k in range(TICKS + 1)]  # three ticks of computing and four parts
    assert seen_s[3:] == pytest.approx(cycle[: TICKS - 2])
    forever = (
        1e3 * run_of(0.024, Looks(acts_per_answer=100_000, reports=())).ticks["demanded_joint_velocity_radps"]
    )
    assert not forever.any()  # all is of the view at 0 s


def test_the_parts_of_an_answer_are_timed_together() -> None:
    trace = run_of(0.024, Counts(acts_per_answer=4))
    assert len(trace.answer_s) == len(run_of(0.056, Counts()).answer_s)


def test_many_runs_are_each_as_alone() -> None:
    cases = [timed((0.005, 0.05), replace(timed(0.0), seed=seed)) for seed in (1, 2, 3)]
    runs = run_many([admit(case, controller=Counts()) for case in cases], world=KINEMATIC)
    for case, run in zip(cases, runs, strict=True):
        assert first_difference(run, run_trial(admit(case, controller=Counts()), world=KINEMATIC)) is None


def test_slow_answers_let_a_hand_come_nearer() -> None:
    """The time matters: the shipped controller that stops keeps less distance, the longer an answer takes."""
    case = replace(scenario(VISIT), avoider=NO_AVOIDER, controller="stop when near")
    least_m = [
        float(run_kinematic(admit(timed(cost_s, case))).ticks["hand_distance_m"].min())
        for cost_s in (0.0, 0.2, 0.6)
    ]
    assert least_m[0] > least_m[1] + 0.001
    assert least_m[1] > least_m[2] + 0.001


def test_what_is_said_of_the_time() -> None:
    (line,) = computing_time_lines([run_of(0.04, Counts())])
    assert line == "counts: 40 ms an answer"
    (line,) = computing_time_lines([run_of((0.005, 0.05), Counts())])
    assert line == "counts: 5 ms to 50 ms, drawn for each answer"
    (line,) = computing_time_lines([run_of(0.0, Counts())])
    assert line == "counts: computing time not modelled"


def test_what_is_said_of_the_time_is_said_behind_a_safety_filter_too(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("""
class Passes:
    name, sees = "passes", ("wanted command",)

    def reset(self, **start):
        pass

    def act(self, seen):
        return seen.wanted_command.action
""")
    case = replace(timed(0.04), controller="stop when near", safety_filter=f"{tmp_path / 'mine.py'}:Passes")
    assert computing_time_lines([run_kinematic(admit(case))]) == ["stop when near: 40 ms an answer"]


def test_an_error_of_an_answer_names_the_call() -> None:
    class Fails(Counts):
        def act(self, seen: Seen) -> Move:
            return Move(joint_velocity_radps=np.zeros(2), report=Report(mode=Mode(0)))

    with pytest.raises(ControllerError, match=r"'counts': act returned a joint_velocity_radps.* at 0\.000 s"):
        run_of(0.04, Fails())


def test_a_time_of_the_clock_and_a_profile_of_another_are_refused() -> None:
    with pytest.raises(InadmissibleError, match="because runs of a controller have to repeat"):
        run_of(DecisionCost.WALL_CLOCK, Counts())
    measured = Measured(avoider="other.py:C", sha256="ab" * 32, machine="here", questions=9)
    profile = DecisionTimes(quantiles_s=(0.01, 0.02), measured=measured)
    case = timed(profile, replace(timed(0.0), controller="stop when near"))
    with pytest.raises(InadmissibleError, match="a profile of stop when near, as its file is now") as refused:
        admit(case)
    assert "safety-harness time --controller 'stop when near' --out FILE.json" in str(refused.value)


def test_a_profile_of_another_class_of_the_file_is_refused(tmp_path: Path) -> None:
    text = "class A:\n    name, sees, reset = 'a', ('joints',), lambda self, **start: None\n"
    file = tmp_path / "mine.py"
    file.write_text(f"{text}    def act(self, seen): return 1\n\n\nclass B(A): pass\n")
    measured = Measured(
        avoider="mine.py:A", sha256=sha256(file.read_bytes()).hexdigest(), machine="here", questions=9
    )
    profile = DecisionTimes(quantiles_s=(0.01, 0.02), measured=measured)
    cases = [replace(timed(profile), controller=Driver(f"{file}:{name}")) for name in "AB"]
    assert admit(cases[0]).driver is not None
    with pytest.raises(InadmissibleError, match=r"a profile of .*mine\.py:B"):
        admit(cases[1])


@pytest.mark.parametrize("count", [0, -1, 1.5, "4", True])
def test_a_count_of_calls_that_is_none_is_refused(count: Any) -> None:
    with pytest.raises(ControllerError, match="acts_per_answer must be a whole number of at least 1"):
        acts_per_answer_of(Counts(acts_per_answer=count))


def test_a_delay_that_a_controller_declares_is_refused_with_the_key_that_states_it() -> None:
    class Slow(Counts):
        decision_time_s = 0.08

    with pytest.raises(ControllerError, match=r"avoidance: \{decision time: 40 ms\}"):
        reports_of(Slow())


def test_a_file_s_chunk_costs_time_once(tmp_path: Path) -> None:
    text = """
from safety_harness import Move


class Chunks:
    name, sees, acts_per_answer = "chunks", ("joints",), 4

    def reset(self, **start):
        self.calls = 0

    def act(self, seen):
        self.calls += 1
        return Move(joint_velocity_radps=[1e-3 * self.calls] * 6)
"""
    (tmp_path / "mine.py").write_text(text)
    case = replace(timed(0.04), controller=Driver(f"{tmp_path / 'mine.py'}:Chunks"))
    speeds = run_trial(admit(case), world=KINEMATIC).ticks["demanded_joint_velocity_radps"][:, 0]
    assert np.array_equal(speeds, 1e-3 * np.array(expected(5, 4)))
