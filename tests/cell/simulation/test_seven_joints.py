"""An arm of seven joints in the whole loop: the UR10 with its last joint there twice, one behind the other.

Its TCP can move as that of the UR10 does, and with the least joint velocities both of them turn alike.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from examples import VISIT, PassingGate, scenario, ungated

from safety_harness.admission.admit import Admitted, admit
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.inverse import InverseKinematics, straight_way
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.simulate import Episode, simulate_many
from safety_harness.claims.properties import limits
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.signals import true_motion
from safety_harness.trace.records import Mode, tick_dtype
from safety_harness.trace.trace import Trace

MEASURED = ("hand distance", "protective separation", "joint", "TCP")  # claims about how the whole arm moves
WHAT = scenario(VISIT, duration_s=2.0)


def doubled(arm: ArmModel) -> ArmModel:
    limits = ("position_lower_rad", "position_upper_rad", "velocity_limit_radps", "effort_limit")
    return replace(
        arm,
        joint_names=(*arm.joint_names, "wrist_4_joint"),
        link_names=(*arm.link_names, "wrist_4_link"),
        joint_origins=np.append(arm.joint_origins, arm.flange[None], axis=0),
        joint_axes=np.append(arm.joint_axes, arm.joint_axes[5:] @ arm.flange[:3, :3], axis=0),
        flange=np.eye(4),
        **{name: np.append(getattr(arm, name), getattr(arm, name)[5]) for name in limits},
    )


def episode_of(admitted: Admitted) -> Episode:
    """Its gate passes all: it would choose other joints than the six have."""
    gate = admitted.controller().gate
    passing = PassingGate(**{field.name: getattr(gate, field.name) for field in fields(gate)})
    world = KinematicWorld(WHAT, admitted.arm, admitted.joint_position_rad)
    episode = Episode(WHAT, world, ungated(admitted, passing))
    episode.ticks = np.zeros(WHAT.ticks + 1, tick_dtype(WHAT.hand_slots, len(admitted.arm.joint_names)))
    return episode


@pytest.fixture(scope="module")
def six() -> Admitted:
    return admit(WHAT)


@pytest.fixture(scope="module")
def seven(six: Admitted) -> Admitted:
    start = np.append(six.joint_position_rad, 0.0)
    return replace(six, arm=doubled(six.arm), joint_position_rad=start)


@pytest.fixture(scope="module")
def run_of_seven(seven: Admitted) -> Trace:
    (trace,) = simulate_many([episode_of(seven)])
    return trace


@pytest.fixture(scope="module")
def run_of_six(six: Admitted) -> Trace:
    (trace,) = simulate_many([episode_of(six)])
    return trace


def test_it_servoes_and_gives_way_on_the_six_joint_arms_way(run_of_six: Trace, run_of_seven: Trace) -> None:
    expected = run_of_six
    ticks, joints = run_of_seven.ticks, run_of_seven.ticks["joint_position_rad"]
    assert {int(Mode.SERVOING), int(Mode.REPULSING)} <= {*ticks["mode"].tolist()}
    for name in ("transform_tcp_to_base", "tcp_speed_mps", "features", "predicted_distance_m", "mode"):
        np.testing.assert_allclose(ticks[name], expected.ticks[name], atol=1e-9, err_msg=name)
    np.testing.assert_allclose(joints[:, :5], expected.ticks["joint_position_rad"][:, :5], atol=1e-9)
    turned = joints - joints[0]
    assert np.abs(turned[:, 6]).max() > 0.01
    np.testing.assert_allclose(turned[:, 5], turned[:, 6], atol=1e-9)
    (decision,), (as_six) = run_of_seven.decisions, expected.decisions[0]
    assert decision["joint_position_rad"].shape == (7,)
    assert decision["chosen_position_in_base_m"] == pytest.approx(
        as_six["chosen_position_in_base_m"], abs=1e-9
    )


def test_tick_by_tick_it_is_the_same_run_bit_for_bit(seven: Admitted, run_of_seven: Trace) -> None:
    episode = episode_of(seven)
    for k in range(WHAT.ticks + 1):
        tick = episode.ticks[k : k + 1]
        episode.world.true_state(tick)
        command = episode.controller.step(episode.world.observe())
        episode.controller.report(tick)
        if k < WHAT.ticks:
            episode.world.step(command)
    for name in ("joint_position_rad", "joint_velocity_radps", "hand_distance_m", "camera_twist"):
        np.testing.assert_array_equal(episode.ticks[name], run_of_seven.ticks[name], err_msg=name)


@pytest.mark.parametrize(
    "entry",
    [one for one in CATALOGUE if one.prop.sentence.startswith(MEASURED)],
    ids=lambda one: one.prop.sentence,
)
def test_it_is_judged_as_the_six_joint_arm(
    entry: CatalogueEntry,
    seven: Admitted,
    run_of_six: Trace,
    run_of_seven: Trace,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """But for what wrist 3, which turns half as far, is wider to one side."""
    expected = entry.prop.evaluate(run_of_six)
    for module in (limits, true_motion):
        monkeypatch.setattr(module, "arm_model", lambda _: seven.arm)
    found = entry.prop.evaluate(run_of_seven)
    assert (found.verdict, found.exercised) == (expected.verdict, expected.exercised)
    assert found.margin == pytest.approx(expected.margin, abs=1e-4)


def test_inverse_kinematics_and_the_straight_way_are_those_of_the_six(seven: Admitted) -> None:
    """Of a self-motion manifold: the joints reach the pose, and the last two turn as they like."""
    target = forward(seven.arm, seven.joint_position_rad)
    target[:3, 3] += [0.05, 0.04, -0.03]
    found = InverseKinematics(seven.arm).nearest(target, seven.joint_position_rad)
    assert found is not None
    np.testing.assert_allclose(forward(seven.arm, found), target, atol=1e-9)
    way = straight_way(seven.arm, seven.joint_position_rad, target[:3, 3], step_m=0.01)
    np.testing.assert_allclose(forward(seven.arm, way[-1])[:3, 3], target[:3, 3], atol=1e-6)


def forward(arm: ArmModel, joints_rad: np.ndarray) -> np.ndarray:
    transforms = np.empty((len(arm.joint_names) + 2, 4, 4))
    forward_kinematics(arm.chain[0], joints_rad, transforms)
    return transforms[-1]
