"""Run scenarios in the user's own simulator, a program that exchanges lines with the harness.

The harness computes hands, sensors, drives and claims. The simulator moves the arm. Each state from the
simulator is checked. A state that cannot be true ends the run with an error and never becomes evidence.
"""

from __future__ import annotations

import logging
import os
import shlex
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import (
    EditedProgramError,
    InadmissibleError,
    Place,
    SimulationError,
    printable,
)
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.cell.controller.out_of_process.references import peer_of, program_sha256
from safety_harness.cell.controller.records import CommandRecords
from safety_harness.cell.perception.detector import BoundingBoxDetector
from safety_harness.cell.robot.description import ArmModel, resolved_urdf
from safety_harness.cell.simulation.steps import drive_on, move_on
from safety_harness.cell.simulation.world import RecordedWorld
from safety_harness.cell.simulation.worlds import OTHER_BITS, SIMULATOR, OpensWorld, WorldEntry
from safety_harness.extensions.worlds.program_messages import (
    MOST_BYTES,
    PROTOCOL,
    HandNow,
    WorldHello,
    WorldReset,
    WorldState,
    WorldStep,
    WorldWelcome,
    said_by_simulator,
)
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import EXEC
from safety_harness.seams.isolation.channel import GoneError, NonsenseError
from safety_harness.seams.isolation.connection import Connection, RefusedError, json_wire, refusing
from safety_harness.seams.isolation.messages import Failed, ProcessMessage
from safety_harness.trace.trace import Provenance

LOGGER = logging.getLogger("safety_harness.world")
PLACE = Place(field="world")
BEGIN_S = 60.0  # for the start and the first message
# The largest accepted differences from the harness's own state; a choice.
SAME_RAD, SAME_S, SAME_M, SAME_DISTANCE_M = 1e-6, 1e-5, 1e-3, 5e-3
ROUNDING_RAD = 1e-6  # of a position, with six decimals or as float32
SPEEDS_TELL = 0.05  # the share of a joint's way that its speeds may leave unexplained in an episode
FASTEST = 1.5  # times the URDF's speed limit: no joint is faster, whatever the simulator's bound
TRIED_S = 0.8  # of an episode that is run twice, with slow set points
FOLLOWS = (0.55, 1.8)  # what a joint turns then, as a share of what its set point asks for


def program_world(reference: str) -> WorldEntry:
    """Return the world for a reference of the form ``exec:COMMAND``, ``tcp:HOST:PORT`` or ``unix:PATH``.

    No program is executed before a scenario is opened. If a file of a running simulator has changed since the
    simulator started, the function ends the simulator. The next run then starts it again.
    """
    if (running := _running.get(reference)) is not None and running.is_edited:
        running.end()
        simulator.cache_clear()
    return WorldEntry(
        name=reference,
        label=reference,
        load=partial(_opener, reference),
        substeps=True,
        model_only=True,
        program=True,
    )


@lru_cache  # each run opens the world, and this reads the program's files
def _opener(reference: str) -> OpensWorld:
    """Return the function that opens a scenario in a simulator."""
    peer_of(reference, PLACE, BEGIN_S, LOGGER)  # refuses a program that does not exist
    return partial(ProgramWorld, reference)


class Simulator:
    """A user's simulator, in a process that serves one episode after another."""

    def __init__(self, reference: str) -> None:
        """Start the program; raise ``InadmissibleError`` if it is not a simulator."""
        self.reference, self._stamp = reference, _stamp(reference)
        self.sha256 = program_sha256(reference, PLACE)
        wire = json_wire(said_by_simulator.decode, MOST_BYTES)
        subject, start = peer_of(reference, PLACE, BEGIN_S, LOGGER)
        self._connection = Connection(start, wire)
        with refusing(InadmissibleError, f"{subject} to be a simulator", BEGIN_S, PLACE):
            self._said = self._begun()
        self.repeats: bool | None = None  # None until it is tried
        _running[reference] = self

    @property
    def is_edited(self) -> bool:
        """True if the content of any file in the command has changed since the simulator began."""
        if (stamp := _stamp(self.reference)) == self._stamp:
            return False
        if program_sha256(self.reference, PLACE) != self.sha256:
            return True
        self._stamp = stamp
        return False

    def _begun(self) -> WorldWelcome:
        welcome = self._connection.introduce(WorldHello(), WorldWelcome, BEGIN_S)
        if welcome.protocol != PROTOCOL:
            hint = "safety-harness docs reference/world-protocol"
            raise RefusedError(f"the protocol {PROTOCOL!r}", repr(welcome.protocol), hint)
        return welcome

    def acceleration_radps2(self, joints: int) -> NDArray[np.float64]:
        """Return the bound on each joint's acceleration, shape (joints,).

        The bound is infinite if the simulator states no bound.
        """
        stated = self._said.joint_acceleration_radps2
        bound = np.array(np.inf if stated is None else stated, dtype=np.float64)
        bound = np.full(joints, bound) if bound.ndim == 0 else bound
        if bound.shape != (joints,) or not (bound >= 0.0).all():
            got = printable(str(stated))
            raise SimulationError(
                f"joint_acceleration_radps2: expected {joints} numbers of at least 0, or one; got {got}"
            )
        return bound

    def call(self, message: ProcessMessage, limit_s: float) -> WorldState:
        """Return the simulator's state after a message; raise ``SimulationError`` if there is no valid state.

        After an error, the next ``reset`` starts the program anew.
        """
        try:
            if isinstance(message, WorldReset) and self.is_edited:
                expected, got = "a simulator whose files do not change while a job runs", "other contents"
                raise EditedProgramError(place=PLACE, expected=expected, got=got, hint="begin the job again")
            # After an error, an old answer may still be on its way, so the episode begins in a new process.
            if isinstance(message, WorldReset) and not self._connection.quiet:
                self._connection.end()
                if self._begun() != self._said:
                    raise NonsenseError("after a restart it describes itself differently")
            self._connection.say(message, limit_s)
            answer = self._connection.hear(limit_s)
            if isinstance(answer, WorldState):
                return answer
            if not isinstance(answer, Failed):
                raise NonsenseError(f"expected a state; it said {answer.__struct_config__.tag}")
            reason = answer.why
        except BaseException as error:  # a later message might belong to this question
            self._connection.end()
            if isinstance(error, GoneError) and error.hung:
                reason = f"it gave no state within {limit_s:g} s of wall time"
            elif isinstance(error, GoneError | RefusedError | ValueError):
                reason = str(error)
            else:
                raise  # Ctrl-C, or a mistake of ours
        raise SimulationError(f"{self.reference}: {printable(reason)}")

    def end(self) -> None:
        """End the process after an episode that failed, so that the next episode begins a new process."""
        self._connection.end()

    @property
    def described(self) -> str:
        """A text for the provenance of a run: the simulator's name, version, hash and repeatability."""
        of_file = f"sha256 {self.sha256}" if self.sha256 else "of unknown content"
        bits = "the same bits" if self.repeats else OTHER_BITS
        twice = f"{bits} in a second episode of {TRIED_S:g} s"
        return printable(f"{self._said.name} {self._said.version}, {of_file}, {twice}")


simulator = lru_cache(Simulator)  # one for each process and reference
_running: dict[str, Simulator] = {}


def _stamp(reference: str) -> list[tuple[int, int]]:
    """Return the size and the modification time of each file in a command.

    Comparing these values is faster than reading the files.
    """
    files = filter(os.path.isfile, shlex.split(reference.removeprefix(EXEC)))
    return [(status.st_size, status.st_mtime_ns) for status in map(os.stat, files)]


class ProgramWorld(RecordedWorld):
    """A scenario in the user's simulator, to be used once, as a context manager."""

    def __init__(
        self,
        reference: str,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> None:
        self.name = reference
        super().__init__(scenario, arm, joint_position_rad)
        clock = scenario.settings.clock
        self._period_s, self._limit_s = clock.control_period_s, clock.wall_limit_s
        self._simulator = simulator(reference)
        joints = len(arm.joint_names)
        self._commanded_radps = np.empty(joints)
        self._way_rad, self._unexplained_rad, self._fastest_so_far_radps = np.zeros((3, joints))
        self._bound_radps2 = self._simulator.acceleration_radps2(joints)
        self._fastest_radps = FASTEST * arm.velocity_limit_radps
        # With bounded acceleration, a speed leaves the range of both ends of a tick by at most a dt / 2.
        beyond_radps = 0.5 * self._bound_radps2 * self._period_s
        self.overshoot_radps = np.tile(beyond_radps, (scenario.ticks + 1, 1))
        self.overshoot_radps[-1] = 0.0  # no tick follows
        reset = WorldReset(
            urdf=resolved_urdf(arm, visuals=False),
            transform_seat=arm.transform_seat,
            last_link=arm.link_names[-1],
            transform_tcp_to_last_link=arm.flange,
            table_height_m=scenario.settings.cell.table_height_m,
            hand_radius_m=scenario.settings.hand.radius_m,
            forearm_radius_m=scenario.settings.hand.forearm_radius_m,
            joint_names=arm.joint_names,
            joint_position_rad=joint_position_rad,
            period_s=self._period_s,
            seed=str(scenario.seed),
        )
        if self._simulator.repeats is None:
            self._simulator.repeats = self._tried(reset) == self._tried(reset)
            if not self._simulator.repeats:
                LOGGER.warning("%s does not repeat itself: no run of it can be made again", reference)
        self._begin(reset)

    def provenance_of(self, made: Provenance) -> Provenance:
        """Return ``made`` with a description of the simulator, that is, its name, version and hash."""
        return replace(made, libraries=(*made.libraries, (SIMULATOR, self._simulator.described)))

    def step(self, command: NDArray[np.void]) -> bool:
        """Run the drives, and let the simulator move the arm by a control period.

        ``command`` (1,) COMMAND. Return True if the brakes are active.
        """
        r = self.records
        braking = drive_on(
            r.drives, r.arm, r.truth, r.clock, r.faults, CommandRecords(command), self._commanded_radps
        )
        tick = int(r.clock[0]["tick"])
        hands = [
            HandNow(bool(hand["present"]), hand["position_in_base_m"], hand["elbow_in_base_m"])
            for hand in r.hands
        ]
        state = self._simulator.call(
            WorldStep(tick, self._commanded_radps, bool(braking), hands), self._limit_s
        )
        position_rad, velocity_radps = self._numbers(state, tick + 1)
        self.overshoot_radps[tick] = self._overshoot_radps(state, position_rad, velocity_radps)
        move_on(*r[1:9], position_rad, velocity_radps)
        self._compare(state)
        return braking

    def _begin(self, reset: WorldReset) -> None:
        """Begin an episode, and check that its first state is the arm at rest at the start position."""
        state = self._simulator.call(reset, self._limit_s)
        position_rad, velocity_radps = self._numbers(state, 0)
        start_rad = self.records.truth[0]["joint_position_rad"]
        if not np.abs(position_rad - start_rad).max() <= SAME_RAD:
            self._refuse(f"its joints begin at {position_rad.tolist()} rad; expected {start_rad.tolist()}")
        if not np.abs(velocity_radps).max() <= SAME_RAD:
            self._refuse(f"its joints begin with {velocity_radps.tolist()} rad/s; expected rest")
        self._compare(state)

    def _tried(self, reset: WorldReset) -> bytes:
        """Return the states of a short episode as bytes; each joint follows its own slow set point.

        The set points of any two joints differ in sign, or by a factor of at least two. Thus exchanged
        joints, a wrong sign and a wrong unit are detected.
        """
        self._begin(reset)
        joints, ticks = len(self._commanded_radps), round(TRIED_S / self._period_s)
        radps = np.array([0.01 * (-1) ** k * 2.0 ** (k // 2) for k in range(joints)])
        seen, position_rad = bytearray(), np.array(reset.joint_position_rad)
        for tick in range(ticks):
            state = self._simulator.call(WorldStep(tick, radps, False, []), self._limit_s)
            position_rad, velocity_radps = self._numbers(state, tick + 1)
            seen += position_rad.tobytes() + velocity_radps.tobytes()
        turned_rad, asked_rad = position_rad - reset.joint_position_rad, radps * ticks * self._period_s
        share = turned_rad / asked_rad
        if (joint := _first(~((FOLLOWS[0] <= share) & (share <= FOLLOWS[1])))) is not None:
            self._refuse(
                f"joint {joint + 1} turns by {turned_rad[joint]:.3g} rad while its set point asks for "
                f"{asked_rad[joint]:.3g} rad in {TRIED_S:g} s: is it another joint, sign or unit?"
            )
        return bytes(seen)

    def _overshoot_radps(
        self, state: WorldState, position_rad: NDArray[np.float64], velocity_radps: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Check the motion between two ticks.

        Return how far the speeds during the motion may lie outside the range between the first and the last
        speed. If the simulator states a range of speeds, the mean speed must lie in this range. Otherwise,
        let a be the largest acceleration, dt the period, and s the mean of the first and the last speed. The
        distance that a joint moves must differ from s dt by at most a dt^2 / 4.
        """
        truth, dt, tick = self.records.truth[0], self._period_s, state.tick
        ends_radps = np.stack([truth["joint_velocity_radps"], velocity_radps])
        mean_radps = (position_rad - truth["joint_position_rad"]) / dt
        middle_radps, beyond_radps = ends_radps.mean(axis=0), 0.5 * self._bound_radps2 * dt
        least_radps, most_radps = middle_radps - 0.5 * beyond_radps, middle_radps + 0.5 * beyond_radps
        if state.joint_velocity_range_radps is not None:
            least_radps, most_radps = self._range(state.joint_velocity_range_radps, velocity_radps, tick)
            above, below = most_radps - ends_radps.max(axis=0), ends_radps.min(axis=0) - least_radps
            beyond_radps = np.maximum(np.maximum(above, below), 0.0)
        # A mean speed is the difference of two rounded positions.
        rounding_radps = ROUNDING_RAD / dt
        jump_radps = np.abs(ends_radps[1] - ends_radps[0]) - self._bound_radps2 * dt
        unranged = state.joint_velocity_range_radps is None
        if unranged and (joint := _first(jump_radps > rounding_radps)) is not None:
            self._refuse(f"joint {joint + 1} accelerates before tick {tick} beyond the bound that it states")
        off_radps = np.maximum(least_radps - mean_radps, mean_radps - most_radps)
        impossible = ~(off_radps <= rounding_radps)
        if (joint := _first(impossible)) is not None:
            self._refuse(
                f"joint {joint + 1} moves at {mean_radps[joint]:.6g} rad/s on average before tick {tick}; "
                f"its speeds allow {least_radps[joint]:.6g} to {most_radps[joint]:.6g} rad/s"
            )
        fastest_radps = np.maximum(np.abs(velocity_radps), np.abs(mean_radps))
        if (joint := _first(fastest_radps > self._fastest_radps)) is not None:
            self._refuse(
                f"joint {joint + 1} moves at {fastest_radps[joint]:.3g} rad/s before tick {tick}; its limit "
                f"is {self._fastest_radps[joint] / FASTEST:.3g} rad/s"
            )
        self._compare_speeds(mean_radps, ends_radps, tick)
        return np.asarray(np.maximum(beyond_radps, off_radps))

    def _compare_speeds(
        self, mean_radps: NDArray[np.float64], ends_radps: NDArray[np.float64], tick: int
    ) -> None:
        """Compare the distance that each joint has moved since the start with the sum of its speeds.

        This detects speeds with a wrong size or sign, even if no range or bound is stated.
        """
        dt = self._period_s
        self._way_rad += np.abs(mean_radps) * dt
        self._unexplained_rad += (mean_radps - ends_radps.mean(axis=0)) * dt
        fastest_radps = np.maximum(np.abs(ends_radps).max(axis=0), np.abs(mean_radps))
        self._fastest_so_far_radps = np.maximum(self._fastest_so_far_radps, fastest_radps)
        # A choice: a twentieth of the way, two ticks at the greatest speed, and the rounding of positions.
        most_rad = SPEEDS_TELL * self._way_rad + 2.0 * dt * self._fastest_so_far_radps + 1e-4
        if (joint := _first(~(np.abs(self._unexplained_rad) <= most_rad))) is not None:
            self._refuse(
                f"joint {joint + 1} has moved {self._way_rad[joint]:.4g} rad by tick {tick}, and its speeds "
                f"do not explain {abs(self._unexplained_rad[joint]):.4g} rad of it"
            )

    def _range(
        self, stated: tuple[list[float], list[float]], velocity_radps: NDArray[np.float64], tick: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the stated range of speeds in a state.

        The speed at the end of the tick must lie in this range.
        """
        least_radps, most_radps = (np.array(speeds, dtype=np.float64) for speeds in stated)
        if least_radps.shape != velocity_radps.shape or most_radps.shape != velocity_radps.shape:
            self._refuse(f"joint_velocity_range_radps: expected two rows of {len(velocity_radps)} numbers")
        if not ((least_radps <= velocity_radps) & (velocity_radps <= most_radps)).all():
            self._refuse(f"joint_velocity_range_radps does not include joint_velocity_radps in tick {tick}")
        return least_radps, most_radps

    def _numbers(self, state: WorldState, tick: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the joint positions and speeds in a state.

        Raise ``SimulationError`` if the state is for another tick than ``tick``, or if a number is missing or
        not finite.
        """
        if state.tick != tick or not abs(state.time_s - tick * self._period_s) <= SAME_S:
            expected = f"tick {tick} at {tick * self._period_s:g} s"
            self._refuse(f"its state is of tick {state.tick} at {state.time_s:g} s; expected {expected}")
        arrays = []
        for name in ("joint_position_rad", "joint_velocity_radps"):
            array = np.array(getattr(state, name), dtype=np.float64)
            if array.shape != self._commanded_radps.shape or not np.isfinite(array).all():
                expected = f"{len(self._commanded_radps)} finite numbers"
                self._refuse(f"{name}: expected {expected}; got {array.tolist()}")
            arrays.append(array)
        return arrays[0], arrays[1]

    def _compare(self, state: WorldState) -> None:
        """Compare the TCP and the hand distance in the simulator's state with the harness's own values.

        The simulator may omit these two values.
        """
        truth = self.records.truth[0]
        if state.tcp_position_in_base_m is not None:
            own_m = truth["transform_tcp_to_base"][:3, 3]
            their_m = np.array(state.tcp_position_in_base_m, dtype=np.float64)
            if their_m.shape != (3,) or not np.abs(their_m - own_m).max() <= SAME_M:
                frames = "its base frame, tool or joint order differs"
                self._refuse(f"its TCP is at {their_m.tolist()} m; expected {own_m.tolist()}: {frames}")
        if state.hand_distance_m is not None:
            own = float(truth["hand_distance_m"].min(initial=np.inf))
            if not abs(state.hand_distance_m - own) <= SAME_DISTANCE_M:
                self._refuse(f"its least hand distance is {state.hand_distance_m:g} m; expected {own:g} m")

    def _refuse(self, reason: str) -> None:
        """End the simulator's episode; raise ``SimulationError`` with a reason."""
        self._simulator.end()
        raise SimulationError(f"{self.name}: {printable(reason)}")


def _first(flags: NDArray[np.bool_]) -> int | None:
    """Return the index of the first True, or None if all are False."""
    return int(np.argmax(flags)) if flags.any() else None
