"""Run a user's safety filter, which may change each command between the controller and the drives.

The harness calls the filter like a controller, after the controller at every tick. The filter also sees the
command of the controller. If the filter returns this command, the command remains the same to the last bit.
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
    """A safety filter in an episode.

    The filter has its own view. At some ticks the filter passes the command while an earlier stop of the
    filter still lasts. ``holds`` is True at these ticks.
    """

    holds: bool = False

    def failed(self, why: str) -> ControllerError:
        """Return the error that ends the run at this tick.

        ``why`` is the reason of the error.
        """
        return ControllerError(str(super().failed(why)).replace("the controller", "the safety filter", 1))

    def filter(self, wanted: NDArray[np.void], observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return the filter's record COMMAND (1,).

        If the filter does not change the command ``wanted`` (1,), the result is ``wanted`` itself.

        A stop of the filter lasts as long as a stop of a controller. Until the end of the stop, the filter
        does not pass any command.
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
        """Return the COMMAND (1,) after the filter.

        ``observation`` (1,) is a record OBSERVATION.
        """
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
        """Set the previous motion, from which controller and filter compute the next acceleration.

        If the command ``command`` (1,) moves the arm, this motion is the motion that the command demands. If
        the command demands a stop, this motion is the measured motion, because the brakes act.
        ``observation`` (1,) is a record OBSERVATION.
        """
        pilot, own = self._records.state, self.calls.records.state
        if self._changed:
            stop = bool(command["protective_stop"][0])
            rates = (observation["joint_velocity_radps"] if stop else command["joint_velocity_radps"])[0]
            pilot["previous_twist_in_base"] = product(pilot[0]["jacobian"], rates)
        own["previous_twist_in_base"] = pilot["previous_twist_in_base"]

    def report(self, tick: NDArray[np.void]) -> None:
        """Let the controller report into the trace, then add the limits that changed the command.

        ``tick`` (1,) is a record TICK of the trace.
        """
        self.pilot.report(tick)
        tick["limits"] |= self.calls.records.state["limits"]
        if self._changed:
            tick["limits"] |= int(Limit.SAFETY_FILTER)
            if bool(self._records.command["protective_stop"][0]):
                tick["mode"] = int(Mode.PROTECTIVE_STOP)

    def sees_images_of(self, image: Callable[[], Any]) -> None:
        """Let the controller and the filter see the current ``image()``, if they see images."""
        self.calls.sees_images_of(image)
        if isinstance(self.pilot, DrivenController):
            self.pilot.sees_images_of(image)

    @property
    def decisions(self) -> NDArray[np.void]:
        """The controller's decisions."""
        return self.pilot.decisions

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """The latencies [s] of the controller's decisions."""
        return self.pilot.decision_latencies_s

    @property
    def answers_took_s(self) -> list[float]:
        """The wall-clock time [s] of each answer of a user's controller.

        The list is empty for the visual servo.
        """
        return self.pilot.answers_took_s if isinstance(self.pilot, DrivenController) else []

    @property
    def known(self) -> dict[str, Measurement]:
        """The columns of a trace that the controller does not report."""
        return self.pilot.known if isinstance(self.pilot, DrivenController) else {}
