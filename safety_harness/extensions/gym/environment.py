"""Provide a Gymnasium environment; an agent's actions control its episodes tick by tick."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from itertools import count
from multiprocessing import current_process, parent_process
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from safety_harness.admission.admit import Checked
from safety_harness.base.exceptions import ControllerError, InadmissibleError
from safety_harness.base.settings import ImageSource, Settings
from safety_harness.cell.controller.arrays import Arrays, observed
from safety_harness.cell.controller.driven import DrivenController
from safety_harness.cell.simulation.simulate import no_ticks, trace_of
from safety_harness.cell.simulation.world import ShowsImages, World
from safety_harness.cell.simulation.worlds import KINEMATIC, REFERENCE, WorldEntry, world_named
from safety_harness.extensions.gym.episodes import OUTSIDE, Episodes, File, stream_number
from safety_harness.extensions.gym.observing import observation_space
from safety_harness.extensions.gym.rewards import PROGRESS, Rewards
from safety_harness.scenario.model import Scenario
from safety_harness.seams.contract import (
    IMAGE,
    JOINTS,
    PREDICTED_HANDS,
    SIGHTS,
    DrivenArm,
    Seen,
    Start,
    Stop,
    sees_of,
)
from safety_harness.seams.rows import seen_dtype
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace

if TYPE_CHECKING:
    from safety_harness.extensions.gym.viewer import Viewer

SEES = (JOINTS, PREDICTED_HANDS)
RGB_ARRAY = "rgb_array"
# By default, the agent has a reward for progress and pays for a hand that comes too near.  The weights are a
# choice.
REWARDS = {PROGRESS: 1.0, "hand distance never below 50 mm": 100.0}
TCP_VELOCITY, TCP_TWIST, JOINT_VELOCITY = "tcp velocity", "tcp twist", "joint velocity"
ACTIONS = (TCP_VELOCITY, TCP_TWIST, JOINT_VELOCITY)


class Pilot:
    """A stand-in for a controller in an environment, where the agent chooses the actions.

    It only declares the observations ``sees``.
    """

    name = OUTSIDE

    def __init__(self, sees: Sequence[str]) -> None:
        self.sees = tuple(sees)

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Do nothing, because no state passes from one episode to the next."""

    def act(self, seen: Seen) -> Stop:
        """Raise ControllerError, because the actions come from the environment's ``step``."""
        raise ControllerError("an environment's actions come from step")


class Setting:
    """The common properties of all episodes of an environment or of a vector environment.

    ``wanted`` is the number of values that ``obey`` requires. It is 6 for actions of the TCP, or n for
    actions of the joints. ``given`` contains the constructor's arguments, so that the setting can be copied
    or pickled.
    """

    def __init__(
        self,
        scenario: Scenario | File | None,
        space: ScenarioSpace | File | None,
        world: WorldEntry | str,
        sees: Sequence[str],
        action: str,
        rewards: Mapping[str, float],
        ends: Sequence[str],
    ) -> None:
        for name, given, kind in (("sees", sees, "words"), ("ends", ends, "claims")):
            if not isinstance(given, tuple | list | set | frozenset):  # a text is a sequence of its letters
                hint = f"[{given!r}]" if isinstance(given, str) else ""
                raise InadmissibleError.of_option(name, f"a list of {kind}", repr(given), hint)
        self.world = world_named(world, "world") if isinstance(world, str) else world
        self.given: dict[str, Any] = {"scenario": scenario, "space": space, "world": self.world}
        self.given |= {"sees": tuple(sees), "action": action, "rewards": dict(rewards), "ends": tuple(ends)}
        self.episodes = Episodes(scenario, space, self.world)
        first = self.episodes.first
        self.pilot = Pilot(sees)
        self.sees = sees_of(self.pilot, SIGHTS)
        self.joints = len(first.arm.joint_names)
        self.rewards = Rewards.of_claims(rewards, ends, first)
        seen = np.zeros(1, seen_dtype(first.scenario.hand_slots, self.joints))
        self.observation_space = observation_space(seen, self.sees, self._image_shape(first.scenario))
        self.action_space = _action_space(action, first)
        self.by_joints = action == JOINT_VELOCITY
        self.wanted = self.joints if self.by_joints else 6

    def __reduce__(self) -> tuple[object, ...]:
        """Allow the setting to be copied and pickled."""
        return _setting, (self.given,)

    def _image_shape(self, first: Scenario) -> tuple[int, int, int] | None:
        """Return the shape (height, width, 3) of observed images; None if they are not observed."""
        if IMAGE not in self.sees:
            return None
        camera = first.settings.camera
        if not (self.world.renders and camera.source is ImageSource.RENDERED):
            expected = "a world that renders (pybullet), and a scenario whose camera does, to see the image"
            raise InadmissibleError.of_option("sees", expected, f"{IMAGE!r} in {self.world}")
        return camera.height_px, camera.width_px, 3

    def wanted_of(self, actions: ArrayLike, lanes: int) -> NDArray[np.float64]:
        """Return ``actions`` (n, a) after appending zeros to each row, shape (n, wanted).

        Raise ControllerError if the shape differs or a value is not finite.
        """
        shape = self.action_space.shape
        try:
            given = np.asarray(actions, np.float64)
        except (TypeError, ValueError):  # no numbers, or rows of different lengths
            given = np.full(0, np.nan)
        if given.size != lanes * shape[0] or given.shape[-1:] != shape or not np.isfinite(given).all():
            raise ControllerError(f"an action is finite numbers of the shape {shape}; got {actions!r}")
        wanted = np.zeros((lanes, self.wanted))
        wanted[:, : shape[0]] = given.reshape(lanes, -1)
        return wanted


def _setting(given: dict[str, Any]) -> Setting:
    """Return the setting with the arguments ``given``."""
    return Setting(**given)


def _action_space(action: str, first: Checked) -> spaces.Box:
    """Return the action space, with limits in SI units.

    If an action is outside this space, it is limited like the command of any other controller, and the trace
    records the limit.
    """
    motion = first.scenario.settings.motion
    linear, angular = [motion.max_tcp_speed_mps] * 3, [motion.max_tcp_angular_speed_radps] * 3
    if action not in ACTIONS:
        raise InadmissibleError.of_option("action", f"one of: {', '.join(ACTIONS)}", repr(action))
    most = {
        TCP_VELOCITY: np.array(linear),
        TCP_TWIST: np.array(linear + angular),
        JOINT_VELOCITY: np.array(first.arm.velocity_limit_radps),
    }[action]
    return spaces.Box(-most, most, dtype=np.float64)


def _lane(environment: HarnessEnv) -> int:
    """Return the number of the stream that an environment uses until a seed is given.

    It is the least number that no other environment with the same title uses, so the environments of a vector
    differ. In a worker process, the search for this number starts at the number in the process's name, and
    proceeds in steps of 2^32.
    """
    title = environment.setting.episodes.first.scenario.title
    worker = re.search(r"\d+$", current_process().name) if parent_process() is not None else None
    first, step = (int(worker[0]), 1 << 32) if worker else (0, 1)
    lane = next(number for number in count(first, step) if (title, number) not in _LIVING)
    _LIVING[title, lane] = environment
    return lane


_LIVING: WeakValueDictionary[tuple[str, int], HarnessEnv] = WeakValueDictionary()


class HarnessEnv(gymnasium.Env[dict[str, Any], NDArray[np.float64]]):
    """An environment in which an agent's actions control the arm, in any world.

    An episode is a run of a scenario or of a random draw from a space. One step is one control tick. If
    several environments without a seed exist at the same time, each of them has its own stream.

    Args:
        scenario: The scenario of every episode, or its file. Pass either this or ``space``.
        space: The space whose draws the episodes run, or its file.
        world: The world, or its name.
        sees: The names of the observed quantities, as in the contract of controllers.
        action: "tcp velocity" (3,) [m/s] or "tcp twist" (6,) [m/s, rad/s] in the base frame, or "joint
            velocity" (n,) [rad/s].
        rewards: The weights of claims and of "progress", which ``extensions.gym.rewards`` explains.
        ends: Claims whose violation at a tick terminates an episode. The end of the scenario truncates an
            episode.
        render_mode: "rgb_array" if ``render`` shall return pictures (480, 640, 3), which needs PyBullet, or
            None for no pictures.

    Raises:
        InadmissibleError: An argument cannot be used, or a scenario cannot run.

    """

    metadata = {"render_modes": [RGB_ARRAY], "render_fps": 125}  # noqa: RUF012

    action_space: spaces.Box  # type: ignore[assignment]  # its numbers are float64

    def __init__(
        self,
        *,
        scenario: Scenario | File | None = None,
        space: ScenarioSpace | File | None = None,
        world: WorldEntry | str = KINEMATIC,
        sees: Sequence[str] = SEES,
        action: str = TCP_VELOCITY,
        rewards: Mapping[str, float] = REWARDS,
        ends: Sequence[str] = (),
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, RGB_ARRAY):
            raise InadmissibleError.of_option("render_mode", f"None or {RGB_ARRAY}", repr(render_mode))
        if render_mode is not None:
            REFERENCE.opener()
        self.render_mode = render_mode
        self.setting = Setting(scenario, space, world, sees, action, rewards, ends)
        self.observation_space = self.setting.observation_space
        self.action_space = self.setting.action_space
        self._stream = self.setting.episodes.stream(_lane(self) or None)
        self._closing = ExitStack()
        self._viewer: Viewer | None = None
        self._actions: list[NDArray[np.float64]] = []
        self._way_m, self._cost = np.zeros(1), np.zeros(1)
        self._begun, self._over = False, True

    def __reduce__(self) -> tuple[object, ...]:
        """Allow the environment to be copied and pickled.

        The copy repeats the steps of the present episode.
        """
        stream = self._stream
        given = self.setting.given | {"render_mode": self.render_mode}
        return _repeated, (given, stream.seed, stream.number, self._begun, self._actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin the next episode.

        Args:
            seed: The number of a stream in the seed tree, whose first episode begins. None: The next episode
                of the present stream begins.
            options: Ignored.

        Returns:
            Observation and info. ``info["margins"]`` maps each claim to its least margin so far. ``cost`` is
            the number of claims that are violated at this tick. ``is_success`` is True if the TCP has arrived
            without a violation of any claim so far. ``scenario`` is the name of the draw.

        Raises:
            InadmissibleError: The seed is negative or not an integer.

        """
        number = None if seed is None else stream_number(seed)
        super().reset(seed=number)
        if number is not None:
            self._stream = self.setting.episodes.stream(number)
        self._begin(next(self._stream))
        return self._observed(), self._info()

    def step(self, action: NDArray[np.float64]) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Move by one control tick.

        Args:
            action: (a,) an element of ``action_space``.

        Returns:
            Observation, reward, terminated, truncated and info, as in Gymnasium.

        Raises:
            ControllerError: The action has another shape or is not finite, or the episode is over.

        """
        if self._over:
            raise ControllerError("the episode is over: reset begins the next")
        wanted = self.setting.wanted_of(action, 1)[0]
        self._actions.append(np.array(action, np.float64))
        self._command(wanted, last=False)
        self._observe(self._tick + 1)
        way_before_m, rewards = self._way_m, self.setting.rewards
        ticks = self._ticks[self._tick : self._tick + 1]
        margins, self._way_m = rewards.at(ticks), rewards.way_left_m(ticks)
        for sentence, margin in margins.items():
            self._least[sentence] = np.minimum(self._least[sentence], margin)
        self._cost = rewards.cost_of(margins, 1)
        reward = float(rewards.of_step(margins, self._way_m, way_before_m)[0])
        terminated = bool(rewards.ends_episode(margins, 1)[0])
        truncated = self._tick == self._checked.scenario.ticks
        self._over = terminated or truncated
        if truncated:  # a run records both its ends; at the last, the action is repeated
            self._command(wanted, last=True)
        return self._observed(), reward, terminated, truncated, self._info()

    def trace(self) -> Trace:
        """Return the trace of the episode so far, which can be judged and reported like any other run."""
        whole = self._tick == self._checked.scenario.ticks
        done = self._ticks[: self._tick + whole]
        ended = "complete" if whole else "the environment's episode ended before its scenario"
        return trace_of(self._checked.scenario, self._world, self._controller, done, ended)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (480, 640, 3) of the cell from outside, or None without a ``render_mode``."""
        if self.render_mode is None or not self._begun:
            return None
        if self._viewer is None:
            from safety_harness.extensions.gym.viewer import Viewer

            self._viewer = self._closing.enter_context(Viewer(self._checked))
        return self._viewer.picture(self._ticks[self._tick])

    def close(self) -> None:
        """Close the world."""
        self._closing.close()
        self._begun, self._over = False, True
        for key in [key for key, living in _LIVING.items() if living is self]:
            del _LIVING[key]

    def _begin(self, checked: Checked) -> None:
        self._closing.close()
        self._viewer, self._actions = None, []
        self._checked, scenario = checked, checked.scenario
        opened = self.setting.world.open(scenario, checked.arm, checked.joint_position_rad)
        self._world: World = self._closing.enter_context(opened)
        self._controller = DrivenController(
            self.setting.pilot,
            scenario.settings,
            checked.arm,
            checked.view,
            checked.joint_position_rad,
            scenario.seed,
            scenario.hand_slots,
        )
        self._ticks, self._begun, self._over = no_ticks(scenario), True, False
        self._observe(0)
        rewards = self.setting.rewards
        self._least, self._way_m = rewards.at(self._ticks[:1]), rewards.way_left_m(self._ticks[:1])
        self._cost = rewards.cost_of(self._least, 1)

    def _observe(self, tick: int) -> None:
        self._tick = tick
        self._world.true_state(self._ticks[tick : tick + 1])
        self._observation = self._world.observe()
        self._seen = self._controller.perceive(self._observation)

    def _command(self, wanted: NDArray[np.float64], *, last: bool) -> None:
        """Carry out the action ``wanted``, shape (6,) or (n,).

        Unless ``last`` is True, the world then advances to the next tick.
        """
        tick = self._ticks[self._tick : self._tick + 1]
        command = self._controller.carry_out(wanted, self.setting.by_joints, False, self._observation)
        self._controller.report(tick)
        if not last and self._world.step(command):
            tick["limits"] |= int(Limit.BRAKING)
        tick["faults"] |= self._world.acted_faults

    def _observed(self) -> dict[str, Any]:
        rows: Arrays = observed(self._seen, (sight for sight in self.setting.sees if sight != IMAGE))
        shown: dict[str, Any] = {name: array[0] for name, array in rows.items()}
        if IMAGE in self.setting.sees:
            assert isinstance(self._world, ShowsImages)  # the space of observations was refused else
            shown[IMAGE] = self._world.image().pixels
        return shown

    def _info(self) -> dict[str, Any]:
        """Return the info that ``reset`` describes.

        The margins are the least margins at the ticks so far, in SI units.
        """
        margins = {sentence: float(least[0]) for sentence, least in self._least.items()}
        success = bool(self.setting.rewards.succeeds(self._least, self._way_m)[0])
        cost = {"cost": float(self._cost[0])} if margins else {}  # a cost of no claim would be 0 for ever
        return {"margins": margins, **cost, "is_success": success, "scenario": self._stream.drawn}


def _repeated(
    given: dict[str, Any], seed: int | None, number: int, begun: bool, actions: list[NDArray[np.float64]]
) -> HarnessEnv:
    """Make an environment from the arguments ``given``, carry out ``actions`` in it, and return it.

    If an episode has ``begun``, it is the draw before ``number``.
    """
    env = HarnessEnv(**given)
    env._stream = env.setting.episodes.stream(seed, number - begun)
    if begun:
        env.reset()
    for action in actions:
        env.step(action)
    return env
