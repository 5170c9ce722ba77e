"""Define the system under test with an interface for changes to avoider, gate, controller and world.

A fault never changes the system's own code. It wraps the avoider, the gate or the world, or it edits the
records that a run's controller and world read. Each method ``with_...`` returns another system and leaves its
own system sound.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.controller.controller import AvoidingServo, Controller
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.cell.controller.filtered import FilterCalls
from safety_harness.cell.simulation.simulate import INTERRUPTED, simulate
from safety_harness.cell.simulation.world import World
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.trace.trace import Trace

Records = NDArray[np.void]
Change = Callable[[Records], Records]  # of an observation (1,) or a command (1,), each tick
MakesChange = Callable[[Admitted], Change]  # called for each run, since a change may have a memory


@dataclass(frozen=True, eq=False)
class ChangedSystem:
    """An admitted scenario, with the changes that its controller and its world get in each run."""

    admitted: Admitted
    edits: tuple[Callable[[AvoidingServo], None], ...] = ()
    pilot: Callable[[AvoidingServo], Controller] | None = None
    worlds: tuple[Callable[[Any], World], ...] = ()
    filter_edits: tuple[Callable[[FilterCalls], None], ...] = ()

    def with_avoider(self, wrap: Callable[[Avoider], Avoider]) -> ChangedSystem:
        """Return the system with the avoider that ``wrap`` makes around its own."""
        return replace(self, admitted=replace(self.admitted, avoider=wrap(self.admitted.avoider)))

    def with_gate(self, cls: type[Gate] = Gate, /, **changed: Any) -> ChangedSystem:
        """Return the system with a gate of the class ``cls``, or with changed fields of its gate."""

        def edit(pilot: AvoidingServo) -> None:
            pilot.gate = cls(**(vars(pilot.gate) | changed))

        return replace(self, edits=(*self.edits, edit))

    def with_records(self, edit: Callable[[ControllerRecords], None]) -> ChangedSystem:
        """Return the system with an edit of the controller's parameters or memory before each run."""
        return replace(self, edits=(*self.edits, lambda pilot: edit(pilot.records)))

    def with_pilot(self, wrap: Callable[[AvoidingServo], Controller]) -> ChangedSystem:
        """Return the system with the controller that ``wrap`` makes around its own."""
        return replace(self, pilot=wrap)

    def with_filter(self, edit: Callable[[FilterCalls], None]) -> ChangedSystem:
        """Return the system with an edit of the safety filter's calls before each run."""
        return replace(self, filter_edits=(*self.filter_edits, edit))

    def with_world(self, wrap: Callable[[Any], World]) -> ChangedSystem:
        """Return the system with the world that ``wrap`` makes around its own."""
        return replace(self, worlds=(*self.worlds, wrap))

    def seeing(self, make: MakesChange) -> ChangedSystem:
        """Return the system with a change of the observations between its world and its controller."""
        return self.with_world(lambda world: WorldWrapper(world, see=make(self.admitted)))

    def obeying(self, make: MakesChange) -> ChangedSystem:
        """Return the system with a change of the commands between its controller and its world."""
        return self.with_world(lambda world: WorldWrapper(world, obey=make(self.admitted)))

    def starting_at(self, joint_position_rad: ArrayN) -> ChangedSystem:
        """Return the system with another joint position (n,) [rad] at the start."""
        return replace(self, admitted=replace(self.admitted, joint_position_rad=joint_position_rad))

    def run(self, world: WorldEntry = KINEMATIC) -> Trace:
        """Run the system once.

        Exceptions of the faults pass through, and Ctrl-C raises KeyboardInterrupt. Each run creates a user's
        controller anew, so that no fault leaves a trace in it.
        """
        admitted = self.admitted
        if admitted.predictor is not None:
            fresh = replace(admitted.predictor, controller=admitted.predictor.make())
            admitted = replace(admitted, predictor=fresh)
        scenario = admitted.scenario
        if admitted.driver is not None:
            controller: Any = admitted.driven_by(admitted.driver.make())
        else:
            controller = self._servo(admitted)
        if admitted.safety_filter is not None:
            controller = admitted.filtered(controller, admitted.safety_filter.make())
            for edit in self.filter_edits:
                edit(controller.calls)
        with world.open(scenario, admitted.arm, admitted.joint_position_rad) as episode:
            for wrap in self.worlds:
                episode = wrap(episode)
            with np.errstate(all="ignore"):  # a fault may divide by zero; the trace has the result
                trace = simulate(episode, controller, scenario)
        if trace.ended == INTERRUPTED:
            raise KeyboardInterrupt
        return trace

    def _servo(self, admitted: Admitted) -> Controller:
        pilot = admitted.servo()
        for edit in self.edits:
            edit(pilot)
        return pilot if self.pilot is None else self.pilot(pilot)


class Delayed:
    """A queue that releases each item ``delay_s`` after it was put in."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._waiting: deque[tuple[float, Any]] = deque()

    def put(self, now_s: float, item: Any) -> None:
        """Put ``item`` into the queue at the time ``now_s``."""
        self._waiting.append((now_s, item))

    def due(self, now_s: float) -> Any | None:
        """Return the latest item that is due at ``now_s``, and drop all due items; None if no item is due."""
        last = None
        while self._waiting and self._waiting[0][0] + self._delay_s <= now_s + 1e-9:
            _, last = self._waiting.popleft()
        return last


class WorldWrapper:
    """A world whose observations or commands are changed; everything else is the inner world's own.

    ``acted_faults`` has bits only for the scenario's faults, not for a fault that is seeded from outside.
    """

    name: str
    time_s: float
    acted_faults: int
    records: Any  # of the world within, for edits

    def __init__(self, world: World, *, see: Change | None = None, obey: Change | None = None) -> None:
        self.world = world
        self._see, self._obey = see, obey

    def __getattr__(self, name: str) -> Any:
        return getattr(self.world, name)

    def true_state(self, tick: Records) -> None:
        """Write the unchanged truth of the inner world into ``tick``."""
        self.world.true_state(tick)

    def observe(self) -> Records:
        """Return the (1,) OBSERVATION, to which the change of observations is applied if there is one."""
        observation = self.world.observe()
        return observation if self._see is None else self._see(observation.copy())

    def step(self, command: Records) -> bool:
        """Pass the (1,) COMMAND to the world, after the change of commands if there is one."""
        return self.world.step(command if self._obey is None else self._obey(command.copy()))
