"""Joint torques beside PyBullet's inverse dynamics, and the laws that they have to obey."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pybullet
import pytest

from safety_harness.cell.robot.description import ArmModel, read_arm, resolved_urdf
from safety_harness.cell.robot.dynamics import GRAVITY_MPS2, joint_torques, link_masses, torque_share
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.robot.urdf import ArmFileError
from tests.cell.robot.urdfs import OTHERS, SMALL, small_arm_in

ARMS = ["iiwa", "panda"]
POSES = 50


def arm_named(name: str) -> ArmModel:
    file, base, tcp = OTHERS[name]
    return read_arm(file, base=base, tcp=tcp)


def torques(arm: ArmModel, masses: np.void, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    frames, found = np.empty((len(q) + 2, 4, 4)), np.empty(len(q))
    forward_kinematics(arm.chain[0], q, frames)
    joint_torques(arm.joint_axes, frames, masses, v, a, found)
    return found


def motions(arm: ArmModel, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    rng, n = np.random.default_rng(seed), len(arm.joint_names)
    for _ in range(POSES):
        yield rng.uniform(-2, 2, n), rng.uniform(-3, 3, n), rng.uniform(-10, 10, n)


def energy(arm: ArmModel, masses: np.void, q: np.ndarray, v: np.ndarray) -> float:
    """Kinetic and potential, from the links' own motion by differences of poses: no torques in it."""
    step = 1e-6
    before, now, after = np.empty((3, len(q) + 2, 4, 4))
    for frames, at in ((before, q - step * v), (now, q), (after, q + step * v)):
        forward_kinematics(arm.chain[0], at, frames)
    found = 0.0
    for k, (mass, centre) in enumerate(zip(masses["mass_kg"], masses["centre_m"], strict=True), start=1):
        homogeneous = np.append(centre, 1.0)
        speed = ((after[k] - before[k]) @ homogeneous)[:3] / (2 * step)
        spin = now[k, :3, :3].T @ (after[k] - before[k])[:3, :3] / (2 * step)  # w x, in the link
        w = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        found += 0.5 * mass * speed @ speed + 0.5 * w @ masses["inertia_kgm2"][k - 1] @ w
        found += mass * GRAVITY_MPS2 * (now[k] @ homogeneous)[2]
    return float(found)


@pytest.mark.parametrize("name", ARMS)
def test_torques_are_those_of_the_engines_inverse_dynamics(name: str, tmp_path: Path) -> None:
    arm = arm_named(name)
    masses, file = link_masses(arm), tmp_path / "arm.urdf"
    massless = r'(<mass value="0.0" ?/>\s*)<inertia [^>]*>'  # which the engine would turn nevertheless
    nothing = " ".join(f'{key}="0"' for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    urdf = re.sub(massless, rf"\1<inertia {nothing}/>", resolved_urdf(arm, visuals=False))
    file.write_text(urdf)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        body = pybullet.loadURDF(str(file), useFixedBase=True, flags=flags, physicsClientId=client)
        pybullet.setGravity(0, 0, -GRAVITY_MPS2, physicsClientId=client)
        for joint in range(-1, pybullet.getNumJoints(body, physicsClientId=client)):
            pybullet.changeDynamics(
                body, joint, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=client
            )
        for motion in motions(arm, 1):
            expected = pybullet.calculateInverseDynamics(
                body, *(one.tolist() for one in motion), physicsClientId=client
            )
            assert torques(arm, masses, *motion) == pytest.approx(expected, rel=1e-6, abs=1e-5)
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize("name", ARMS)
def test_the_power_of_the_joints_is_what_the_energy_grows_by(name: str) -> None:
    """tau . q' = dE/dt, also of an arm that hangs from the ceiling and carries a part."""
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    arm = arm_named(name).seated(turned)
    masses, step = link_masses(arm, 5.0, np.array([0.02, -0.03, 0.2])), 1e-5
    for q, v, a in motions(arm, 2):
        later = energy(arm, masses, q + step * v + 0.5 * step**2 * a, v + step * a)
        sooner = energy(arm, masses, q - step * v + 0.5 * step**2 * a, v - step * a)
        power = torques(arm, masses, q, v, a) @ v
        assert power == pytest.approx((later - sooner) / (2 * step), rel=1e-4, abs=1e-3)


def test_what_is_fixed_to_a_link_counts_as_part_of_it(tmp_path: Path) -> None:
    """A weight on a fixed joint is held by the same torques as the same weight carried as a payload."""
    inertial = (
        '<inertial><mass value="2"/>'
        '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
    )
    point = inertial.replace("0.01", "1e-9").replace('value="2"', 'value="3"')
    whole = SMALL.replace('<link name="lower">', f'<link name="lower">{inertial}')
    whole = whole.replace('<link name="hand"/>', f'<link name="hand">{inertial}</link>')
    fixed = whole.replace(
        "</robot>",
        f'<link name="weight">{point}</link><joint name="w" type="fixed"><parent link="hand"/>'
        '<child link="weight"/><origin xyz="0.1 0 0.3" rpy="1 0 0"/></joint></robot>',
    )
    carried = link_masses(read_small(tmp_path, whole), 3.0, np.array([0.1, 0.0, 0.3]))
    arm = read_small(tmp_path, fixed)
    for motion in motions(arm, 3):
        assert torques(arm, link_masses(arm), *motion) == pytest.approx(
            torques(arm, carried, *motion), abs=1e-5
        )


def read_small(folder: Path, text: str) -> ArmModel:
    return read_arm(small_arm_in(folder, text), base="foot", tcp="hand")


def test_a_link_without_a_mass_is_refused_with_its_line(tmp_path: Path) -> None:
    line = SMALL.splitlines().index('  <link name="lower">') + 1
    with pytest.raises(ArmFileError, match=r"'lower'.*<inertial>") as caught:
        link_masses(read_small(tmp_path, SMALL))
    assert caught.value.place.line == line


def test_the_share_is_the_largest_that_no_joints_limit_forbids() -> None:
    rng = np.random.default_rng(4)
    shares = np.linspace(0.0, 1.0, 2001)
    kinds = set()
    for _ in range(300):
        bias, wanted, limit = rng.normal(0, 1, 4), rng.normal(0, 4, 4), rng.uniform(0.8, 3, 4)
        found = torque_share(bias, wanted, limit)
        allowed = np.all(np.abs(bias + shares[:, None] * (wanted - bias)) <= limit, axis=1)
        expected = shares[allowed].max() if allowed.any() else 0.0
        assert expected <= found <= 1.0
        assert found == 0.0 or (np.abs(bias + found * (wanted - bias)) <= limit + 1e-12).all()
        kinds.add((bool(allowed.any()), bool(allowed[0]), expected == 1.0))
    assert len(kinds) > 3  # free, limited, overloaded and relieved, overloaded for good
