from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, ConstantSpeed, scenario

from safety_harness.admission.admit import admit
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.cell.simulation.simulate import INTERRUPTED, simulate
from safety_harness.scenario.model import Scenario
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace


def simulated(
    what: Scenario,
    *,
    on_tick: Callable[[int], None] | None = None,
    before_step: Callable[[int], None] | None = None,
) -> Trace:
    admitted = admit(what)
    with PyBulletWorld(what, admitted.arm, admitted.joint_position_rad) as world:
        if before_step is not None:
            step, done = world.step, iter(range(10**6))

            def watched(command: np.ndarray) -> bool:
                before_step(next(done))
                return step(command)

            world.step = watched  # type: ignore[method-assign]
        return simulate(world, admitted.controller(), what, on_tick=on_tick)


def interrupt_at(tick: int) -> Callable[[int], None]:
    def interrupt(done: int) -> None:
        if done == tick:
            raise KeyboardInterrupt

    return interrupt


@pytest.mark.parametrize(("duration_s", "ticks"), [(0.008, 1), (0.4, 50), (0.401, 51), (0.1, 13)])
def test_both_ends_of_the_duration_are_recorded(duration_s: float, ticks: int) -> None:
    what = scenario(duration_s=duration_s)
    trace = simulated(what)
    assert what.ticks == ticks
    assert len(trace.ticks) == ticks + 1
    assert trace.complete
    assert trace.time_s == pytest.approx(DEFAULTS.clock.control_period_s * np.arange(ticks + 1), abs=1e-12)
    assert trace.time_s[-1] >= duration_s - 1e-12


def test_the_first_record_is_the_start_before_anything_moved() -> None:
    what = scenario(duration_s=0.1)
    trace = simulated(what)
    assert trace.ticks["joint_position_rad"][0] == pytest.approx(admit(what).joint_position_rad, abs=1e-12)
    assert not trace.ticks["joint_velocity_radps"][0].any()


def test_progress_is_told_tick_by_tick() -> None:
    told: list[int] = []
    simulated(scenario(duration_s=0.1), on_tick=told.append)
    assert told == list(range(1, 15))


def test_ctrl_c_gives_a_truncated_trace_that_says_so() -> None:
    what = scenario(VISIT, duration_s=1.2)
    whole, cut = simulated(what), simulated(what, on_tick=interrupt_at(120))
    assert cut.ended == INTERRUPTED
    assert not cut.complete
    assert len(cut.ticks) == 120
    assert cut.ticks.tobytes() == whole.ticks[:120].tobytes()


def test_ctrl_c_before_the_first_tick_leaves_an_empty_trace() -> None:
    trace = simulated(scenario(duration_s=0.1), before_step=interrupt_at(0))
    assert len(trace.ticks) == 0
    assert trace.ended == INTERRUPTED


def test_ctrl_c_in_the_tick_of_a_decision_leaves_no_decision_without_its_tick() -> None:
    what = scenario(VISIT, duration_s=1.2)
    at = int(simulated(what).decisions["tick"][0])
    cut = simulated(what, before_step=interrupt_at(at))
    assert len(cut.ticks) == at
    assert len(cut.decisions) == 0
    after = simulated(what, on_tick=interrupt_at(at + 1))
    assert len(after.decisions) == 1
    assert after.ticks["decision"][-1] == 0


def test_even_after_the_last_tick_ctrl_c_is_not_a_complete_run() -> None:
    what = scenario(duration_s=0.1)
    trace = simulated(what, on_tick=interrupt_at(what.ticks + 1))
    assert len(trace.ticks) == what.ticks + 1
    assert not trace.complete


def test_any_other_error_is_not_swallowed() -> None:
    def fails(done: int) -> None:
        raise RuntimeError("broken progress bar")

    with pytest.raises(RuntimeError, match="broken progress bar"):
        simulated(scenario(duration_s=0.1), on_tick=fails)


def test_ticks_and_decisions_refer_to_each_other(visit: Trace) -> None:
    for k, decision in enumerate(visit.decisions):
        assert visit.ticks["decision"][decision["tick"]] == k
        assert visit.time_s[decision["tick"]] == decision["time_s"]
    assert (visit.ticks["decision"] >= 0).sum() == len(visit.decisions)


def test_a_trace_says_which_software_made_it_and_cannot_be_written(visit: Trace) -> None:
    assert visit.provenance.world == "pybullet"
    assert visit.system.tested.name == "opposite pose"
    assert dict(visit.provenance.libraries)["numpy"] == np.__version__
    for array in (visit.ticks, visit.decisions):
        with pytest.raises(ValueError, match="read-only"):
            array["time_s"] = 0.0
    with pytest.raises(AttributeError):
        visit.ended = "complete"  # type: ignore[misc]


def test_braking_is_recorded_in_the_tick_in_which_it_acts() -> None:
    class Stops(ConstantSpeed):
        def step(self, observation: np.ndarray) -> np.ndarray:
            command = super().step(observation)
            command["protective_stop"] = observation["time_s"] >= 0.1
            return command

    what = scenario(duration_s=0.3)
    admitted = admit(what)
    with PyBulletWorld(what, admitted.arm, admitted.joint_position_rad) as world:
        trace = simulate(world, Stops((0.1,) * 6), what)
    braking = (trace.ticks["limits"] & Limit.BRAKING) > 0
    assert np.array_equal(braking[:-1], trace.time_s[:-1] >= 0.1)
    assert replace(trace).complete
