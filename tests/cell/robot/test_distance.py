import coal
import numpy as np
import pytest
import trimesh
from disagreement import noted

from safety_harness.cell.robot.capsules import arm_with, load_capsules
from safety_harness.cell.robot.closest_approach import MAX_BISECTIONS, closest_approach_between
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import hand_distance, hand_distance_from, place_capsules
from tests.cell.robot.arms import random_joints, transforms_of

ARM = load_arm("ur10")
CAPSULES = load_capsules("ur10").with_capsule("camera", 7, (0.0, -0.045, 0.0), (0.0, -0.045, 0.02), 0.05)
HAND_RADIUS_M, FOREARM_RADIUS_M = 0.060, 0.045
TOLERANCE_M = 1e-4


def placed_at(joints: np.ndarray) -> np.ndarray:
    placed = np.full((len(CAPSULES.names), 2, 3), np.nan)
    place_capsules(CAPSULES.records, transforms_of(ARM, joints), placed)
    return placed


def distance_at(joints: np.ndarray, hand: np.ndarray, elbow: np.ndarray) -> tuple[float, int]:
    return hand_distance(CAPSULES.records, placed_at(joints), hand, elbow, HAND_RADIUS_M, FOREARM_RADIUS_M)


def random_hands(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Hands anywhere in the arm's reach, with a forearm of 0.3 m."""
    rng = np.random.default_rng(seed)
    hands = []
    for _ in range(count):
        way = rng.normal(size=3)
        hand = rng.uniform(-1.0, 1.0, 3)
        hands.append((hand, hand + 0.3 * way / np.linalg.norm(way)))
    return hands


def coal_capsule(a: np.ndarray, b: np.ndarray, radius: float) -> tuple[coal.Capsule, coal.Transform3s]:
    """A capsule of the library lies along its own z, centred."""
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return coal.Capsule(radius, length), coal.Transform3s(
        np.column_stack((x, np.cross(z, x), z)), (a + b) / 2
    )


def coal_distance(first: tuple, second: tuple) -> float:
    return float(coal.distance(*first, *second, coal.DistanceRequest(), coal.DistanceResult()))


def test_distances_and_the_nearest_capsule_are_those_of_the_library() -> None:
    penetrations = 0
    for joints, (hand, elbow) in zip(
        random_joints(ARM, 150, seed=31), random_hands(150, seed=32), strict=True
    ):
        ours, nearest = distance_at(joints, hand, elbow)
        bodies = [(coal.Sphere(HAND_RADIUS_M), coal.Transform3s(np.eye(3), hand))]
        bodies.append(coal_capsule(hand, elbow, FOREARM_RADIUS_M))
        each = [
            min(coal_distance(coal_capsule(a, b, r), body) for body in bodies)
            for (a, b), r in zip(placed_at(joints), CAPSULES.radius_m, strict=True)
        ]
        if min(each) > 0.0:
            noted("coal", "distance of hand and capsules", "mm", ours, min(each), 1e3)
            assert ours == pytest.approx(min(each), abs=1e-6)
            assert each[nearest] == pytest.approx(min(each), abs=1e-6)
        else:
            penetrations += 1
            assert ours <= 0.0
    assert 0 < penetrations < 140


def test_whichever_capsule_is_looked_at_first_the_distance_is_the_same_to_the_bit() -> None:
    records, radii = CAPSULES.records, (HAND_RADIUS_M, FOREARM_RADIUS_M)
    for joints, (hand, elbow) in zip(random_joints(ARM, 10, seed=35), random_hands(10, seed=36), strict=True):
        for lost in (False, True):
            ends = placed_at(joints)
            ends[3 if lost else 0, 0, 0] += np.nan if lost else 0.0
            expected = hand_distance(records, ends, hand, elbow, *radii)
            assert np.isnan(expected[0]) == lost
            for likely in range(-1, len(CAPSULES.names)):
                found = hand_distance_from(records, ends, hand, elbow, *radii, likely)
                np.testing.assert_array_equal(found, expected)


def test_the_distance_is_never_longer_than_to_the_meshes() -> None:
    """To the meshes' own triangles: several capsules hold a link's surface, not its convex hull."""
    models = []
    for link in ARM.links:
        mesh = trimesh.load_mesh(link.collision[0].file)
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(mesh.faces), len(mesh.vertices))
        model.addVertices(np.asarray(mesh.vertices))
        model.addTriangles(np.asarray(mesh.faces, dtype=np.int64))
        model.endModel()
        models.append(model)
    gaps = []
    for joints, (hand, elbow) in zip(random_joints(ARM, 60, seed=33), random_hands(60, seed=34), strict=True):
        ours, _ = distance_at(joints, hand, elbow)
        frames = [coal.Transform3s(t[:3, :3], t[:3, 3]) for t in transforms_of(ARM, joints)[:7]]
        sphere = (coal.Sphere(HAND_RADIUS_M), coal.Transform3s(np.eye(3), hand))
        forearm = coal_capsule(hand, elbow, FOREARM_RADIUS_M)
        exact = min(
            coal_distance((model, frame), body)
            for model, frame in zip(models, frames, strict=True)
            for body in (sphere, forearm)
        )
        if exact > 0.0:
            assert ours <= exact + 1e-6
            gaps.append(exact - ours)
    assert len(gaps) > 20
    assert np.median(gaps) < 0.05  # and yet close: the capsules are no balloons


def closest(
    q: np.ndarray, hand: np.ndarray, elbow: np.ndarray, tolerance_m: float, not_below_m: float = np.inf
) -> tuple[float, float]:
    """``closest_approach_between`` with pairs (before, after)."""
    room = np.empty((MAX_BISECTIONS + 1, len(CAPSULES.names), 2, 3))
    bound, t, _, _ = closest_approach_between(
        arm_with(ARM, CAPSULES),
        room,
        *q,
        *hand,
        *elbow,
        HAND_RADIUS_M,
        FOREARM_RADIUS_M,
        tolerance_m,
        not_below_m,
    )
    return bound, t


def random_motion(rng: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = rng.uniform(-np.pi, np.pi, 6)
    hand = rng.uniform(-1.0, 1.0, 3)
    elbow = hand + np.array([0.0, -0.3, 0.0])
    return tuple(np.array([x, x + size * rng.normal(size=x.shape)]) for x in (q, hand, elbow))


def sampled(motion: tuple[np.ndarray, np.ndarray, np.ndarray], times: np.ndarray) -> np.ndarray:
    return np.array([distance_at(*((1.0 - t) * x[0] + t * x[1] for x in motion))[0] for t in times])


@pytest.mark.parametrize("size", [0.003, 0.03, 0.3, 2.0])
def test_the_bound_is_below_every_sample_and_within_tolerance_of_the_least(size: float) -> None:
    rng = np.random.default_rng(35)
    inside = 0
    for _ in range(60):
        motion = random_motion(rng, size)
        bound, fraction = closest(*motion, TOLERANCE_M)
        assert 0.0 <= fraction <= 1.0
        values = sampled(motion, np.linspace(0.0, 1.0, 301))
        at_fraction = sampled(motion, np.array([fraction]))[0]
        assert bound <= min(values.min(), at_fraction) + 1e-12
        assert bound >= at_fraction - TOLERANCE_M - 1e-12
        inside += 0.0 < fraction < 1.0
    assert inside > 0 or size < 0.3  # short motions may all be monotonic


def test_a_hand_that_flies_past_between_two_samples_is_noticed() -> None:
    """Both ends are far away; the way between them leads right past the wrist."""
    joints = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])
    tcp = transforms_of(ARM, joints)[7, :3, 3]
    hand = tcp + np.array([[0.0, -1.0, -0.15], [0.0, 1.0, -0.15]])
    elbow = hand + np.array([0.0, 0.0, -0.3])
    motion = (np.array([joints, joints]), hand, elbow)
    ends = sampled(motion, np.array([0.0, 1.0]))
    bound, fraction = closest(*motion, TOLERANCE_M)
    assert ends.min() > 0.2
    assert bound < 0.1
    least = sampled(motion, np.linspace(0.0, 1.0, 4001)).min()
    assert least - TOLERANCE_M - 1e-6 <= bound <= least
    assert sampled(motion, np.array([fraction]))[0] == pytest.approx(least, abs=TOLERANCE_M)


def test_nothing_moves_so_the_bound_is_the_distance() -> None:
    rng = np.random.default_rng(36)
    for _ in range(20):
        motion = random_motion(rng, 0.0)
        assert closest(*motion, TOLERANCE_M)[0] == pytest.approx(sampled(motion, np.zeros(1))[0], abs=1e-12)


def test_pruning_never_lifts_the_bound_nor_drops_it_below_what_was_asked() -> None:
    rng = np.random.default_rng(37)
    pruned = 0
    for _ in range(100):
        motion = random_motion(rng, 0.1)
        full, _ = closest(*motion, TOLERANCE_M)
        quick, _ = closest(*motion, TOLERANCE_M, 0.1)
        least = sampled(motion, np.linspace(0.0, 1.0, 101)).min()
        assert quick <= least + 1e-12
        if full < 0.1 - TOLERANCE_M:
            assert quick >= full - 2.0 * TOLERANCE_M
        elif full > 0.1:
            assert quick >= 0.1 - TOLERANCE_M
            pruned += quick < full
    assert pruned > 0


def test_a_zero_tolerance_is_refused() -> None:
    with pytest.raises(ValueError, match="tolerance_m"):
        closest(*random_motion(np.random.default_rng(38), 0.1), 0.0)


@pytest.mark.parametrize("broken", range(3))
def test_a_nan_is_not_hidden(broken: int) -> None:
    motion = random_motion(np.random.default_rng(39), 0.1)
    motion[broken][1, 1] = np.nan
    assert np.isnan(closest(*motion, TOLERANCE_M)[0])
    values = [x[1] for x in motion]
    assert np.isnan(distance_at(*values)[0])
