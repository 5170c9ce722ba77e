"""Define a system under test whose avoider, gate, controller and world can be changed.

A fault never changes the system's own code. Instead, it wraps the avoider, the gate or the world, or it edits
records that the controller and the world read in a run. Each method ``with_...`` returns a new system and
does not change its own system.
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
    """An admitted scenario, and changes to its controller and to its world; each run applies all changes."""

    admitted: Admitted
    edits: tuple[Callable[[AvoidingServo], None], ...] = ()
    pilot: Callable[[AvoidingServo], Controller] | None = None
    worlds: tuple[Callable[[Any], World], ...] = ()
    filter_edits: tuple[Callable[[FilterCalls], None], ...] = ()

    def with_avoider(self, wrap: Callable[[Avoider], Avoider]) -> ChangedSystem:
        """Return a copy of the system with a new avoider, which ``wrap`` makes from the present avoider."""
        return replace(self, admitted=replace(self.admitted, avoider=wrap(self.admitted.avoider)))

    def with_gate(self, cls: type[Gate] = Gate, /, **changed: Any) -> ChangedSystem:
        """Return the system with a gate of the class ``cls``, or with changed fields of its gate."""

        def edit(pilot: AvoidingServo) -> None:
            pilot.gate = cls(**(vars(pilot.gate) | changed))

        return replace(self, edits=(*self.edits, edit))

    def with_records(self, edit: Callable[[ControllerRecords], None]) -> ChangedSystem:
        """Return the system in which ``edit`` changes the controller's records before each run."""
        return replace(self, edits=(*self.edits, lambda pilot: edit(pilot.records)))

    def with_pilot(self, wrap: Callable[[AvoidingServo], Controller]) -> ChangedSystem:
        """Return a copy of the system with a new controller, which ``wrap`` makes from the present one."""
        return replace(self, pilot=wrap)

    def with_filter(self, edit: Callable[[FilterCalls], None]) -> ChangedSystem:
        """Return the system in which ``edit`` changes the calls of the safety filter before each run."""
        return replace(self, filter_edits=(*self.filter_edits, edit))

    def with_world(self, wrap: Callable[[Any], World]) -> ChangedSystem:
        """Return a copy of the system with a new world, which ``wrap`` makes from the present world."""
        return replace(self, worlds=(*self.worlds, wrap))

    def seeing(self, make: MakesChange) -> ChangedSystem:
        """Return the system with a change to the observations that its controller gets from its world."""
        return self.with_world(lambda world: WorldWrapper(world, see=make(self.admitted)))

    def obeying(self, make: MakesChange) -> ChangedSystem:
        """Return the system with a change to the commands that its world gets from its controller."""
        return self.with_world(lambda world: WorldWrapper(world, obey=make(self.admitted)))

    def starting_at(self, joint_position_rad: ArrayN) -> ChangedSystem:
        """Return the system with the joint positions ``joint_position_rad`` (n,) at the start."""
        return replace(self, admitted=replace(self.admitted, joint_position_rad=joint_position_rad))

    def run(self, world: WorldEntry = KINEMATIC) -> Trace:
        """Run the system once.

        Exceptions that a fault raises are passed on, and Ctrl-C raises KeyboardInterrupt. Each run creates a
        new instance of the user's controller. A fault in one run therefore does not affect later runs.
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
    """A queue from which an item can be taken once ``delay_s`` has passed since it was added."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._waiting: deque[tuple[float, Any]] = deque()

    def put(self, now_s: float, item: Any) -> None:
        """Add ``item`` to the queue; ``now_s`` is the present time."""
        self._waiting.append((now_s, item))

    def due(self, now_s: float) -> Any | None:
        """Remove all items that are due at ``now_s``, and return the latest of them.

        The result is None if no item is due.
        """
        last = None
        # The tolerance allows for rounding in the sum of two times.
        while self._waiting and self._waiting[0][0] + self._delay_s <= now_s + 1e-9:
            _, last = self._waiting.popleft()
        return last


class WorldWrapper:
    """A wrapper of a world that changes its observations or commands and leaves everything else unchanged.

    ``acted_faults`` contains only the faults in the scenario. It does not contain seeded faults.
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
        """Write the true state of the inner world into ``tick``, without any change."""
        self.world.true_state(tick)

    def observe(self) -> Records:
        """Return an OBSERVATION, shape (1,).

        If there is a change of observations, it has been applied.
        """
        observation = self.world.observe()
        return observation if self._see is None else self._see(observation.copy())

    def step(self, command: Records) -> bool:
        """Pass the COMMAND to the world, shape (1,).

        If there is a change of commands, it is applied first.
        """
        return self.world.step(command if self._obey is None else self._obey(command.copy()))
