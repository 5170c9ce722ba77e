"""Run many episodes at once in the kinematic world, as a vector environment.

A step of all episodes is a single call of compiled code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from safety_harness.admission.admit import Checked
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.controller.answers import NOT_REPORTED
from safety_harness.cell.controller.arrays import Arrays, observed
from safety_harness.cell.controller.cycle import QUESTION
from safety_harness.cell.controller.seeing import DrivenRecords, driven_records
from safety_harness.cell.simulation.lanes import look_lanes, obey_lanes, placed, stacked, step_lanes
from safety_harness.cell.simulation.records import WorldRecords, world_records
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.extensions.gym.environment import REWARDS, SEES, TCP_VELOCITY, Setting
from safety_harness.extensions.gym.episodes import File, stream_number
from safety_harness.scenario.model import Scenario
from safety_harness.seams.contract import OBJECT, PREDICTED_HANDS
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.records import as_compiled, tick_dtype


class HarnessVectorEnv(VectorEnv[Any, Any, Any]):
    """A vector environment with ``num_envs`` lanes.

    The results in each lane are bit-identical to the results of a ``HarnessEnv``. Lane i begins stream seed +
    i; without a seed, it begins stream i. When the episode of a lane ends, the lane is reset within the same
    step. In this step, ``info["final_obs"]`` has one entry for each lane. The entry is the last observation
    of an episode that ended, and otherwise None. ``info["final_info"]`` has one row for each lane. Both
    entries of ``info`` are the same as in Gymnasium. The world is the kinematic world. Lanes record no
    traces; a ``HarnessEnv`` with the lane's seed and the same arguments records the trace.

    Args:
        num_envs: The number of lanes.
        scenario: As for ``HarnessEnv``.
        space: As for ``HarnessEnv``.
        world: The kinematic world, or its name.
        sees: As for ``HarnessEnv``.
        action: As for ``HarnessEnv``.
        rewards: As for ``HarnessEnv``.
        ends: As for ``HarnessEnv``.

    Raises:
        InadmissibleError: An argument cannot be used, the world is not the kinematic world, or there is no
            lane.

    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenario: Scenario | File | None = None,
        space: ScenarioSpace | File | None = None,
        world: WorldEntry | str = KINEMATIC,
        sees: Sequence[str] = SEES,
        action: str = TCP_VELOCITY,
        rewards: Mapping[str, float] = REWARDS,
        ends: Sequence[str] = (),
    ) -> None:
        setting = self.setting = Setting(scenario, space, world, sees, action, rewards, ends)
        if setting.world is not KINEMATIC:
            raise InadmissibleError.of_option("world", "the kinematic one", setting.world.label)
        if num_envs < 1:
            raise InadmissibleError.of_option("num_envs", "at least one", str(num_envs))
        self.num_envs = num_envs
        self.single_observation_space = setting.observation_space
        self.single_action_space = setting.action_space
        self.observation_space = batch_space(setting.observation_space, num_envs)
        self.action_space = batch_space(setting.action_space, num_envs)
        self._streams = [setting.episodes.stream(lane or None) for lane in range(num_envs)]
        world_of, controller_of = _records(setting.episodes.first)
        self._worlds, self._controllers = stacked(world_of, num_envs), stacked(controller_of, num_envs)
        self._wants = OBJECT in setting.sees, PREDICTED_HANDS in setting.sees
        first = setting.episodes.first.scenario
        self._tick_dtype = tick_dtype(first.hand_slots, setting.joints)
        self._left = np.zeros(num_envs, np.int64)  # ticks
        self._acts = _Acts(num_envs, setting.joints, as_compiled(np.zeros((num_envs, 1), self._tick_dtype)))
        self._way_m, self._cost, self._names = np.zeros(num_envs), np.zeros(num_envs), [""] * num_envs
        self._least = {sentence: np.full(num_envs, np.inf) for sentence in setting.rewards.margins}

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Begin an episode in every lane.

        Args:
            seed: If it is a number, lane i begins stream seed + i. If it is a list, lane i begins the stream
                whose number is entry i. If it is None, or if the lane's entry is None, the lane continues its
                stream.
            options: Ignored.

        Returns:
            Observations (lanes, ...) and info. The info has the same entries as in ``HarnessEnv.reset``, and
            each entry has one value for each lane.

        Raises:
            InadmissibleError: A seed is negative or not an integer, or the list does not have one entry for
                each lane.

        """
        for lane, own in enumerate(self._seeds(seed)):
            if own is not None:
                self._streams[lane] = self.setting.episodes.stream(own)
        for lane in range(self.num_envs):
            self._begin(lane)
        self._measured(np.arange(self.num_envs))
        return self._observed(), self._info()

    def _seeds(self, seed: object) -> list[int | None]:
        """Return the seed of each lane, as ``reset`` describes."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str) and np.ndim(seed):
            if len(seed) != self.num_envs:
                expected = f"one entry for each of the {self.num_envs} lanes"
                raise InadmissibleError.of_option("seed", expected, f"{len(seed)} of them")
            return [None if own is None else stream_number(own, f"seed[{k}]") for k, own in enumerate(seed)]
        return [stream_number(seed) + lane for lane in range(self.num_envs)]

    def step(
        self, actions: NDArray[np.float64]
    ) -> tuple[Arrays, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Move every lane by one control tick.

        Args:
            actions: (lanes, a) as in ``action_space``.

        Returns:
            Observations, rewards, terminated and truncated, all (lanes, ...), and info, as in Gymnasium.

        Raises:
            ControllerError: An action has another shape or is not finite.

        """
        wanted = self.setting.wanted_of(actions, self.num_envs)
        self._acts.carry_out(self._worlds, self._controllers, wanted, self.setting.by_joints)
        self._acts.observe(self._worlds, self._controllers, self._acts.lasts, self._wants)
        rewards, ticks, way_before_m = self.setting.rewards, self._ticks, self._way_m
        margins, self._way_m = rewards.at(ticks), rewards.way_left_m(ticks)
        for sentence, margin in margins.items():
            np.minimum(self._least[sentence], margin, out=self._least[sentence])
        self._cost = rewards.cost_of(margins, self.num_envs)
        reward = rewards.of_step(margins, self._way_m, way_before_m)
        self._left -= 1
        terminated, truncated = rewards.ends_episode(margins, self.num_envs), self._left == 0
        info: dict[str, Any] = {}
        ended = np.flatnonzero(terminated | truncated)
        observation = self._observed()
        if len(ended):
            # Gymnasium's SAME_STEP: the last observation of an episode is in info, because the lane begins
            # the next one.
            info["final_obs"] = np.full(self.num_envs, None, object)
            info["final_info"], info["_final_obs"] = self._info(), terminated | truncated
            info["_final_info"] = info["_final_obs"].copy()
            for lane in ended.tolist():
                info["final_obs"][lane] = {name: array[lane].copy() for name, array in observation.items()}
                self._begin(lane)
            self._measured(ended)
            observation = self._observed()
        return observation, reward, terminated, truncated, info | self._info()

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return the attribute ``name`` once for each lane; ``scenario`` returns the names of the draws.

        Raises:
            AttributeError: The attribute does not exist, or it is a method; lanes have no methods of their
                own.

        """
        if name == "scenario":
            return tuple(self._names)
        attribute = getattr(self, name)
        if callable(attribute):
            raise AttributeError(f"{name} cannot be called: lanes have no methods of their own")
        return (attribute,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return the attribute ``name`` once for each lane, as ``call`` does."""
        return self.call(name)

    def set_attr(self, name: str, values: object) -> None:
        """Raise AttributeError, because lanes have no attributes of their own."""
        raise AttributeError(f"{name} cannot be set: lanes have no attributes of their own")

    @property
    def _ticks(self) -> NDArray[np.void]:
        """The present true state of all lanes, as (lanes,) TICK."""
        return self._worlds.truth[:, 0].view(self._tick_dtype)

    def _begin(self, lane: int) -> None:
        checked = next(self._streams[lane])
        world, controller = _records(checked)
        self._worlds = placed(self._worlds, lane, world)
        self._controllers = placed(self._controllers, lane, controller)
        self._left[lane], self._names[lane] = checked.scenario.ticks, self._streams[lane].drawn
        # A negative last tick excludes a lane, so that only the lane that begins is observed.
        alone = np.full(self.num_envs, -1)
        alone[lane] = 0
        self._acts.observe(self._worlds, self._controllers, alone, self._wants)

    def _measured(self, lanes: NDArray[np.int64]) -> None:
        """Compute and store the margins and distances of ``lanes`` (k,) at the start of their episodes."""
        ticks = self._ticks[lanes]
        rewards = self.setting.rewards
        self._way_m[lanes], margins = rewards.way_left_m(ticks), rewards.at(ticks)
        self._cost[lanes] = rewards.cost_of(margins, len(lanes))
        for sentence, margin in margins.items():
            self._least[sentence][lanes] = margin

    def _observed(self) -> Arrays:
        return observed(self._controllers.seen[:, 0], self.setting.sees)

    def _info(self) -> dict[str, Any]:
        """Return the info that ``HarnessEnv.reset`` describes, with one row for each lane."""
        every = np.ones(self.num_envs, np.bool_)
        margins = {sentence: least.copy() for sentence, least in self._least.items()}
        success = self.setting.rewards.succeeds(self._least, self._way_m)
        info: dict[str, Any] = {"margins": margins | {f"_{sentence}": every for sentence in margins}}
        info |= {"cost": self._cost.copy()} if margins else {}  # a cost of no claim would be 0 for ever
        info |= {"is_success": success, "scenario": np.array(self._names, object)}
        return info | {f"_{name}": every for name in info}


class _Acts:
    """The control ticks of all lanes, without a trace.

    Each lane has a single record in ``ticks``, which every tick overwrites. The records ``ticks`` (lanes, 1)
    have the form that ``as_compiled`` returns.
    """

    def __init__(self, lanes: int, joints: int, ticks: NDArray[np.void]) -> None:
        self._ticks, self.lasts = ticks, np.ones(lanes, np.int64)  # 1: tick 0 is never the last one
        self._twists, self._joints = np.zeros((lanes, 6)), np.zeros((lanes, joints))
        self._flags = [np.zeros(lanes, np.bool_) for _ in range(3)]
        self._questions = np.zeros((lanes, 1), QUESTION)
        self._modes = np.full(lanes, NOT_REPORTED, np.int64)

    def carry_out(
        self, worlds: WorldRecords, controllers: DrivenRecords, wanted: NDArray[np.float64], by_joints: bool
    ) -> None:
        """Carry out the actions of all lanes; ``wanted`` (lanes, a) has one row for each lane."""
        flags, lasts = self._flags, self.lasts
        (self._joints if by_joints else self._twists)[:] = wanted
        flags[0][:] = by_joints
        obey_lanes(worlds.observation, controllers, lasts, 0, self._twists, self._joints, *flags)
        step_lanes(worlds, controllers, self._questions, self._ticks, lasts, 0, self._modes)

    def observe(
        self,
        worlds: WorldRecords,
        controllers: DrivenRecords,
        lasts: NDArray[np.int64],
        wants: tuple[bool, bool],
    ) -> None:
        """Observe the world in each lane whose entry in ``lasts`` (lanes,) is not negative."""
        look_lanes(worlds, controllers, lasts, 0, *wants)


def _records(checked: Checked) -> tuple[WorldRecords, DrivenRecords]:
    """Return the world's and the controller's records at the start of an episode."""
    scenario = checked.scenario
    return (
        world_records(scenario, checked.arm, checked.joint_position_rad),
        driven_records(scenario.settings, checked.arm, checked.view, scenario.hand_slots),
    )
