"""What the measurements measure, on few and small examples."""

from __future__ import annotations

import shutil
from dataclasses import replace
from math import log
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import Proposal, Vector
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.cell.controller.desired import reachable
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.space.read import read_space
from safety_harness.space.regions import paper_seen
from safety_harness_paper.avoiders import ExactOptimum, without_networks
from safety_harness_paper.networks import MODEL
from safety_harness_paper.outlook import IMAGE, POSE
from safety_harness_paper.outlook import measure as by_both_errors
from safety_harness_paper.reach import WORKSPACE, Region, reachable_starts
from safety_harness_paper.safety import nominal_space
from safety_harness_paper.trials import TRIGGER_TICK, run, starts_of
from safety_harness_paper.two_hands import EITHER, PLANE, WALL, plane_distance
from safety_harness_paper.two_hands import measure as by_triggers
from safety_harness_paper.work import Done

SPACES = Path(__file__).parents[2] / "scenarios" / "spaces"
HAND = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)


class Fixed:
    """Always the same place."""

    name = "fixed"

    def __init__(self, position: Vector) -> None:
        self.position = position

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        return Proposal(self.position)


@pytest.fixture(scope="module")
def start():  # type: ignore[no-untyped-def]
    (one,), _ = starts_of(DEFAULTS, 1, 7)
    return one


def test_iterations_are_those_of_the_closed_form(start) -> None:  # type: ignore[no-untyped-def]
    away_m = 0.15
    trial = run(start, Fixed(DESIRED + [0.0, away_m, 0.0]), HAND, seed=0)
    servo, period_s = DEFAULTS.servo, DEFAULTS.clock.control_period_s
    expected = log(away_m / servo.gain_switch_sse**0.5) / (servo.gain_far * period_s)
    assert trial.fate == "converged"
    assert trial.iterations == pytest.approx(expected, abs=12)  # it has to get up to speed
    assert trial.arrival_error_m == pytest.approx(away_m, abs=0.0015)


def test_an_arrival_below_the_switch_takes_no_iteration(start) -> None:  # type: ignore[no-untyped-def]
    trial = run(start, Fixed(DESIRED + [0.0, 0.05, 0.0]), HAND, seed=0)
    assert (trial.fate, trial.iterations) == ("converged", 0)


def test_what_the_arm_cannot_reach_is_refused_and_not_run(start) -> None:  # type: ignore[no-untyped-def]
    assert run(start, Fixed(DESIRED + [2.0, 0.0, 0.0]), HAND, seed=0).fate == "refused"


def test_a_place_without_the_object_in_view_never_converges(start) -> None:  # type: ignore[no-untyped-def]
    trial = run(start, Fixed(DESIRED + [0.0, 0.5, -0.3]), HAND, seed=0)
    assert (trial.fate, trial.iterations) == ("lost", None)


def test_without_avoidance_counting_begins_at_the_trigger(start) -> None:  # type: ignore[no-untyped-def]
    trial = run(start, None, HAND, seed=0, record=True)
    assert trial.record["arrival"] == TRIGGER_TICK
    assert trial.record["switch"] == TRIGGER_TICK + trial.iterations
    assert len(trial.record["camera_twist"]) == trial.record["switch"] + 1 + 125


def test_starts_of_trials_lie_outside_the_training_range() -> None:
    starts, _ = starts_of(DEFAULTS, 4, 3)
    seen = paper_seen(DEFAULTS).tcp
    places = np.array([one.scenario.start.position_in_base_m for one in starts])  # type: ignore[union-attr]
    assert not seen.contains(places).any()
    assert seen.grown(2.0).contains(places).all()


def test_at_the_edge_of_reach_something_near_is_out_of_it() -> None:
    kinematics = InverseKinematics(load_arm())
    rng = np.random.default_rng(1)
    starts, redrawn = reachable_starts(
        DEFAULTS, kinematics, Region(WORKSPACE, paper_seen(DEFAULTS).tcp), 5, rng, edge=True
    )
    places = np.array([pose[:3, 3] for pose, _ in starts])
    assert redrawn > 0
    assert reachable(places, DEFAULTS).all()
    directions = rng.normal(size=(5, 300, 3))
    directions /= np.linalg.norm(directions, axis=2)[..., None]
    around = places[:, None] + 0.1 * directions
    assert not any(reachable(one, DEFAULTS).all() for one in around)


def test_the_exact_optimum_is_as_good_as_the_best_of_many_candidates() -> None:
    settings = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, hand_pull=0.0))
    tcp = DESIRED + [0.05, -0.12, 0.08]
    found = ExactOptimum(settings).propose(hand_position_in_base_m=HAND, tcp_position_in_base_m=tcp, seed=0)
    candidates = tcp + replace(CandidateCap.from_settings(settings), count=20_000).draw(
        np.random.default_rng(0)
    )
    best = np.linalg.norm(candidates - DESIRED, axis=1).min()
    distance = np.linalg.norm(found.position_in_base_m - DESIRED)
    assert best - 0.002 < distance <= best + 1e-9


def test_systems_without_networks_give_way_by_the_radius() -> None:
    for avoider in without_networks(DEFAULTS).values():
        away = avoider.propose(hand_position_in_base_m=HAND, tcp_position_in_base_m=DESIRED, seed=1)
        assert 0.07 < np.linalg.norm(away.position_in_base_m - DESIRED) < 0.14


def test_the_nominal_space_is_the_shipped_one() -> None:
    ours, shipped = nominal_space(), read_space(SPACES / "nominal.yaml")
    assert ours.dimension == shipped.dimension
    for k in range(3):
        a, b = ours.draw(5, k), shipped.draw(5, k)
        assert (a.hands, a.start, a.duration_s, a.seed) == (b.hands, b.start, b.duration_s, b.seed)


def test_with_exact_images_of_an_upright_camera_both_errors_select_the_same(tmp_path: Path) -> None:
    found = by_both_errors(tmp_path, tcps=50, trials=1, draw_seed=2, settings=DEFAULTS)
    exact, sampled, slight, more = found["selections"]
    assert (exact["same"], exact["apart_rms_m"]) == (exact["tcps"], 0.0)
    assert sampled["same"] > 0.8 * sampled["tcps"]
    assert slight["same"] < slight["tcps"]
    assert more["farther_from_goal_m"] > 0.0
    assert {name for trial in found["trials"] for name in trial["systems"]} == {IMAGE, POSE}


@pytest.mark.parametrize(
    ("point", "plane_m", "wall_m"),
    [((0.5, 0.3, 7.0), 0.3, 0.3), ((2.0, 0.3, 0.0), 0.3, 1.044), ((-3.0, 0.0, 0.0), 0.0, 3.0)],
)
def test_a_plane_goes_on_where_a_wall_ends(
    point: tuple[float, float, float], plane_m: float, wall_m: float
) -> None:
    first, second = np.array([0.0, 0.0, 0.2]), np.array([1.0, 0.0, 0.9])
    for wall, expected in ((False, plane_m), (True, wall_m)):
        assert plane_distance(np.array(point), first, second, wall=wall) == pytest.approx(expected, abs=1e-3)


def test_two_hands_above_each_other_are_a_line() -> None:
    hand = np.array([0.0, 0.0, 0.0])
    above = np.array([0.0, 0.0, 1.0])
    assert plane_distance(np.array([0.3, 0.4, 0.0]), hand, above, wall=False) == pytest.approx(0.5)


def test_the_triggers_see_the_same_draw_and_an_endless_plane_asks_most(tmp_path: Path) -> None:
    trained = tmp_path / "trained"
    trained.mkdir()
    shutil.copy(shipped_model("mc-dropout"), trained / MODEL)
    found = by_triggers(tmp_path, Done(trained, {}), episodes=1, draw_seed=3, settings=DEFAULTS)["triggers"]
    assert set(found) == {EITHER, PLANE, WALL}
    (hand,), (plane,), (wall,) = found[EITHER], found[PLANE], found[WALL]
    assert plane["decisions"] > max(wall["decisions"], hand["decisions"])
    assert all(0.0 <= one["share_servoing"] <= 1.0 for one in (hand, plane, wall))
