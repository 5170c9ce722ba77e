"""The system under test with everything that can be spoilt in it: avoider, gate, controller, world.

A fault never changes the system's own code: it wraps the avoider, the gate or the world, or edits the
records that one run's controller and world read.  Every ``with_`` gives another system; the one that it
is asked of stays sound.
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
from safety_harness.cell.simulation.simulate import INTERRUPTED, simulate
from safety_harness.cell.simulation.world import World
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.trace.trace import Trace

Records = NDArray[np.void]
Change = Callable[[Records], Records]  # of an observation (1,) or a command (1,), each tick
MakesChange = Callable[[Admitted], Change]  # afresh for each run, for what remembers


@dataclass(frozen=True, eq=False)
class ChangedSystem:
    """An admitted scenario, and what is changed in its controller and its world when it is run."""

    admitted: Admitted
    edits: tuple[Callable[[AvoidingServo], None], ...] = ()
    pilot: Callable[[AvoidingServo], Controller] | None = None
    worlds: tuple[Callable[[Any], World], ...] = ()

    def with_avoider(self, wrap: Callable[[Avoider], Avoider]) -> ChangedSystem:
        """With another avoider, made of this one."""
        return replace(self, admitted=replace(self.admitted, avoider=wrap(self.admitted.avoider)))

    def with_gate(self, cls: type[Gate] = Gate, /, **changed: Any) -> ChangedSystem:
        """With a gate of another class or with other fields."""

        def edit(pilot: AvoidingServo) -> None:
            pilot.gate = cls(**(vars(pilot.gate) | changed))

        return replace(self, edits=(*self.edits, edit))

    def with_records(self, edit: Callable[[ControllerRecords], None]) -> ChangedSystem:
        """With the parameters or the memory of each run's controller edited before it starts."""
        return replace(self, edits=(*self.edits, lambda pilot: edit(pilot.records)))

    def with_pilot(self, wrap: Callable[[AvoidingServo], Controller]) -> ChangedSystem:
        """With a controller around the one that it has."""
        return replace(self, pilot=wrap)

    def with_world(self, wrap: Callable[[Any], World]) -> ChangedSystem:
        """With another world around the one that it runs in."""
        return replace(self, worlds=(*self.worlds, wrap))

    def seeing(self, make: MakesChange) -> ChangedSystem:
        """With observations changed between the world and the controller."""
        return self.with_world(lambda world: WorldWrapper(world, see=make(self.admitted)))

    def obeying(self, make: MakesChange) -> ChangedSystem:
        """With commands changed between the controller and the world."""
        return self.with_world(lambda world: WorldWrapper(world, obey=make(self.admitted)))

    def starting_at(self, joint_position_rad: ArrayN) -> ChangedSystem:
        """With the arm at other joints at the start."""
        return replace(self, admitted=replace(self.admitted, joint_position_rad=joint_position_rad))

    def run(self, world: WorldEntry = KINEMATIC) -> Trace:
        """One run; whatever the faults raise passes through, and Ctrl-C raises KeyboardInterrupt.

        A user's controller is made afresh for each, so that a fault leaves nothing in it.
        """
        admitted = self.admitted
        scenario = admitted.scenario
        if admitted.driver is not None:
            controller: Controller = admitted.driven_by(admitted.driver.make())
        else:
            controller = self._servo()
        with world.open(scenario, admitted.arm, admitted.joint_position_rad) as episode:
            for wrap in self.worlds:
                episode = wrap(episode)
            with np.errstate(all="ignore"):  # a fault may divide by zero; what comes of it is in the trace
                trace = simulate(episode, controller, scenario)
        if trace.ended == INTERRUPTED:
            raise KeyboardInterrupt
        return trace

    def _servo(self) -> Controller:
        pilot = self.admitted.servo()
        for edit in self.edits:
            edit(pilot)
        return pilot if self.pilot is None else self.pilot(pilot)


class Delayed:
    """What was put in comes out ``delay_s`` later."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._waiting: deque[tuple[float, Any]] = deque()

    def put(self, now_s: float, what: Any) -> None:
        """In at ``now_s``."""
        self._waiting.append((now_s, what))

    def due(self, now_s: float) -> Any | None:
        """The last of what has come out by now and was not taken before; None if nothing has."""
        last = None
        while self._waiting and self._waiting[0][0] + self._delay_s <= now_s + 1e-9:
            _, last = self._waiting.popleft()
        return last


class WorldWrapper:
    """A world whose observations or commands are changed on their way; all else is the world's own.

    So are ``acted_faults``: they are of the scenario; what is seeded from outside has no bit.
    """

    name: str
    time_s: float
    acted_faults: int
    records: Any  # of the world within, for those who edit them

    def __init__(self, world: World, *, see: Change | None = None, obey: Change | None = None) -> None:
        self.world = world
        self._see, self._obey = see, obey

    def __getattr__(self, name: str) -> Any:
        return getattr(self.world, name)

    def true_state(self, tick: Records) -> None:
        """The truth stays the truth."""
        self.world.true_state(tick)

    def observe(self) -> Records:
        """(1,) OBSERVATION, changed if that is what is changed."""
        observation = self.world.observe()
        return observation if self._see is None else self._see(observation.copy())

    def step(self, command: Records) -> bool:
        """The command (1,) COMMAND, changed if that is what is changed."""
        return self.world.step(command if self._obey is None else self._obey(command.copy()))
