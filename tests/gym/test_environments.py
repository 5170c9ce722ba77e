"""Worlds as Gymnasium environments, one by one and many at once."""

from __future__ import annotations

import os
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

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import ControllerError, InputError, MissingPackageError
from safety_harness.extensions.gym.environment import HarnessEnv
from safety_harness.extensions.gym.stable_baselines import StableBaselinesEnv
from safety_harness.extensions.gym.vector import HarnessVectorEnv
from safety_harness.scenario.read import parse_scenario
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
        assert alike(every[-1], {name: array[lane] for name, array in info["final_obs"].items()})
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
    last = told[-1][4]["final_obs"]["tcp_position_in_base_m"]
    np.testing.assert_allclose(infos[1]["terminal_observation"]["tcp_position_in_base_m"], last[1], rtol=1e-6)
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
        ({"space": SPACE, "sees": ("image",)}, "got 'image'"),
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
