"""The second world: exact joints, the reference world's steps, and no renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, ConstantSpeed, hand, run, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.settings import DEFAULTS, DetectorKind, HandSensorKind, ImageSource
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.scenario.faults import Joint, JointStuck
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.moves import FollowTcp
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import TICK, Limit, Mode
from safety_harness.trace.trace import Trace

PERIOD_S = DEFAULTS.clock.control_period_s
RATES = np.array([0.5, -0.3, 0.2, 0.4, -0.6, 0.7])


def world_of(what: Scenario) -> KinematicWorld:
    admitted = admit(what)
    return KinematicWorld(what, admitted.arm, admitted.joint_position_rad)


def truth(world: KinematicWorld) -> np.void:
    tick = np.zeros(1, TICK)
    world.true_state(tick)
    return tick[0]


def command(*rates: float) -> np.ndarray:
    made = np.zeros(1, COMMAND)
    made["joint_velocity_radps"] = rates
    return made


def largest(first: Trace, second: Trace, field: str) -> float:
    a, b = first.ticks[field], second.ticks[field]
    finite = np.isfinite(a) & np.isfinite(b)
    assert (np.isfinite(a) == np.isfinite(b)).all()
    return float(np.abs(a[finite] - b[finite]).max())


def test_each_joint_turns_by_its_set_point_times_the_period() -> None:
    world = world_of(scenario())
    start = truth(world)["joint_position_rad"].copy()
    for k in range(1, 51):
        world.step(command(*RATES))
        assert truth(world)["joint_position_rad"] == pytest.approx(start + k * PERIOD_S * RATES, abs=1e-13)
        assert np.array_equal(truth(world)["joint_velocity_radps"], RATES)


def test_the_tcp_speed_is_that_of_the_tcp() -> None:
    world = world_of(scenario())
    path, speed = [], []
    for _ in range(60):
        world.step(command(*0.4 * RATES))
        path.append(truth(world)["transform_tcp_to_base"][:3, 3].copy())
        speed.append(truth(world)["tcp_speed_mps"])
    central = np.linalg.norm(np.array(path)[2:] - np.array(path)[:-2], axis=1) / (2 * PERIOD_S)
    assert np.array(speed)[1:-1] == pytest.approx(central, abs=1e-5)


def test_time_is_a_multiple_of_the_period_and_no_running_sum() -> None:
    world = world_of(scenario())
    for k in range(30):
        assert world.time_s == k * PERIOD_S
        assert world.observe()[0]["time_s"] == truth(world)["time_s"] == k * PERIOD_S
        world.step(command(0, 0, 0, 0, 0, 0))


def test_a_stuck_joint_stays_where_it_is_and_is_said_to() -> None:
    stuck = JointStuck(from_s=0.0, for_s=0.1, joint=list(Joint)[2])
    world = world_of(replace(scenario(), faults=(stuck,)))
    before = truth(world)["joint_position_rad"].copy()
    world.observe()
    world.step(command(*RATES))
    moved = truth(world)["joint_position_rad"] != before
    assert moved.tolist() == [True, True, False, True, True, True]
    assert world.acted_faults == 1


VISITS = {
    "a visit": scenario(VISIT, duration_s=2.0),
    "a hand that follows": scenario(
        hand(FollowTcp(speed_mps=0.5, distance_m=0.25, duration_s=1.6)), duration_s=1.8
    ),
    "an overhead camera": scenario(
        VISIT,
        duration_s=1.6,
        settings=replace(
            DEFAULTS,
            hand_sensor=replace(
                DEFAULTS.hand_sensor,
                kind=HandSensorKind.OVERHEAD,
                pixel_noise_px=1.0,
                depth_noise_per_m=0.0025,
                rate_hz=30.0,
                latency_s=0.05,
            ),
        ),
    ),
}


@pytest.mark.parametrize("what", VISITS.values(), ids=VISITS)
def test_both_worlds_agree(what: Scenario) -> None:
    """To 0.1 microradian and 0.1 micrometre: the motors of the engine hold to 1e-9 rad/s."""
    kinematic, engine = run_kinematic(admit(what)), run(what)
    assert len(kinematic.decisions) == len(engine.decisions) > 0
    assert largest(kinematic, engine, "joint_position_rad") < 1e-7
    assert largest(kinematic, engine, "hand_distance_m") < 1e-7
    assert np.array_equal(kinematic.ticks["mode"], engine.ticks["mode"])
    assert np.array_equal(kinematic.decisions["tick"], engine.decisions["tick"])


def test_a_protective_stop_takes_as_long_in_both_worlds() -> None:
    far = replace(DEFAULTS, motion=replace(DEFAULTS.motion, min_singular_value=0.02))
    what = scenario(VISIT, duration_s=2.0, settings=far)
    nowhere = replace(what, settings=replace(far, avoidance=replace(far.avoidance, radius_m=3.0)))
    kinematic, engine = run_kinematic(admit(nowhere)), run(nowhere)
    for trace in (kinematic, engine):
        assert (trace.ticks["mode"] == int(Mode.PROTECTIVE_STOP)).any()
        assert (trace.ticks["limits"] & int(Limit.BRAKING)).any()
    assert np.array_equal(kinematic.ticks["limits"], engine.ticks["limits"])
    assert largest(kinematic, engine, "joint_position_rad") < 1e-7


def test_any_controller_drives_it() -> None:
    what = scenario(VISIT, duration_s=0.4)
    trace = run_kinematic(admit(what), controller=ConstantSpeed(tuple(0.1 * RATES)))
    assert trace.complete
    assert trace.provenance.world == "kinematic"
    assert trace.system.tested.name == "constant speed"
    turned = trace.ticks["joint_position_rad"][-1] - trace.ticks["joint_position_rad"][0]
    assert turned == pytest.approx(0.1 * RATES * what.ticks * PERIOD_S, abs=1e-12)


def test_the_same_scenario_twice_is_the_same_trace_bit_by_bit() -> None:
    what = admit(VISITS["an overhead camera"])
    first, second = run_kinematic(what), run_kinematic(what)
    assert first_difference(first, second) is None
    assert first.ticks.tobytes() == second.ticks.tobytes()


@pytest.mark.parametrize(
    ("group", "change", "field"),
    [
        ("camera", {"source": ImageSource.RENDERED}, "camera.source"),
        (
            "hand_sensor",
            {"kind": HandSensorKind.OVERHEAD, "detector": DetectorKind.RENDERED},
            "hand sensor.detector",
        ),
    ],
)
def test_rendered_images_are_refused(group: str, change: dict[str, object], field: str) -> None:
    settings = replace(DEFAULTS, **{group: replace(getattr(DEFAULTS, group), **change)})
    with pytest.raises(InadmissibleError, match="which has no renderer") as error:
        world_of(scenario(settings=settings))
    assert error.value.place.field == field
    assert error.value.got == "rendered"
