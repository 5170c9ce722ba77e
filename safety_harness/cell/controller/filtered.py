"""Run a user's safety filter, which may change each command between the controller and the drives.

The filter is called like a controller, at every tick after it.  It also sees the command that the controller
wants.  If it returns this command, the command stays as it is, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import ControllerError
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.controller.driven import DrivenController
from safety_harness.trace.known import Measurement
from safety_harness.trace.records import Limit, Mode, filtered_dtype


class FilterCalls(DrivenController):
    """The calls of a safety filter in an episode, with a view of its own.

    ``holds`` is true at a tick at which the filter lets the command pass, but its earlier stop still lasts.
    """

    holds: bool = False

    def failed(self, why: str) -> ControllerError:
        """Return the error with the reason ``why``, which ends the run at this tick."""
        return ControllerError(str(super().failed(why)).replace("the controller", "the safety filter", 1))

    def filter(self, wanted: NDArray[np.void], observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return the filter's COMMAND (1,), which is ``wanted`` (1,) COMMAND itself if it stays unchanged.

        A stop of the filter lasts like a stop of a controller, and no command passes until its end.
        """
        seen, state = self.perceive(observation), self.records.state
        rates_radps, stop = wanted["joint_velocity_radps"][0], bool(wanted["protective_stop"][0])
        seen["wanted_radps"], seen["wanted_stop"] = 0.0 if stop else rates_radps, stop
        self.ask()
        answers, stopped = self.answers, state[0]["mode"] == int(Mode.PROTECTIVE_STOP)
        by_joints, stops = bool(answers.by_joints[0]), bool(answers.stop[0])
        same = stops if stop else by_joints and np.array_equal(answers.joints[0], rates_radps)
        self.holds = same and not stop and stopped
        if same and (stop or not stopped):
            state["limits"] = 0
            self.question["tick"] += 1
            return wanted
        rates = answers.joints[0] if by_joints else answers.twists[0]
        return self.carry_out(rates, by_joints, stops, observation)


class FilteredController:
    """A controller whose commands pass through a safety filter.

    Args:
        pilot: The controller.
        calls: The safety filter.
        ticks: The number of ticks of the run.

    """

    def __init__(
        self, pilot: AvoidingServo | ControllerWrapper | DrivenController, calls: FilterCalls, ticks: int
    ) -> None:
        self.pilot, self.calls, self.name = pilot, calls, pilot.name
        self._records = pilot.pilot.records if isinstance(pilot, ControllerWrapper) else pilot.records
        joints = self._records.command["joint_velocity_radps"].shape[1]
        self.filtered = np.zeros(ticks, filtered_dtype(joints))
        self._changed, self._tick = False, 0

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return the filtered COMMAND (1,) for ``observation`` (1,) OBSERVATION."""
        wanted = self.pilot.step(observation).copy()
        record = self.filtered[self._tick]
        record["wanted_radps"] = wanted["joint_velocity_radps"][0]
        record["wanted_stop"] = wanted["protective_stop"][0]
        command = self.calls.filter(wanted, observation)
        record["held"] = self.calls.holds
        names = command.dtype.names or ()  # the bytes between the fields are arbitrary
        self._changed = any(not np.array_equal(command[name], wanted[name]) for name in names)
        self._tick += 1
        if self._changed:
            self._records.command[:] = command
        self._continue_from(command, observation)
        return command

    def _continue_from(self, command: NDArray[np.void], observation: NDArray[np.void]) -> None:
        """Let controller and filter bound the next acceleration from the arm's motion by ``command`` (1,).

        During a stop the brakes decide, so the motion is the measured one; ``observation`` (1,) OBSERVATION.
        """
        pilot, own = self._records.state, self.calls.records.state
        if self._changed:
            stop = bool(command["protective_stop"][0])
            rates = (observation["joint_velocity_radps"] if stop else command["joint_velocity_radps"])[0]
            pilot["previous_twist_in_base"] = product(pilot[0]["jacobian"], rates)
        own["previous_twist_in_base"] = pilot["previous_twist_in_base"]

    def report(self, tick: NDArray[np.void]) -> None:
        """Let the controller write into ``tick`` (1,) TICK, then add the limits that changed the command."""
        self.pilot.report(tick)
        tick["limits"] |= self.calls.records.state["limits"]
        if self._changed:
            tick["limits"] |= int(Limit.SAFETY_FILTER)
            if bool(self._records.command["protective_stop"][0]):
                tick["mode"] = int(Mode.PROTECTIVE_STOP)

    def sees_images_of(self, image: Callable[[], Any]) -> None:
        """Show the present ``image()`` to the controller and the filter, if they see images."""
        self.calls.sees_images_of(image)
        if isinstance(self.pilot, DrivenController):
            self.pilot.sees_images_of(image)

    @property
    def decisions(self) -> NDArray[np.void]:
        """The controller's decisions."""
        return self.pilot.decisions

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """The controller's latencies [s]."""
        return self.pilot.decision_latencies_s

    @property
    def answers_took_s(self) -> list[float]:
        """The wall-clock time [s] of each answer of a user's controller; empty for the visual servo."""
        return self.pilot.answers_took_s if isinstance(self.pilot, DrivenController) else []

    @property
    def known(self) -> dict[str, Measurement]:
        """The columns of the traces that the controller does not report."""
        return self.pilot.known if isinstance(self.pilot, DrivenController) else {}
