"""Questions are drawn where runs can ask them, and what no run asks is a region of its own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.desired import reachable
from safety_harness.extensions.lab.scoring.regions import FAR, NAMED, named_regions
from safety_harness.extensions.lab.scoring.space_region import space_region
from safety_harness.scenario.robots import Robot
from safety_harness.space.read import read_space
from safety_harness.space.regions import paper_seen, region_named

SEEN = paper_seen(DEFAULTS)
REGIONS = {one.name: one for one in named_regions(SEEN, DEFAULTS)}
SPACES = Path(__file__).parents[3] / "scenarios" / "spaces"


@pytest.mark.parametrize(("name", "hand", "tcp"), NAMED)
def test_a_named_region_is_that_of_the_table_within_the_critical_distance(
    name: str, hand: str, tcp: str
) -> None:
    drawn = REGIONS[name].draw(np.random.default_rng(0), 500)
    assert len(drawn) == 500
    assert region_named(hand, SEEN, DEFAULTS).contains(drawn.hands_in_base_m).all()
    assert region_named(tcp, SEEN, DEFAULTS).contains(drawn.tcps_in_base_m).all()
    distance_m = np.linalg.norm(drawn.hands_in_base_m - drawn.tcps_in_base_m, axis=1)
    assert distance_m.max() < DEFAULTS.avoidance.critical_distance_m
    assert REGIONS[name].asked_in_runs


def test_what_is_far_is_named_as_what_no_run_asks() -> None:
    drawn = REGIONS[FAR].draw(np.random.default_rng(0), 100)
    distance_m = np.linalg.norm(drawn.hands_in_base_m - drawn.tcps_in_base_m, axis=1)
    assert distance_m.min() >= DEFAULTS.avoidance.critical_distance_m
    assert not REGIONS[FAR].asked_in_runs
    assert "no run asks" in REGIONS[FAR].about


def test_a_region_without_any_askable_pair_gives_none() -> None:
    settings = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, critical_distance_m=0.01))
    seen = named_regions(SEEN, settings)[1]
    assert len(seen.draw(np.random.default_rng(0), 50)) == 0


def test_draws_hang_on_the_generator_alone() -> None:
    one, again = (REGIONS["seen"].draw(np.random.default_rng(5), 50) for _ in range(2))
    assert one.hands_in_base_m.tobytes() == again.hands_in_base_m.tobytes()
    assert one.seeds.tobytes() == again.seeds.tobytes()


def test_a_space_leads_to_hands_of_its_programs_near_tcps_about_its_way() -> None:
    space = read_space(SPACES / "unseen-tcp.yaml")
    region = space_region(space, seed=1, draws=10)
    drawn = region.draw(np.random.default_rng(0), 300)
    assert len(drawn) == 300
    near_m, radius_m = DEFAULTS.avoidance.critical_distance_m, DEFAULTS.avoidance.radius_m
    assert np.linalg.norm(drawn.hands_in_base_m - drawn.tcps_in_base_m, axis=1).max() < near_m
    tcps = region_named("unseen tcp", SEEN, DEFAULTS).outer
    grown = tcps.grown(1.0 + 2.0 * radius_m / min(np.subtract(tcps.high_m, tcps.low_m)))
    assert grown.contains(drawn.tcps_in_base_m).all()
    assert not region_named("seen tcp", SEEN, DEFAULTS).contains(drawn.tcps_in_base_m).all()


AHEAD_M = np.linspace(0.2, 1.4, 13)
PLACES = np.stack([AHEAD_M, 0.0 * AHEAD_M, np.full(13, 0.25)], axis=1)


@pytest.mark.parametrize(("robot", "farthest_m"), [(Robot.UR3, 0.5), (Robot.UR5, 0.8), (Robot.UR10, 1.2)])
def test_what_can_be_reached_is_a_matter_of_the_robot(robot: Robot, farthest_m: float) -> None:
    assert AHEAD_M[reachable(PLACES, DEFAULTS, robot)].max() == pytest.approx(farthest_m)


def test_questions_of_a_space_are_within_the_reach_of_its_robot(tmp_path: Path) -> None:
    text = (SPACES.parent / "robot-ur5.yaml").read_text().replace("scenario:", "scenario space:", 1)
    (tmp_path / "space.yaml").write_text(
        text.replace("seed: 71\n", "").replace("[40 mm,", "[from 0 mm to 40 mm,")
    )
    region = space_region(read_space(tmp_path / "space.yaml"), seed=1, draws=5)
    drawn = replace(region, pairs=lambda *_: (PLACES, PLACES)).draw(np.random.default_rng(0), 13)
    assert drawn.tcps_in_base_m[:, 0].max() == pytest.approx(0.8)
