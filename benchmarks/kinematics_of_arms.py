"""Frames, Jacobians, inverse kinematics and capsules of nine arms, beside Pinocchio and its mesh reader.

Run: python benchmarks/kinematics_of_arms.py, with Pinocchio (`pip install pin`) and, for the last three arms,
`pip install example-robot-data` (431 MB; without it their rows are left out).  Prints Markdown for
docs/results/arms.md.  Nothing of ours computes what ours is compared with: Pinocchio reads the URDF
and gives frames and Jacobians, coal reads the meshes, and ssik (`pip install ssik`; without it its table
is left out) solves for all branches by algebra.  Poses to reach come from joints within the limits.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from time import perf_counter
from types import ModuleType

import numpy as np
import pybullet_data

from safety_harness.cell.robot.capsules import CapsuleSet, load_capsules, read_capsules
from safety_harness.cell.robot.closed_form import has_closed_form
from safety_harness.cell.robot.description import PACKAGES, ArmModel, load_arm, read_arm, resolved_urdf
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.cell.robot.kinematics import geometric_jacobian, links_in_base
from safety_harness.cell.robot.numeric_inverse import EXACT_POSE, all_found, nearest_found, starts_of
from safety_harness.extensions.arms.fit_capsules import (
    FINE_M,
    Capsule,
    excess,
    fit_arm,
    link_surface,
    write_capsules,
)

ROOT = Path(__file__).parents[1]
BULLET = Path(pybullet_data.getDataPath())
OF_BULLET = {
    "Panda": ("franka_panda/panda.urdf", "panda_link0", "panda_hand"),
    "iiwa": ("kuka_iiwa/model.urdf", None, None),
    "xArm6": ("xarm/xarm6_robot.urdf", None, "link6"),
}
OF_EXAMPLES = {
    "xArm7": ("xarm_description/urdf/xarm7.urdf", None, None),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", None, "j2s6s200_end_effector"),
    "Z1": ("z1_description/urdf/z1.urdf", None, "link06"),
}
SEED = 1
POINTS = 20_000  # of a mesh, from which each pose takes some
OF_A_POSE = 50
MOST_OFF = 1e-12  # m, and entries of rotations
ENDLESS = 2.0 * np.pi  # how far a joint without a limit is turned here


@dataclass(frozen=True)
class Named:
    """An arm, and the capsules that come with it, if any do."""

    name: str
    arm: ArmModel
    capsules: CapsuleSet | None = None
    meshes: bool = True  # are looked at


def arms(pin: ModuleType) -> Iterator[Named]:
    """The arms that are here."""
    for name in ("ur3", "ur5", "ur10"):
        yield Named(name.upper(), load_arm(name), load_capsules(name))
    for name, (path, base, tcp) in OF_BULLET.items():
        yield Named(name, read_arm(BULLET / path, base=base, tcp=tcp))
    robots = Path(str(pin.__file__)).parents[4] / "share" / "example-robot-data" / "robots"
    for name, (path, base, tcp) in OF_EXAMPLES.items():
        if (robots / path).is_file():
            packages = {next(iter(PACKAGES)): robots}
            yield Named(name, read_arm(robots / path, base=base, tcp=tcp, packages=packages), meshes=False)
        else:
            print(f"{name}: left out, for example-robot-data is not installed", file=sys.stderr)


def drawn(arm: ArmModel, count: int, rng: np.random.Generator) -> np.ndarray:
    """Joint positions (count, n) anywhere within the limits."""
    lower = np.maximum(arm.position_lower_rad, -ENDLESS)
    upper = np.minimum(arm.position_upper_rad, ENDLESS)
    return rng.uniform(lower, upper, (count, len(lower)))


class InPinocchio:
    """An arm in Pinocchio, from the text of a URDF."""

    def __init__(self, pin: ModuleType, arm: ArmModel, text: str) -> None:
        self.pin, self.arm = pin, arm
        self.model = pin.buildModelFromXML(text)
        self.data = self.model.createData()
        self.ids = [self.model.getJointId(name) for name in arm.joint_names]
        self.base = self.model.getFrameId(arm.link_names[0])

    def move(self, joints: np.ndarray) -> None:
        """Put the arm at joints (n,)."""
        position = self.pin.neutral(self.model)
        for index, angle in zip(self.ids, joints, strict=True):
            joint = self.model.joints[index]
            pair = joint.nq == 2  # an endless joint is a point of the circle
            position[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(angle), np.sin(angle)] if pair else angle
        self.pin.computeJointJacobians(self.model, self.data, position)
        self.pin.updateFramePlacements(self.model, self.data)

    def frame(self, link: str) -> np.ndarray:
        """(4, 4) to the base link's frame."""
        placed = self.data.oMf[self.model.getFrameId(link)]
        return np.array((self.data.oMf[self.base].inverse() * placed).homogeneous)

    def jacobian(self, link: str) -> np.ndarray:
        """(6, n) in the base link's frame."""
        aligned = self.pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        frame = self.model.getFrameId(link)
        whole = self.pin.getFrameJacobian(self.model, self.data, frame, aligned)
        columns = whole[:, [self.model.joints[index].idx_v for index in self.ids]]
        turn = self.data.oMf[self.base].rotation.T
        return np.vstack((turn @ columns[:3], turn @ columns[3:]))


def deviations(pin: ModuleType, arm: ArmModel, poses: int) -> tuple[float, float]:
    """The greatest difference of an entry of all frames, and of the Jacobian, from Pinocchio's."""
    theirs = InPinocchio(pin, arm, arm.text.decode())
    jacobian, frames_off, jacobian_off = np.empty((6, len(arm.joint_names))), 0.0, 0.0
    for joints in drawn(arm, poses, np.random.default_rng(SEED)):
        theirs.move(joints)
        frames = links_in_base(arm, joints)
        for link, ours in zip((*arm.link_names, arm.tcp_link), frames, strict=True):
            frames_off = max(frames_off, np.abs(ours - theirs.frame(link)).max())
        geometric_jacobian(arm.joint_axes, frames, jacobian)
        jacobian_off = max(jacobian_off, np.abs(jacobian - theirs.jacobian(arm.tcp_link)).max())
    return frames_off, jacobian_off


@dataclass(frozen=True)
class Reached:
    """What share of poses was reached, exactly and within limits, and how long that took."""

    share: float
    median_ms: float
    slowest_ms: float
    missed_ms: float  # the median of those that were not reached

    @classmethod
    def of(cls, arm: ArmModel, poses: np.ndarray, references: np.ndarray) -> Reached:
        """Of poses (m, 4, 4), each from one of the references (m, n)."""
        inverse = InverseKinematics(arm)
        inverse.nearest(poses[0], references[0])  # which compiles
        times_ms, reached = np.empty(len(poses)), np.zeros(len(poses), bool)
        for i, (pose, reference) in enumerate(zip(poses, references, strict=True)):
            begin_s = perf_counter()
            found = inverse.nearest(pose, reference)
            times_ms[i] = 1e3 * (perf_counter() - begin_s)
            if found is not None:
                within = (arm.position_lower_rad <= found) & (found <= arm.position_upper_rad)
                off = np.abs(links_in_base(arm, found)[-1] - pose).max()
                reached[i] = within.all() and off <= EXACT_POSE
        missed_ms = float(np.median(times_ms[~reached])) if not reached.all() else np.nan
        return cls(float(reached.mean()), float(np.median(times_ms)), float(times_ms.max()), missed_ms)

    def cells(self) -> str:
        """Of a table."""
        return f"{self.share:.1%} | {shown(self.median_ms)} | {shown(self.slowest_ms)}"


def shown(value: float) -> str:
    """Three digits, for times, or a dash."""
    if np.isnan(value):
        return "-"
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def inverse_row(arm: ArmModel, count: int) -> str:
    """Reach from near, from far, and the time to give up a pose: the tcp inside the arm's foot."""
    rng = np.random.default_rng(SEED)
    joints = drawn(arm, count, rng)
    poses = np.array([links_in_base(arm, one)[-1] for one in joints])
    shifted = joints + rng.normal(0.0, 0.05, joints.shape)
    near = Reached.of(arm, poses, np.clip(shifted, arm.position_lower_rad, arm.position_upper_rad))
    far = Reached.of(arm, poses, drawn(arm, count, rng))
    inner = poses[: max(count // 10, 1)].copy()
    inner[:, :3, 3] = arm.joint_origins[0, :3, 3]
    none_ms = Reached.of(arm, inner, joints[: len(inner)]).missed_ms
    form = "closed form" if has_closed_form(arm) else "numeric"
    return f"{form} | {near.cells()} | {far.cells()} | {shown(none_ms)}"


def numeric_on(arm: ArmModel, count: int) -> str:
    """What share of the closed form's branches, and of its nearest solutions, the numeric search finds."""
    rng = np.random.default_rng(SEED)
    inverse, starts = InverseKinematics(arm), starts_of(arm)
    limits = arm.position_lower_rad, arm.position_upper_rad
    branches = found = strange = nearest = 0
    for joints, reference in zip(drawn(arm, count, rng), drawn(arm, count, rng), strict=True):
        pose = np.array(links_in_base(arm, joints)[-1])
        exact, numeric = inverse.branches(pose), all_found(arm.chain, starts, pose)
        apart = np.abs((numeric[:, None] - exact[None] + np.pi) % (2.0 * np.pi) - np.pi).max(axis=2)
        branches, found = branches + len(exact), found + int((apart.min(axis=0, initial=9.0) < 1e-6).sum())
        strange += int((apart.min(axis=1, initial=9.0) >= 1e-6).sum())
        best = inverse.nearest(pose, reference)
        (ours,) = nearest_found(arm.chain, *limits, starts, pose[None], reference)
        nearest += best is not None and bool(np.abs(best - ours).max() < 1e-6)
    return f"{branches} | {found / branches:.2%} | {strange} | {nearest / count:.1%}"


def beside_ssik(ssik: ModuleType, arm: ArmModel, count: int) -> str:
    """How the numeric search does beside ssik's branches, of poses of joints within the limits.

    Six joints: all branches, limits aside.  Seven: the nearest solution within limits, beside the nearest of
    those that ssik gives, which samples the self-motion.
    """
    rng, starts = np.random.default_rng(SEED), starts_of(arm)
    limits = arm.position_lower_rad, arm.position_upper_rad
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(resolved_urdf(arm, visuals=False))
        file.flush()
        theirs = ssik.Manipulator.from_urdf(file.name, base=arm.link_names[0], ee=arm.tcp_link)
    redundant = len(arm.joint_names) > 6
    solved = known = found = more = missed = farther = 0
    for joints, reference in zip(drawn(arm, count, rng), drawn(arm, count, rng), strict=True):
        pose = np.array(links_in_base(arm, joints)[-1])
        exact = np.array([one.q for one in theirs.solve(pose, respect_limits=redundant)])
        exact = exact.reshape(-1, len(joints))
        solved, known = solved + bool(len(exact)), known + len(exact)
        if redundant:
            (ours,) = nearest_found(arm.chain, *limits, starts, pose[None], reference)
            away = np.linalg.norm(exact - reference, axis=1).min(initial=np.inf)
            missed += bool(np.isnan(ours).any())
            farther += bool(np.linalg.norm(ours - reference) > away + 1e-6)
            continue
        numeric = all_found(arm.chain, starts, pose)
        apart = np.abs((numeric[:, None] - exact[None] + np.pi) % (2.0 * np.pi) - np.pi).max(axis=2)
        found += int((apart.min(axis=0, initial=9.0) < 1e-6).sum())
        more += int((apart.min(axis=1, initial=9.0) >= 1e-6).sum())
    if redundant:
        return f"{count} | {count - solved} | {missed} | {known} | - | - | {farther}"
    return f"{count} | {count - solved} | - | {known} | {known - found} | {more} | -"


def mesh_points(pin: ModuleType, arm: ArmModel) -> Iterator[tuple[int, np.ndarray]]:
    """(link, points (k, 3) in its frame) of each mesh as coal reads it: corners, and others of triangles."""
    rng, text = np.random.default_rng(SEED), resolved_urdf(arm, visuals=True)
    model = pin.buildModelFromXML(text)
    index = {0: 0} | {model.getJointId(name): i for i, name in enumerate(arm.joint_names, start=1)}
    for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        for thing in pin.buildGeomFromUrdfString(model, text, kind).geometryObjects:
            mesh = thing.geometry
            if not hasattr(mesh, "tri_indices"):
                continue  # a box, cylinder or sphere
            corners = np.array(mesh.vertices())
            triangles = (mesh.tri_indices(i) for i in range(mesh.num_tris))
            faces = np.array([[triangle[i] for i in range(3)] for triangle in triangles])
            a, b, c = (corners[faces[:, i]] for i in range(3))
            areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
            chosen = rng.choice(len(faces), POINTS, p=areas / areas.sum())
            u, v = rng.dirichlet(np.ones(3), POINTS)[:, :2].T[:, :, None]
            points = np.concatenate((corners, (u * a[chosen] + v * b[chosen] + (1.0 - u - v) * c[chosen])))
            yield index[thing.parentJoint], points @ thing.placement.rotation.T + thing.placement.translation


def outside_m(points: np.ndarray, ends: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(k,) how far [m] points (k, 3) are outside capsules, ends (c, 2, 3), radii (c,); negative inside."""
    axes = ends[:, 1] - ends[:, 0]
    lengths = np.maximum((axes**2).sum(axis=1), 1e-300)
    to = points[:, None] - ends[None, :, 0]
    share = np.clip((to * axes).sum(axis=2) / lengths, 0.0, 1.0)
    return np.array((np.linalg.norm(to - share[..., None] * axes, axis=2) - radii).min(axis=1))


def held(pin: ModuleType, arm: ArmModel, capsules: CapsuleSet, poses: int) -> str:
    """A row: points of exact meshes, moved by Pinocchio, in capsules that we place; and their excess."""
    of_link: dict[int, list[np.ndarray]] = {}
    for link, points in mesh_points(pin, arm):
        of_link.setdefault(link, []).append(points)
    pools = {link: np.concatenate(points) for link, points in of_link.items()}
    theirs = InPinocchio(pin, arm, resolved_urdf(arm, visuals=False))
    ends, rng = np.empty((len(capsules.names), 2, 3)), np.random.default_rng(SEED)
    tried = out = 0
    worst = -np.inf
    for joints in drawn(arm, poses, rng):
        theirs.move(joints)
        place_capsules(capsules.records, links_in_base(arm, joints), ends)
        for link, pool in pools.items():
            placed = theirs.data.oMi[theirs.ids[link - 1]] if link else pin.SE3.Identity()
            some = pool[rng.integers(len(pool), size=OF_A_POSE)] @ placed.rotation.T + placed.translation
            mine = capsules.link_index == link
            off = outside_m(some, ends[mine], capsules.radius_m[mine])
            tried, out, worst = tried + len(off), out + int((off > 0.0).sum()), max(worst, float(off.max()))
    means, greatest = zip(*(too_much(arm, capsules, link) for link in pools), strict=True)
    return (
        f"{len(capsules.names)} | {tried:,} | {out} | {-1e3 * worst:.3f} | "
        f"{1e3 * min(means):.0f} to {1e3 * max(means):.0f} | {1e3 * max(greatest):.0f}"
    )


def too_much(arm: ArmModel, capsules: CapsuleSet, link: int) -> tuple[float, float]:
    """Mean and largest distance [m] from a link's capsules to its shapes."""
    mine: list[Capsule] = [
        (capsules.start_in_link[k], capsules.end_in_link[k], float(capsules.radius_m[k]))
        for k in np.flatnonzero(capsules.link_index == link)
    ]
    surface = link_surface(arm.links[link], FINE_M)
    largest, mean = excess(mine, surface, np.random.default_rng(SEED))
    return mean, largest


def capsules_of(one: Named, folder: Path) -> CapsuleSet:
    """Those that come with it, or those in the folder, fitted if they are not there."""
    if one.capsules is not None:
        return one.capsules
    file = folder / f"{one.name.lower()}.capsules.json"
    if not file.is_file():
        print(f"{one.name}: fitting capsules", file=sys.stderr)
        write_capsules(file, one.arm, fit_arm(one.arm))
    return read_capsules(file, one.arm)


def section(head: str, rows: Iterable[str]) -> None:
    """Print a table row by row, as each is measured."""
    print(f"\n{head}\n|{'---|' * (head.count('|') - 1)}")
    for row in rows:
        print(f"| {row} |", flush=True)


def main() -> int:
    """Print the tables; 1 if a frame or a Jacobian is off, or a point is outside; 2 without Pinocchio."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--poses", type=int, default=1_000, help="for frames and inverses; ten times as many for meshes"
    )
    parser.add_argument("--capsules", type=Path, help="a folder in which fitted capsules are kept")
    given = parser.parse_args()
    try:
        pin = import_module("pinocchio")
    except ImportError:
        print("kinematics_of_arms: needs Pinocchio (pip install pin)", file=sys.stderr)
        return 2
    command = ["git", "rev-parse", "--short", "HEAD"]
    revision = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    print(
        f"At {revision}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, Pinocchio {pin.__version__}, "
        f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; {given.poses:,} poses of each arm."
    )
    tried, failed = list(arms(pin)), []

    def compared(one: Named) -> str:
        frames, jacobian = deviations(pin, one.arm, given.poses)
        failed.extend([one.name] if not max(frames, jacobian) < MOST_OFF else [])
        return f"{one.name} | {len(one.arm.joint_names)} | {frames:.1e} | {jacobian:.1e}"

    def enclosed(one: Named, folder: Path) -> str:
        row = held(pin, one.arm, capsules_of(one, folder), 10 * given.poses)
        failed.extend([one.name] if row.split(" | ")[2] != "0" else [])
        return f"{one.name} | {row}"

    section("| arm | joints | frames off by | Jacobian off by |", map(compared, tried))
    section(
        "| arm | inverse | near: reached | median, ms | slowest | far: reached | median | slowest | none |",
        (f"{one.name} | {inverse_row(one.arm, given.poses)}" for one in tried),
    )
    section(
        "| arm | branches in closed form | found by numbers | others found | nearest found |",
        (f"{one.name} | {numeric_on(one.arm, given.poses)}" for one in tried if has_closed_form(one.arm)),
    )
    try:
        ssik = import_module("ssik")
    except ImportError:
        print("kinematics_of_arms: beside ssik left out (pip install ssik)", file=sys.stderr)
    else:
        section(
            f"| arm, beside ssik {ssik.__version__} | poses | unsolved by ssik | by ours | branches of ssik "
            "| not found by ours | found by ours alone | ssik's are nearer |",
            (
                f"{one.name} | {beside_ssik(ssik, one.arm, given.poses)}"
                for one in tried
                if one.name in OF_BULLET
            ),
        )
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.capsules or Path(temporary)
        section(
            "| arm | capsules | mesh points | outside | least depth, mm | mean excess of a link | largest |",
            (enclosed(one, folder) for one in tried if one.meshes),
        )
    for name in failed:
        print(f"off, or outside its capsules: {name}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
