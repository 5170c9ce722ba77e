"""As many hands as a scenario has: up to eight, in both worlds, and none is overlooked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import hand, scenario

from safety_harness import admit, judge, run_trial
from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.settings import DEFAULTS, HAND_SLOTS, HandSensorKind
from safety_harness.cell.simulation.simulate import Episode, simulate_many
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.model import MAX_HANDS, Claim, MovingHand, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, ReachForTcp, Wait, Withdraw
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.space.read import read_space
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import TICK, TRACKS_PER_HAND, tick_dtype
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
DISTANCE = "hand distance never below 50 mm"
CLAIMS = (
    DISTANCE,
    "hand predictions within 50 mm",
    "starts retreating within 100 ms of a predicted hand",
    "repulsion moves away from every hand",
    "repulsive poses reachable",
    "protective separation kept",
    "trace finite and monotone",
)
NOISY = replace(
    DEFAULTS,
    hand_sensor=replace(
        DEFAULTS.hand_sensor,
        kind=HandSensorKind.OVERHEAD,
        pixel_noise_px=1.0,
        depth_noise_per_m=0.002,
        dropout_probability=0.1,
    ),
)
PLACES = ((840, -350, 250), (1000, -150, 300), (880, -300, 400), (1000, -50, 200))
VISITORS = tuple(
    hand(
        Wait(duration_s=0.1 + 0.4 * k),
        MoveTo(position_in_base_m=(x / 1e3, y / 1e3, z / 1e3), speed_mps=0.8),
        Wait(duration_s=0.3),
        Withdraw(speed_mps=0.8),
        at=(1.2, -0.8 + 0.15 * k, 0.2 + 0.05 * k),
        name=f"hand {k + 1}",
    )
    for k, (x, y, z) in enumerate(PLACES * 2)
)
# Records for eight hands are compiled for them alone; those for four are of what is compiled beforehand.
EIGHT = pytest.param(MAX_HANDS, marks=pytest.mark.long)
IDLE = tuple(hand(at=(-0.5 - 0.3 * k, 3.0, 0.2), name=f"idle {k + 1}") for k in range(MAX_HANDS - 1))


def with_hands(*hands: MovingHand, settings: object = DEFAULTS, duration_s: float = 3.0) -> Scenario:
    claims = tuple(Claim(sentence=sentence, expected=Verdict.HOLDS) for sentence in CLAIMS)
    what = scenario(*hands, duration_s=duration_s, settings=settings)  # type: ignore[arg-type]
    return replace(what, claims=claims)


def tried(what: Scenario, world: WorldEntry = KINEMATIC) -> Trace:
    return run_trial(admit(what), world=world)


def said_of_distance(trace: Trace) -> Evaluation:
    return judge(trace)[CLAIMS.index(DISTANCE)]


@pytest.mark.parametrize("count", [3, EIGHT])
def test_both_worlds_see_every_hand_and_agree(count: int) -> None:
    what = with_hands(*VISITORS[:count])
    traces = [tried(what, world) for world in (PYBULLET, KINEMATIC)]
    for trace in traces:
        there = np.arange(trace.ticks["hand_present"].shape[1]) < count
        assert np.array_equal(trace.ticks["hand_present"].all(axis=0), there)
        assert np.array_equal(np.isfinite(trace.ticks["hand_distance_m"]).all(axis=0), there)
        assert trace.ticks["track_valid"].sum(axis=1).max() == count
        assert len(trace.decisions) > 0
    verdicts, others = ([e.verdict for e in judge(trace)] for trace in traces)
    assert verdicts == others
    assert Verdict.VIOLATED in verdicts
    assert Verdict.HOLDS in verdicts


@pytest.mark.parametrize("count", [4, EIGHT])
@pytest.mark.parametrize("world", [PYBULLET, KINEMATIC], ids=["pybullet", "kinematic"])
def test_the_last_hand_alone_violates_a_claim(world: WorldEntry, count: int) -> None:
    others = count - 1
    grabs = hand(ReachForTcp(speed_mps=2.0, until_distance_m=0.0, at_most_s=3.0), name="grabs")
    without = tried(with_hands(*IDLE[:others], duration_s=1.0), world)
    grabbed = tried(with_hands(*IDLE[:others], grabs, duration_s=1.0), world)
    assert said_of_distance(without).verdict is not Verdict.VIOLATED
    found = said_of_distance(grabbed)
    assert found.verdict is Verdict.VIOLATED
    assert found.margin is not None
    assert grabbed.ticks["hand_distance_m"][:, :others].min() > 1.0
    assert found.margin == pytest.approx(grabbed.ticks["hand_distance_m"][:, others].min() - 0.05, abs=1e-3)


@pytest.mark.parametrize("count", [4, EIGHT])
@pytest.mark.parametrize("world", [PYBULLET, KINEMATIC], ids=["pybullet", "kinematic"])
def test_hands_that_nobody_sees_or_meets_change_no_motion_and_no_margin(
    world: WorldEntry, count: int
) -> None:
    """The sensor's noise is that of two hands: it goes by a box's place in its frame."""
    two, all_of_them = (
        tried(with_hands(*VISITORS[:2], *more, settings=NOISY), world) for more in ((), IDLE[: count - 2])
    )
    assert len(two.decisions) > 0
    for ours, theirs in ((two.decisions, all_of_them.decisions), (two.ticks, all_of_them.ticks)):
        for name in ours.dtype.names or ():
            one, other = ours[name], theirs[name]
            other = other if other.shape == one.shape else other[:, : one.shape[1]]
            assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f"), name
    for sentence, one, other in zip(CLAIMS, judge(two), judge(all_of_them), strict=True):
        if "every hand" not in sentence:  # wherever that hand is
            assert (one.verdict, one.margin) == (other.verdict, other.margin), sentence


@pytest.mark.parametrize("counts", [(2, 3), pytest.param((2, 3, 8), marks=pytest.mark.long)])
def test_a_batch_of_two_three_and_eight_hands_gives_what_each_gives_alone(counts: tuple[int, ...]) -> None:
    admitted = [admit(with_hands(*VISITORS[:count], settings=NOISY)) for count in counts]
    alone = [run_trial(one, world=KINEMATIC) for one in admitted]
    episodes = []
    for one in admitted:
        world = KINEMATIC.open(one.scenario, one.arm, one.joint_position_rad)
        episodes.append(Episode(one.scenario, world, one.controller()))  # type: ignore[arg-type]
    for trace, same in zip(simulate_many(episodes), alone, strict=True):
        assert first_difference(trace, same) is None


@pytest.mark.parametrize("count", [0, 2, 3, EIGHT])
def test_a_trace_is_saved_and_loaded_without_loss_and_judged_the_same(count: int, tmp_path: Path) -> None:
    trace = tried(with_hands(*VISITORS[:count], duration_s=1.0))
    save_trace(trace, tmp_path / "trace.zip")
    again = load_trace(tmp_path / "trace.zip")
    assert again.ticks.dtype == trace.ticks.dtype
    assert first_difference(trace, again) is None
    assert judge(again) == judge(trace)


def test_records_have_room_for_the_hands_and_hardly_more() -> None:
    room = [with_hands(*VISITORS[:count]).hand_slots for count in range(MAX_HANDS + 1)]
    assert room == [2, 2, 2, 4, 4, 8, 8, 8, 8]
    assert tick_dtype(2) is TICK
    for hands in HAND_SLOTS:
        ticks = np.zeros(1, tick_dtype(hands))
        assert ticks["hand_present"].shape[1] == hands
        assert ticks["track_valid"].shape[1] == TRACKS_PER_HAND * hands


def test_a_ninth_hand_is_refused_in_a_file_and_in_python() -> None:
    nine = with_hands(*VISITORS, hand(name="one too many"))
    with pytest.raises(ScenarioError, match="hands: expected a list of at most 8 hands"):
        parse_scenario(write_scenario(nine), Path("nine.yaml"))
    with pytest.raises(ScenarioError, match="hands: expected at most 8 hands; got 9"):
        admit(nine)


def test_a_space_may_have_more_than_two_hands(tmp_path: Path) -> None:
    text = (SCENARIOS / "spaces" / "reaching-hands.yaml").read_text()
    other = """  - hand: NAME hand
    starts at: {box: [[1300 mm, -200 mm, 100 mm], [1500 mm, 200 mm, 500 mm]]}
    elbow towards: [1900 mm, 0 mm, 400 mm]
    moves: []
"""
    more = "".join(other.replace("NAME", name) for name in ("third", "fourth"))
    (tmp_path / "space.yaml").write_text(text.replace("claims:\n", f"{more}claims:\n"))
    drawn = read_space(tmp_path / "space.yaml").draw(1, 0)
    names = ["reaching hand", "resting hand", "third hand", "fourth hand"]
    assert [one.name for one in drawn.hands] == names
    assert tried(drawn).ticks["hand_present"].sum(axis=1).tolist() == [4] * (drawn.ticks + 1)
