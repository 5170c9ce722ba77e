"""A scenario as frozen data: what is tried, and nothing that needs the rest of the house.

Claims and avoiders are plain references here (the sentence as the user wrote it); ``admission``
resolves them.  Everything is in SI; the units that people write belong to ``read``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import Place
from safety_harness.scenario.faults import Fault
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


TcpStart = OffsetStart | JointStart


@dataclass(frozen=True, kw_only=True)
class MoveTo:
    """Straight to a point at constant speed."""

    position_in_base_m: Vector3
    speed_mps: float


@dataclass(frozen=True, kw_only=True)
class Wait:
    """Stay where the hand is."""

    duration_s: float


@dataclass(frozen=True, kw_only=True)
class ReachForTcp:
    """Head for the TCP, wherever it is just now, until ``until_distance_m`` from it.

    Ends after ``at_most_s`` if the TCP gives way for that long.
    """

    speed_mps: float
    until_distance_m: float
    at_most_s: float


@dataclass(frozen=True, kw_only=True)
class FollowTcp:
    """Keep heading for the TCP for ``duration_s``; never nearer to it than ``distance_m``."""

    speed_mps: float
    distance_m: float
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class Withdraw:
    """Straight back to where the hand started."""

    speed_mps: float


HandMove = MoveTo | Wait | ReachForTcp | FollowTcp | Withdraw


@dataclass(frozen=True, kw_only=True)
class MovingHand:
    """A hand that does one move after another, then rests.

    The forearm points from the hand's centre towards ``elbow_towards_in_base_m`` (where the
    person stands) at every moment.
    """

    name: str
    starts_at_in_base_m: Vector3
    elbow_towards_in_base_m: Vector3
    moves: tuple[HandMove, ...]


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

    The recording's first used sample is put at ``starts_at_in_base_m`` after a turn by
    ``turn_rad`` about the vertical; its time runs ``speed_factor`` times as fast.  Only the part
    from ``from_s`` to ``to_s`` on the recording's own clock is used (None: its beginning, its end).
    Without a recorded elbow the forearm points towards ``elbow_towards_in_base_m``.
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


HandTrajectory = MovingHand | RecordedHand


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A sentence of the catalogue and the verdict that the author expects of it."""

    sentence: str
    expected: Verdict
    place: Place = field(default_factory=Place, compare=False)


@dataclass(frozen=True, kw_only=True)
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
    places: dict[str, Place] = field(default_factory=dict, compare=False)

    def place(self, *names: str) -> Place:
        """Where the first of the fields that the file has stands in it, for an error found after reading.

        A file that has none of them, and keeps the defaults, is named without a line.
        """
        written = next((name for name in names if name in self.places), names[0])
        return self.places.get(written, Place(file=self.file, field=written))

    @property
    def ticks(self) -> int:
        """How many control ticks the scenario lasts: the least number that covers the duration."""
        return int(np.ceil(self.duration_s / self.settings.clock.control_period_s - 1e-9))
