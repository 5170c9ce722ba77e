"""A scenario as frozen data: what is tried, and nothing that needs the rest of the house.

Claims and avoiders are plain references here (the sentence as the user wrote it); ``admission``
resolves them.  Everything is in SI; the units that people write belong to ``read``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import Place
from safety_harness.scenario.faults import Fault
from safety_harness.scenario.moves import REACHING_MPS, REACHING_MPS2, HandMove, Tremor
from safety_harness.settings import DEFAULTS, Settings, Vector3

MAX_HANDS = 2


class Verdict(Enum):
    """What a property says of a trace."""

    HOLDS = "holds"
    VIOLATED = "violated"
    INCONCLUSIVE = "inconclusive"


class Robot(Enum):
    """Which arm of the package of robot descriptions stands in the cell."""

    UR10 = "UR10"
    UR5 = "UR5"
    UR3 = "UR3"

    @property
    def arm_name(self) -> str:
        """As its description is filed."""
        return self.value.lower()


@dataclass(frozen=True, kw_only=True)
class OffsetStart:
    """A TCP start relative to the desired pose.

    ``offset_in_base_m`` shifts the desired TCP position; ``tilt_in_tcp_rad`` is a rotation vector
    in the desired TCP frame (zero: the camera looks straight down).
    """

    offset_in_base_m: Vector3
    tilt_in_tcp_rad: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class JointStart:
    """A TCP start by its six joint angles."""

    joint_position_rad: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class PoseStart:
    """A TCP start by its place in the base frame; ``tilt_in_tcp_rad`` as in OffsetStart."""

    position_in_base_m: Vector3
    tilt_in_tcp_rad: Vector3 = (0.0, 0.0, 0.0)


TcpStart = OffsetStart | PoseStart | JointStart


@dataclass(frozen=True, kw_only=True)
class MovingHand:
    """A hand that does one move after another, then rests.

    The forearm points from the hand's centre towards ``elbow_towards_in_base_m`` (where the
    person stands) at every moment.  ``shift_in_base_m`` shifts the start and every point of the
    moves; the first move begins after ``delay_s``.  The hand never exceeds ``max_speed_mps``, its
    tremor included, nor its moves ``max_acceleration_mps2``; the tremor's own comes on top.
    """

    name: str
    starts_at_in_base_m: Vector3
    elbow_towards_in_base_m: Vector3
    moves: tuple[HandMove, ...]
    shift_in_base_m: Vector3 = (0.0, 0.0, 0.0)
    delay_s: float = 0.0
    max_speed_mps: float = REACHING_MPS
    max_acceleration_mps2: float = REACHING_MPS2
    tremor: Tremor | None = None

    @property
    def max_move_speed_mps(self) -> float:
        """What the tremor leaves of the speed bound for the moves."""
        return self.max_speed_mps - (self.tremor.max_speed_mps if self.tremor else 0.0)


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Samples of a recorded hand, already placed, turned and timed in the robot's base frame.

    ``time_s`` (n,) rises strictly from 0; ``hand_position_in_base_m`` and
    ``elbow_position_in_base_m`` are (n, 3), finite.  Between samples the motion is straight.
    ``notes`` says in words what was bridged (gaps, jumps) and what that amounts to.
    """

    time_s: NDArray[np.float64]
    hand_position_in_base_m: NDArray[np.float64]
    elbow_position_in_base_m: NDArray[np.float64]
    notes: tuple[str, ...]
    sha256: str  # of the file's bytes

    def __post_init__(self) -> None:
        for array in (self.time_s, self.hand_position_in_base_m, self.elbow_position_in_base_m):
            array.setflags(write=False)

    @property
    def max_speed_mps(self) -> float:
        """The hand's largest speed between two samples."""
        way_m = np.linalg.norm(np.diff(self.hand_position_in_base_m, axis=0), axis=1)
        return float((way_m / np.diff(self.time_s)).max())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RecordedMotion):
            return NotImplemented
        return (
            self.sha256 == other.sha256
            and self.notes == other.notes
            and np.array_equal(self.time_s, other.time_s)
            and np.array_equal(self.hand_position_in_base_m, other.hand_position_in_base_m)
            and np.array_equal(self.elbow_position_in_base_m, other.elbow_position_in_base_m)
        )


@dataclass(frozen=True, kw_only=True)
class RecordedHand:
    """A hand that repeats a recording.

    The recording's first used sample is put at ``starts_at_in_base_m`` + ``shift_in_base_m`` after a
    turn by ``turn_rad`` about the vertical; it begins after ``delay_s`` and its time runs
    ``speed_factor`` times as fast.  Only the part from ``from_s`` to ``to_s`` on the recording's own
    clock is used (None: its beginning, its end).  Without a recorded elbow the forearm points
    towards ``elbow_towards_in_base_m``.  None for ``max_speed_mps``: as recorded, and at most
    REACHING_MPS if it is sped up.
    """

    name: str
    recording: Path
    track: str  # the column group: "right_hand" or "left_hand", say
    elbow_track: str | None
    elbow_towards_in_base_m: Vector3 | None
    starts_at_in_base_m: Vector3
    turn_rad: float
    speed_factor: float
    from_s: float | None
    to_s: float | None
    longest_gap_s: float
    fastest_jump_mps: float
    motion: RecordedMotion
    shift_in_base_m: Vector3 = (0.0, 0.0, 0.0)
    delay_s: float = 0.0
    max_speed_mps: float | None = None


@dataclass(frozen=True, kw_only=True)
class JoinedHand:
    """A hand that holds the same part as another, earlier one: it stays ``apart_in_base_m`` from it."""

    name: str
    joined_to: str  # the name of the hand that leads
    apart_in_base_m: Vector3
    elbow_towards_in_base_m: Vector3


HandTrajectory = MovingHand | RecordedHand | JoinedHand


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A sentence of the catalogue and the verdict that the author expects of it."""

    sentence: str
    expected: Verdict
    place: Place = field(default_factory=Place, compare=False)


@dataclass(frozen=True, kw_only=True, repr=False)
class Scenario:
    """One thing to try: the hands, the TCP start, the avoider, the settings and the claims."""

    name: str
    title: str
    about: str
    duration_s: float
    seed: int
    start: TcpStart
    hands: tuple[HandTrajectory, ...]
    avoider: str
    claims: tuple[Claim, ...]
    settings: Settings = DEFAULTS
    robot: Robot = Robot.UR10
    faults: tuple[Fault, ...] = ()
    file: Path | None = field(default=None, compare=False)
    places: Mapping[str, Place] = field(default_factory=dict, compare=False)

    def __repr__(self) -> str:
        """Name and title only, where values of tests are printed; ``write_scenario`` gives all of it."""
        return f"<scenario {self.name}: {self.title}>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))

    def place(self, *names: str) -> Place:
        """Where the first of the fields that the file has stands in it, for an error found after reading.

        A file that has none of them, and keeps the defaults, is named without a line.
        """
        written = next((name for name in names if name in self.places), names[0])
        return self.places.get(written, Place(file=self.file, field=written))

    def leader(self, hand: HandTrajectory) -> MovingHand | RecordedHand | None:
        """Who moves ``hand``: itself, or the hand before it that it is joined to (None: there is none)."""
        if not isinstance(hand, JoinedHand):
            return hand
        before = self.hands[: self.hands.index(hand)]
        return next((o for o in before if o.name == hand.joined_to and not isinstance(o, JoinedHand)), None)

    @property
    def ticks(self) -> int:
        """How many control ticks the scenario lasts: the least number that covers the duration."""
        return int(np.ceil(self.duration_s / self.settings.clock.control_period_s - 1e-9))
