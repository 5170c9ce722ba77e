from __future__ import annotations

import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, ConstantSpeed, run, scenario

from safety_harness.admission.admit import admit
from safety_harness.base.exceptions import SimulationError
from safety_harness.base.settings import DEFAULTS, HandSensorKind, Settings
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.robot.kinematics import geometric_jacobian
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation import pybullet_world
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.robots import Robot
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import TICK
from safety_harness.trace.trace import Trace
from tests.cell.robot.arms import pose_in_the_engine, transforms_of

PERIOD_S = DEFAULTS.clock.control_period_s


def noisy(seed: int = 1) -> Scenario:
    """A scenario with noise, dropouts, a rate and latencies."""
    sensor = replace(
        DEFAULTS.hand_sensor,
        kind=HandSensorKind.OVERHEAD,
        pixel_noise_px=1.0,
        depth_noise_per_m=0.0025,
        dropout_probability=0.1,
        rate_hz=30.0,
        latency_s=0.033,
    )
    settings = replace(DEFAULTS, hand_sensor=sensor)
    return scenario(VISIT, duration_s=1.6, avoider="nearest candidate", settings=settings, seed=seed)


def world_of(what: Scenario) -> PyBulletWorld:
    admitted = admit(what)
    return PyBulletWorld(what, admitted.arm, admitted.joint_position_rad)


def connections() -> int:
    return sum(bool(pybullet.isConnected(client)) for client in range(32))


def command(*rates: float, stop: bool = False) -> np.ndarray:
    record = np.zeros(1, COMMAND)
    record["joint_velocity_radps"], record["protective_stop"] = rates, stop
    return record


def truth(world: PyBulletWorld) -> np.void:
    tick = np.zeros(1, TICK)
    world.true_state(tick)
    return tick[0]


def driven(rates: tuple[float, ...], ticks: int, settings: Settings = DEFAULTS) -> np.ndarray:
    """(ticks + 1,) TICK of an arm that is told the same velocity all the time."""
    what = scenario(duration_s=ticks * PERIOD_S, settings=settings)
    return run(what, controller=ConstantSpeed(rates)).ticks


def test_the_arm_stands_still_when_told_to() -> None:
    """Gravity pulls and the drives hold: below 1e-6 rad/s, which is 0.06 mrad in a minute."""
    ticks = driven((0.0,) * 6, 500)
    assert np.abs(ticks["joint_velocity_radps"]).max() < 1e-6
    drift = np.abs(ticks["joint_position_rad"] - ticks["joint_position_rad"][0])
    assert drift.max() < 1e-6 * 500 * PERIOD_S


@pytest.mark.parametrize("substeps", [2, 4, 8])
def test_the_joints_follow_a_jump_within_two_milliseconds_and_then_exactly(substeps: int) -> None:
    """With their torque limits the motors get up to speed in the first tick; after that nothing is lost."""
    settings = replace(DEFAULTS, clock=replace(DEFAULTS.clock, physics_substeps=substeps))
    rates = np.array([0.3, -0.2, 0.15, 0.4, -0.3, 0.5])
    ticks = driven(tuple(rates), 125, settings)
    assert ticks["joint_velocity_radps"][1:] == pytest.approx(np.tile(rates, (125, 1)), abs=1e-6)
    elapsed_s = PERIOD_S * np.arange(126)
    ideal = ticks["joint_position_rad"][0] + np.outer(elapsed_s, rates)
    lag_s = (ideal - ticks["joint_position_rad"]) / rates
    assert lag_s[1:] == pytest.approx(np.tile(lag_s[1], (125, 1)), abs=1e-5)
    assert np.abs(lag_s[1]).max() < 2e-3


def test_the_pose_of_the_trace_is_the_engines_own() -> None:
    """Our kinematics against PyBullet's, which keeps them in single precision: within a micrometre."""
    with world_of(scenario()) as world:
        rates = command(0.5, -0.3, 0.2, 0.4, -0.6, 0.7)
        for _ in range(60):
            world.step(rates)
            expected, pose = pose_in_the_engine("tool0"), truth(world)["transform_tcp_to_base"]
            assert pose[:3, 3] == pytest.approx(expected[:3, 3], abs=1e-6)
            assert pose[:3, :3] == pytest.approx(expected[:3, :3], abs=2e-6)


def test_the_tcp_speed_is_that_of_the_tcp() -> None:
    ticks = driven((0.3, -0.2, 0.15, 0.4, -0.3, 0.5), 60)
    path = ticks["transform_tcp_to_base"][:, :3, 3]
    central = np.linalg.norm(path[2:] - path[:-2], axis=1) / (2 * PERIOD_S)
    assert ticks["tcp_speed_mps"][2:-1] == pytest.approx(central[1:], abs=1e-5)


def test_time_is_a_multiple_of_the_period_and_no_running_sum() -> None:
    with world_of(scenario()) as world:
        for k in range(30):
            assert world.time_s == k * PERIOD_S
            assert world.observe()[0]["time_s"] == truth(world)["time_s"] == k * PERIOD_S
            world.step(command(0, 0, 0, 0, 0, 0))


def test_the_encoders_are_exact() -> None:
    with world_of(scenario()) as world:
        for _ in range(5):
            world.step(command(0.1, 0.2, 0.3, 0.1, 0.2, 0.3))
            observation = world.observe()[0]
            for name in ("joint_position_rad", "joint_velocity_radps"):
                assert np.array_equal(observation[name], truth(world)[name])


def test_the_client_is_closed_after_a_run_and_after_an_error_in_it() -> None:
    before = connections()
    with world_of(scenario()) as world:
        assert connections() == before + 1
    assert connections() == before
    world.close()  # a second time does nothing
    with pytest.raises(KeyError), world_of(scenario()):
        raise KeyError
    assert connections() == before


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_the_client_is_closed_when_construction_fails(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    build = pybullet_world.build_cell

    def fails(*_: object, **__: object) -> None:
        raise error

    def builds_and_fails(*given: object, **named: object) -> None:
        build(*given, **named)  # type: ignore[arg-type]
        raise error

    before = connections()
    with monkeypatch.context() as patch:
        patch.setattr(pybullet_world, "build_cell", fails)
        with pytest.raises(error):
            world_of(scenario())
    assert connections() == before
    with monkeypatch.context() as patch:
        patch.setattr(pybullet_world, "build_cell", builds_and_fails)
        with pytest.raises(error):
            world_of(scenario())
    assert connections() == before


def test_a_refused_client_is_an_error_of_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pybullet, "connect", lambda *_: -1)
    with pytest.raises(SimulationError, match="no client"):
        world_of(scenario())


def test_two_worlds_at_a_time_do_not_meet() -> None:
    alone = run(scenario(VISIT, duration_s=1.0))
    with world_of(scenario(offset=(0.0, 0.05, 0.0))) as other:
        other.step(command(0.5, 0, 0, 0, 0, 0))
        assert first_difference(alone, run(scenario(VISIT, duration_s=1.0))) is None


def test_the_same_scenario_twice_is_the_same_trace_bit_by_bit() -> None:
    first, second = run(noisy()), run(noisy())
    assert len(first.decisions) > 0
    assert first_difference(first, second) is None
    assert first.ticks.tobytes() == second.ticks.tobytes()  # the padding between fields, too: files repeat


def test_another_seed_is_another_run_where_there_is_noise_and_only_there() -> None:
    assert first_difference(run(noisy(1)), run(noisy(2))) is not None
    quiet = [run(scenario(VISIT, duration_s=1.2, seed=seed)) for seed in (1, 2)]
    assert quiet[0].ticks.tobytes() == quiet[1].ticks.tobytes()  # decisions note their seed


def test_a_fresh_process_makes_the_same_trace_bit_by_bit(tmp_path: Path) -> None:
    here = run(noisy())
    program = f"""
        import sys
        import numpy as np
        sys.path[:0] = {[str(Path(__file__).parents[2]), str(Path(__file__).parent)]!r}
        from test_pybullet_world import noisy, run
        trace = run(noisy())
        np.save({str(tmp_path / "ticks.npy")!r}, trace.ticks)
        np.save({str(tmp_path / "decisions.npy")!r}, trace.decisions)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True, timeout=300)
    there: Trace = replace(
        here, ticks=np.load(tmp_path / "ticks.npy"), decisions=np.load(tmp_path / "decisions.npy")
    )
    assert len(there.ticks) == len(here.ticks)
    difference = first_difference(here, there)
    assert difference is None, str(difference)


def test_the_urdf_that_the_engine_reads_goes_with_the_process(tmp_path: Path) -> None:
    program = f"""
        import sys, tempfile
        tempfile.tempdir = {str(tmp_path)!r}
        from safety_harness.cell.robot.description import load_arm
        from safety_harness.cell.simulation.cell import urdf_file
        file = urdf_file(load_arm("ur10"), False)
        print(file.is_file() and file == urdf_file(load_arm("ur10"), False))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        check=True,
        timeout=300,
        capture_output=True,
        text=True,
    )
    assert done.stdout.split()[-1] == "True"
    assert list(tmp_path.iterdir()) == []


def test_the_engine_says_nothing_on_standard_error() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from safety_harness.cell.simulation.engine import pybullet"],
        check=True,
        timeout=300,
        capture_output=True,
        text=True,
    )
    assert (done.stdout, done.stderr) == ("", "")


def test_the_hands_move_with_the_clock_of_the_world(visit: Trace) -> None:
    """1 m/s from the start to the first goal, after a tenth of a second at 10 m/s^2."""
    path = visit.ticks["hand_position_in_base_m"][:, 0]
    moved = np.linalg.norm(path - path[0], axis=1)[:50]
    time_s = visit.time_s[:50]
    assert moved == pytest.approx(np.where(time_s < 0.1, 5.0 * time_s**2, time_s - 0.05), abs=1e-12)


def test_the_tcp_moves_as_its_joints_say(visit: Trace) -> None:
    """The twist of the true joint velocities has the speed that the trace says."""
    jacobian = np.empty((6, 6))
    for tick in visit.ticks[::50]:
        transforms = transforms_of(arm_model(Robot.UR10), tick["joint_position_rad"])
        geometric_jacobian(arm_model(Robot.UR10).joint_axes, transforms, jacobian)
        speed = np.linalg.norm((jacobian @ tick["joint_velocity_radps"])[:3])
        assert tick["tcp_speed_mps"] == pytest.approx(speed, abs=1e-12)
