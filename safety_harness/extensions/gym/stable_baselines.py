"""Adapt vector environments to Stable-Baselines3: actions from -1 to 1, observations in float32."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError, near_miss
from safety_harness.base.extras import POLICIES
from safety_harness.cell.controller.arrays import Arrays
from safety_harness.extensions.gym.vector import HarnessVectorEnv

with POLICIES.needed("policies trained in environments"):
    from stable_baselines3.common.vec_env import VecEnv


class StableBaselinesEnv(VecEnv):
    """A Stable-Baselines3 view of ``environments``, with the chosen ``fields`` of observations.

    An action of 1 stands for the largest value in the action space of ``environments``.

    Args:
        environments: The vector environment whose lanes are used.
        fields: The fields of observations to keep. Empty: all fields.
        ticks: The number of ticks for which each action is repeated, unless the episode ends earlier.

    """

    def __init__(self, environments: HarnessVectorEnv, fields: Sequence[str] = (), ticks: int = 1) -> None:
        if ticks < 1:
            raise InadmissibleError.of_option("ticks", "at least one", str(ticks))
        self.environments, self.ticks = environments, ticks
        shown, moved = environments.setting.observation_space, environments.setting.action_space
        known = shown.spaces
        for field in fields:
            if field not in known:
                raise InadmissibleError.of_option(
                    "fields", f"some of: {', '.join(known)}", repr(field), near_miss(field, known)
                )
        self.fields = tuple(fields) or tuple(known)
        self.largest_action = moved.high
        boxes = {name: spaces.Box(-np.inf, np.inf, known[name].shape, np.float32) for name in self.fields}
        actions = spaces.Box(-1.0, 1.0, self.largest_action.shape, np.float32)
        super().__init__(environments.num_envs, spaces.Dict(boxes), actions)  # type: ignore[arg-type]
        self._actions = np.zeros((self.num_envs, *self.largest_action.shape))

    def reset(self) -> Arrays:
        """Begin an episode in each lane.

        If a lane has a new seed, it begins the first episode of this seed.
        """
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        self._reset_seeds()
        return self._shown(self.environments.reset(seed=seeds)[0])

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the ``actions`` (environments, a) for ``step_wait``."""
        self._actions = self.largest_action * actions.astype(np.float64)

    def step_wait(self) -> tuple[Arrays, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step each lane by ``ticks`` with the stored actions.

        If a lane's episode ends before all ``ticks`` have passed, the next episode of the lane begins at
        once. The action is then zero during the remaining ticks. Each info contains the ``cost`` of the
        lane's ticks in this step. At the end of an episode, it also contains ``is_success`` and the margins.
        """
        claims = self.environments.setting.rewards.margins
        infos: list[dict[str, Any]] = [{"cost": 0.0} if claims else {} for _ in range(self.num_envs)]
        total, ended = np.zeros(self.num_envs), np.zeros(self.num_envs, np.bool_)
        for _ in range(self.ticks):
            seen, reward, terminated, truncated, info = self.environments.step(
                np.where(ended[:, None], 0.0, self._actions)
            )
            total += np.where(ended, 0.0, reward)
            finished = terminated | truncated
            for lane in np.flatnonzero(~ended).tolist():
                of_tick = info["final_info"] if finished[lane] else info
                if claims:
                    infos[lane]["cost"] += float(of_tick["cost"][lane])
                if finished[lane]:
                    last = self._shown(info["final_obs"][lane])
                    cut = bool(truncated[lane] and not terminated[lane])
                    infos[lane] |= {"terminal_observation": last, "TimeLimit.truncated": cut}
                    infos[lane]["is_success"] = bool(of_tick["is_success"][lane])
                    infos[lane] |= {name: float(of_tick["margins"][name][lane]) for name in claims}
            ended |= finished
        return self._shown(seen), total.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the environments."""
        self.environments.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the attribute ``attr_name`` of ``environments`` for each lane in ``indices``."""
        values = self.environments.get_attr(attr_name)
        return [values[lane] for lane in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise AttributeError, because lanes have no attributes of their own."""
        raise AttributeError(f"{attr_name} cannot be set: lanes have no attributes of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raise AttributeError, because lanes have no methods of their own."""
        raise AttributeError(f"{method_name} cannot be called: lanes have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each of ``indices``, because no lane has a wrapper."""
        return [False] * len(list(self._get_indices(indices)))

    def _shown(self, seen: Arrays) -> Arrays:
        return {name: seen[name].astype(np.float32) for name in self.fields}
