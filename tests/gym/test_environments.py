"""Worlds as Gymnasium environments, one by one and many at once."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import ControllerError, InputError, MissingPackageError
from safety_harness.extensions.gym.environment import HarnessEnv
from safety_harness.extensions.gym.stable_baselines import StableBaselinesEnv
from safety_harness.extensions.gym.vector import HarnessVectorEnv
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.seams.contract import Move
from safety_harness.space.read import parse_space

VISIT = """
scenario{kind}: a hand comes near and leaves
duration: 0.4 s
tcp start:
  offset: [{offset}, -60 mm, 60 mm]
hands:
  - hand: right hand
    starts at: [860 mm, -350 mm, 350 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -250 mm, 350 mm]
        speed: 1 m/s
claims:
  hand distance never below 50 mm: holds
"""
NEAR = "always hand distance > 300 mm"
SCENARIO = parse_scenario(VISIT.format(kind="", offset="30 mm"))
SPACE = parse_space(VISIT.format(kind=" space", offset="from -40 mm to 40 mm"))
TICKS = SCENARIO.ticks
NOISE = "hand sensor:\n  kind: overhead\n  pixel noise: 3 px\n"
WANDERING = parse_scenario(VISIT.format(kind="", offset="30 mm").replace("leaves", "goes") + NOISE)


@pytest.fixture(scope="module")
def one() -> Iterator[HarnessEnv]:
    env = HarnessEnv(space=SPACE, rewards={"progress": 1.0, NEAR: 2.0})
    yield env
    env.close()


def episode(env: HarnessEnv, seed: int) -> tuple[list[dict[str, Any]], list[float], dict[str, Any]]:
    """Observations, rewards and the last info, under actions drawn from the seed."""
    rng = np.random.default_rng(seed)
    seen, info = env.reset(seed=seed)
    every, rewards, over = [seen], [], False
    while not over:
        seen, reward, terminated, truncated, info = env.step(rng.uniform(-0.2, 0.2, 3))
        every.append(seen)
        rewards.append(reward)
        over = terminated or truncated
    return every, rewards, info


def alike(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return all(np.array_equal(array, other[name]) for name, array in one.items())


def test_what_the_page_begins_with_works_in_a_program_of_its_own() -> None:
    root = Path(__file__).parents[2]
    code = (root / "docs" / "how-to" / "environments.md").read_text().split("```python\n")[1].split("```")[0]
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.filterwarnings("ignore")  # that positions have no bounds, and are no pixels
def test_it_passes_the_checks_of_gymnasium_and_of_stable_baselines() -> None:
    env = gymnasium.make("safety_harness.extensions.gym:SafetyHarness-v0", space="shipped:unseen-both")
    check_env(env.unwrapped, skip_render_check=True)
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    check_for_sb3(env.unwrapped)
    env.close()


def test_a_seed_gives_the_same_episodes_again_and_another_seed_others(one: HarnessEnv) -> None:
    first, again, other = episode(one, 3), episode(one, 3), episode(one, 4)
    assert first[1] == again[1]
    assert all(map(alike, first[0], again[0]))
    assert first[1] != other[1]
    assert len(first[1]) == TICKS


def test_a_reward_is_progress_and_what_the_margin_is_below_zero(one: HarnessEnv) -> None:
    _, rewards, info = episode(one, 5)
    ticks, desired = one.trace().ticks, np.array(SCENARIO.settings.cell.desired_tcp_position_in_base_m)
    left = np.linalg.norm(ticks["transform_tcp_to_base"][:, :3, 3] - desired, axis=1)
    distance = np.where(ticks["hand_present"], ticks["hand_distance_m"], np.inf).min(axis=1)
    wanted = -np.diff(left) + 2.0 * 0.008 * np.minimum(distance[1:] - 0.3, 0.0)
    np.testing.assert_allclose(rewards, wanted, atol=1e-12)
    assert (distance < 0.3).any()  # or it would show nothing
    assert info["margins"][NEAR] == pytest.approx(distance.min() - 0.3)


@dataclass
class Steady:
    """Moves by the same velocity at every tick."""

    name: str = "steady"
    sees: tuple[str, ...] = ("joints", "predicted hands")
    told: np.ndarray = field(default_factory=lambda: np.array([0.02, -0.01, 0.03]))

    def reset(self, **start: Any) -> None:
        """Nothing is carried over."""

    def act(self, seen: Any) -> Move:
        """As told."""
        return Move(tcp_velocity_mps=self.told)


def test_its_trace_is_that_of_a_controller_that_acts_alike_bit_for_bit() -> None:
    env = HarnessEnv(scenario=SCENARIO)
    env.reset()
    for _ in range(TICKS):
        env.step(Steady().told)
    own, run = env.trace(), run_kinematic(admit(SCENARIO, controller=Steady()))
    env.close()
    assert own.complete
    assert len(own.ticks) == TICKS + 1
    for name in ("joint_position_rad", "demanded_joint_velocity_radps", "hand_distance_m", "limits"):
        np.testing.assert_array_equal(own.ticks[name], run.ticks[name])


def test_an_episode_that_a_claim_ends_is_terminated_and_its_trace_is_incomplete() -> None:
    env = HarnessEnv(scenario=SCENARIO, ends=(NEAR,))
    env.reset()
    over, steps = False, 0
    while not over:
        *_, terminated, truncated, info = env.step(np.zeros(3))
        over, steps = terminated or truncated, steps + 1
    assert terminated
    assert steps < TICKS
    assert info["margins"][NEAR] < 0.0
    assert not env.trace().complete
    with pytest.raises(ControllerError, match="the episode is over"):
        env.step(np.zeros(3))
    env.close()


def test_lanes_are_the_single_environments_bit_for_bit(one: HarnessEnv) -> None:
    lanes = HarnessVectorEnv(3, space=SPACE, rewards={"progress": 1.0, NEAR: 2.0})
    seeds = range(7, 10)
    singles = [episode(one, seed) for seed in seeds]
    rngs = [np.random.default_rng(seed) for seed in seeds]
    seen, _ = lanes.reset(seed=7)
    for k in range(TICKS):
        for lane, (every, _, _) in enumerate(singles):
            assert alike(every[k], {name: array[lane] for name, array in seen.items()})
        actions = np.array([rng.uniform(-0.2, 0.2, 3) for rng in rngs])
        seen, reward, _, truncated, info = lanes.step(actions)
        assert [rewards[k] for _, rewards, _ in singles] == reward.tolist()
    assert truncated.all()
    assert info["_final_obs"].all()
    for lane, (every, _, last) in enumerate(singles):
        assert alike(every[-1], info["final_obs"][lane])
        assert {name: last[name] for name in ("cost", "is_success", "scenario")} == {
            name: info["final_info"][name][lane] for name in ("cost", "is_success", "scenario")
        }
        assert last["margins"][NEAR] == info["final_info"]["margins"][NEAR][lane]
    lanes.close()


@pytest.mark.parametrize("varied", [{"space": SPACE}, {"scenario": WANDERING}], ids=["space", "scenario"])
@pytest.mark.parametrize("kind", ["lanes", "sync", "async", "stable-baselines"])
def test_each_lane_has_its_own_stream_without_a_seed(kind: str, varied: dict[str, Any]) -> None:
    """After ``reset()`` no two lanes of a vector run the same episode, of whichever kind it is."""
    if kind in ("sync", "async"):
        envs: Any = gymnasium.make_vec(
            "safety_harness.extensions.gym:SafetyHarness-v0", num_envs=3, vectorization_mode=kind, **varied
        )
    else:
        envs = HarnessVectorEnv(3, **varied)
    if kind == "stable-baselines":
        envs = StableBaselinesEnv(envs)
        envs.reset()
        envs.step_async(np.zeros((3, 3), np.float32))
        seen = envs.step_wait()[0]
    else:
        envs.reset()
        for _ in range(20):
            seen, *_ = envs.step(np.zeros((3, 3)))
    envs.close()
    rows = np.hstack([np.reshape(array, (3, -1)) for array in seen.values()])
    assert len(np.unique(rows, axis=0)) == 3


def test_an_environment_made_alone_runs_the_scenario_as_it_stands() -> None:
    """So does the next one, once it is closed."""
    for _ in range(2):
        env = HarnessEnv(scenario=WANDERING)
        env.reset()
        assert env.trace().scenario.seed == WANDERING.seed
        env.close()


def test_stable_baselines_gets_fields_held_actions_and_the_last_observation() -> None:
    lanes = HarnessVectorEnv(2, space=SPACE, rewards={NEAR: 1.0})
    beside = HarnessVectorEnv(2, space=SPACE, rewards={NEAR: 1.0})
    env = StableBaselinesEnv(lanes, ("tcp_position_in_base_m",), ticks=7)
    env.seed(3)
    seen = env.reset()
    beside.reset(seed=3)
    assert {name: array.dtype for name, array in seen.items()} == {"tcp_position_in_base_m": np.float32}
    actions, total, steps = np.full((2, 3), 0.5, np.float32), np.zeros(2), 0
    while True:
        seen, reward, over, infos = env.step(actions)
        total, steps = total + reward, steps + 1
        if over.any():
            break
    assert steps == -(-TICKS // 7)
    assert over.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    told = [beside.step(lanes.single_action_space.high * actions) for _ in range(TICKS)]
    np.testing.assert_allclose(total, sum(step[1] for step in told), rtol=1e-5)
    last = told[-1][4]["final_obs"][1]["tcp_position_in_base_m"]
    np.testing.assert_allclose(infos[1]["terminal_observation"]["tcp_position_in_base_m"], last, rtol=1e-6)
    env.close()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({}, "one of them; got neither"),
        ({"space": SPACE, "scenario": SCENARIO}, "one of them; got both"),
        (
            {"space": SPACE, "action": "torque"},
            "tcp velocity, tcp twist, joint velocity; got 'torque'",
        ),
        ({"space": SPACE, "sees": ("image",)}, "sees: expected a world that renders .*; got 'image' in the"),
        ({"space": SPACE, "render_mode": "human"}, "render_mode: expected None or rgb_array; got 'human'"),
        ({"space": SPACE, "sees": ()}, "sees: expected at least one of: joints, .*; got none"),
        (
            {"space": SPACE, "sees": "joints"},
            r"sees: expected a list of words; got 'joints' \(\['joints'\]\)",
        ),
        ({"space": SPACE, "ends": NEAR}, "ends: expected a list of claims"),
        ({"space": SPACE, "ends": None}, "ends: expected a list of claims; got None"),
        ({"space": SPACE, "rewards": {"the avoider answered": 1.0}}, "claim of single ticks"),
        ({"space": SPACE, "rewards": {NEAR: float("nan")}}, "a number for"),
        ({"space": SPACE, "rewards": {NEAR: -100.0}}, "no negative number for"),
        ({"space": SPACE, "world": "nowhere"}, "nowhere"),
    ],
)
def test_what_cannot_be_an_environment_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        HarnessEnv(**wrong)


def test_an_action_that_is_none_is_refused(one: HarnessEnv) -> None:
    one.reset(seed=1)
    for action in (np.full(3, np.nan), np.zeros(2), np.zeros((2, 3)), "x", None, [1, [2, 3]], {}):
        with pytest.raises(ControllerError, match="an action is finite numbers of the shape"):
            one.step(action)


def test_without_a_claim_there_is_no_cost_that_would_always_be_zero() -> None:
    rewards = {"progress": 1.0}
    with HarnessEnv(space=SPACE, rewards=rewards) as env:
        assert "cost" not in env.reset()[1]
        assert "cost" not in env.step(env.action_space.sample())[4]
    lanes = HarnessVectorEnv(2, space=SPACE, rewards=rewards)
    assert "cost" not in lanes.reset()[1]
    assert "cost" not in lanes.step(lanes.action_space.sample())[4]
    lanes = StableBaselinesEnv(lanes, ticks=2)
    lanes.reset()
    assert all("cost" not in info for info in lanes.step(np.zeros((2, 3)))[3])
    with HarnessEnv(space=SPACE, rewards=rewards | {NEAR: 0.0}) as env:
        env.reset()
        _, reward, _, _, info = env.step(np.zeros(3))
        assert (reward, info["cost"]) == (pytest.approx(0.0, abs=1e-6), 1.0)


def test_without_gymnasium_or_stable_baselines_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module, package, extra in (
        ("safety_harness.extensions.gym.stable_baselines", "stable_baselines3", "policies"),
        ("safety_harness.extensions.gym", "gymnasium", "gym"),
    ):
        for name in [one for one in sys.modules if one.partition(".")[0] == package]:
            monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.delitem(sys.modules, module)
        with pytest.raises(MissingPackageError, match=rf"needs {package}, .*safety-harness\[{extra}\]"):
            import_module(module)


def test_info_counts_the_claims_that_a_tick_violates_and_names_the_draw() -> None:
    env = HarnessEnv(space=SPACE, rewards={NEAR: 1.0, "TCP speed never above 1 mm/s": 1.0})
    _, info = env.reset(seed=2)
    costs = [info["cost"]] + [env.step(np.array([0.1, 0.0, 0.0]))[4]["cost"] for _ in range(TICKS)]
    ticks = env.trace().ticks
    distance_m = np.where(ticks["hand_present"], ticks["hand_distance_m"], np.inf).min(axis=1)
    assert costs == ((distance_m < 0.3) * 1.0 + (ticks["tcp_speed_mps"] > 0.001)).tolist()
    assert set(costs) == {1.0, 2.0}
    assert info["scenario"] == f"{SPACE.draw(2, 0).name} of seed 2"
    env.close()


def test_success_is_arrival_without_a_violation() -> None:
    env = HarnessEnv(scenario=SCENARIO, rewards={"hand distance never below 50 mm": 1.0})
    desired = np.array(SCENARIO.settings.cell.desired_tcp_position_in_base_m)
    seen, info = env.reset()
    successes = [info["is_success"]]
    for _ in range(TICKS):
        seen, *_, info = env.step(np.clip(8.0 * (desired - seen["tcp_position_in_base_m"]), -0.2, 0.2))
        successes.append(info["is_success"])
    way_m = np.linalg.norm(env.trace().ticks["transform_tcp_to_base"][:, :3, 3] - desired, axis=1)
    assert successes == (way_m <= 0.001).tolist()
    env.close()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("make", [HarnessEnv, lambda **given: HarnessVectorEnv(3, **given)])
def test_a_copy_in_the_middle_of_an_episode_goes_on_bit_for_bit(copied: Any, make: Any) -> None:
    env = make(space=SPACE, rewards={"progress": 1.0, NEAR: 2.0})
    rng = np.random.default_rng(1)
    env.reset(seed=5)
    for _ in range(TICKS + 7 if isinstance(env, HarnessVectorEnv) else 7):
        env.step(rng.uniform(-0.2, 0.2, env.action_space.shape))
    other = copied(env)
    for k in range(TICKS - 7):
        action = rng.uniform(-0.2, 0.2, env.action_space.shape)
        one, two = env.step(action), other.step(action)
        assert alike(one[0], two[0])
        assert np.array_equal(one[1], two[1]), k
    assert alike(env.reset()[0], other.reset()[0])  # the next draw of the stream
    env.close()
    other.close()


@pytest.mark.parametrize(
    ("seed", "said"),
    [
        (-1, "seed: expected a whole number, at least 0; got -1"),
        (0.5, "got 0.5"),
        ("7", "got '7'"),
        ([1, 2], "seed: expected one entry for each of the 3 lanes; got 2 of them"),
        ([1, -2, 3], r"seed\[1\]: expected a whole number, at least 0; got -2"),
    ],
)
def test_a_seed_that_is_none_is_refused(seed: object, said: str, one: HarnessEnv) -> None:
    lanes = HarnessVectorEnv(3, space=SPACE)
    with pytest.raises(InputError, match=said):
        lanes.reset(seed=seed)
    with pytest.raises(InputError, match="seed: expected a whole number"):
        one.reset(seed=seed)
    lanes.close()


def test_integers_of_numpy_are_seeds_and_none_lets_a_lane_go_on(one: HarnessEnv) -> None:
    assert alike(one.reset(seed=np.int64(7))[0], one.reset(seed=7)[0])
    lanes, others = (HarnessVectorEnv(3, space=SPACE) for _ in range(2))
    assert alike(lanes.reset(seed=np.int32(7))[0], others.reset(seed=np.array([7, 8, 9]))[0])
    others.reset(seed=[7, None, 9])
    assert others.call("scenario")[0] == lanes.call("scenario")[0]
    lanes.close()
    others.close()


def test_lanes_have_attributes_in_common_and_nothing_to_call() -> None:
    lanes = HarnessVectorEnv(2, space=SPACE)
    assert lanes.get_attr("num_envs") == (2, 2)
    with pytest.raises(AttributeError, match="step cannot be called"):
        lanes.call("step")
    with pytest.raises(AttributeError, match="cannot be set"):
        lanes.set_attr("num_envs", 3)
    lanes.close()


def test_wrappers_of_gymnasium_read_the_infos_of_lanes() -> None:
    lanes = HarnessVectorEnv(3, space=SPACE, rewards={NEAR: 1.0})
    wrapped = DictInfoToList(RecordEpisodeStatistics(lanes))
    _, infos = wrapped.reset(seed=7)
    assert [info["scenario"] for info in infos] == [
        f"{SPACE.draw(lane, 0).name} of seed {lane}" for lane in (7, 8, 9)
    ]
    for _ in range(TICKS):
        *_, infos = wrapped.step(np.zeros((3, 3)))
    for info in infos:
        assert info["episode"]["l"] == TICKS
        assert set(info["final_info"]) == {"margins", "cost", "is_success", "scenario"}
        assert info["final_info"]["margins"][NEAR] < 0.3
    wrapped.close()


@pytest.mark.parametrize("world", ["kinematic", "pybullet"])
def test_a_picture_shows_arm_and_hand_from_outside_in_any_world(world: str) -> None:
    name = "safety_harness.extensions.gym:SafetyHarness-v0"
    env = gymnasium.make(name, scenario=SCENARIO, world=world, render_mode="rgb_array")
    env.reset()
    first = env.render()
    for _ in range(TICKS):
        env.step(np.array([0.0, 0.0, 0.2]))
    last = env.render()
    env.close()
    assert first.shape == last.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 20
    assert (first != last).any()


def test_images_are_observed_where_the_world_renders() -> None:
    rendered = read_scenario("shipped:rendered-images")
    env = HarnessEnv(scenario=rendered, world="pybullet", sees=("joints", "image"))
    camera = rendered.settings.camera
    seen, _ = env.reset()
    assert env.observation_space["image"].shape == (camera.height_px, camera.width_px, 3)
    for _ in range(40):
        seen, *_ = env.step(np.zeros(3))
    assert env.observation_space.contains(seen)
    assert seen["image"].any()
    env.close()
