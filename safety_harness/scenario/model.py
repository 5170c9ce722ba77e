"""A scenario as frozen data: one test case, independent of all packages that run it.

The scenario refers to claims and avoiders only by the user's words, and ``admission`` resolves these words.
All values are in SI; ``read`` converts the units of a file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from math import ceil
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError, Place, ScenarioError, no_truth_value
from safety_harness.base.settings import DEFAULTS, HAND_SLOTS, Settings, Vector3
from safety_harness.scenario.codec import (
    POINT,
    ROTATION,
    TURN,
    Below,
    Key,
    QuantityValue,
    Several,
    Text,
    declared,
    key,
    keyed,
    table_of,
)
from safety_harness.scenario.faults import Fault
from safety_harness.scenario.gate import GateRule
from safety_harness.scenario.moves import LONGEST_S, MOVE, REACHING_MPS, SPEEDS, TREMOR, HandMove, Tremor
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.scenario.robots import DIGEST, AnyRobot, OwnRobot, Robot
from safety_harness.scenario.shield import Shield
from safety_harness.scenario.units import ACCELERATION, NUMBER, SPEED, TIME

MAX_HANDS = HAND_SLOTS[-1]
LARGEST_SEED = 2**63 - 1  # the largest signed integer of 64 bits
FEWEST_JOINTS, MOST_JOINTS = 3, 8  # of an arm; a choice
DEFAULT_AVOIDER = "mc-dropout"
VISUAL_SERVO = "visual servo"  # the only controller that asks an avoider
NO_AVOIDER = ""
LARGEST_FACTOR = 10.0  # by which a recording may be sped up; a choice
LONGEST_GAP_S = 10.0  # in a recording, which straight motion bridges; a choice
FASTEST_JUMP_MPS = 1000.0  # of noise between two samples that follow each other quickly
# An assumption.  A reach of 0.66 m with the minimum-jerk profile of Flash and Hogan (1985) that peaks
# at v = 2.0 m/s (REACHING_MPS) has at most 1.642 v^2/d = 10 m/s^2, for the distance d.
REACHING_MPS2 = 10.0
ACCELERATIONS_MPS2 = (0.1, 100.0)  # a value outside is a slip of the unit


class Driver(str):
    """A reference to a controller that replaces the visual servo.

    A reference of the type Driver may be used wherever a reference to an avoider is allowed. The system under
    test is either the avoider of the visual servo, or the controller that drives the arm.
    """

    __slots__ = ()


BY_AT_MOST = " by at most "


class Verdict(Enum):
    """The result of a property on a trace: holds, violated or inconclusive.

    A verdict has no truth value: ``if verdict`` raises InputError.
    """

    HOLDS = "holds"
    VIOLATED = "violated"
    INCONCLUSIVE = "inconclusive"

    def __bool__(self) -> bool:
        raise no_truth_value(f"whether the verdict {self.value} is true")


_TILTED = "tilt: [0 deg, 3 deg, 0 deg]"
_TILT = Key(
    "tilt",
    ROTATION,
    "of the tool, from looking straight down, in the desired TCP's own frame",
    f"tcp start: {{offset: [0 mm, 0 mm, 0 mm], {_TILTED}}}",
    "none",
)
_JOINTS = Several(
    of=TURN,
    kind="list of angles",
    expected="a list of as many joint angles as the arm has joints, 3 to 8, such as -90 deg",
    least=FEWEST_JOINTS,
    most=MOST_JOINTS,
)


@declared
class OffsetStart:
    """A TCP start relative to the desired pose.

    ``offset_in_base_m`` shifts the desired TCP position. ``tilt_in_tcp_rad`` is a rotation vector in the
    desired TCP frame. If the vector is zero, the camera looks straight down.
    """

    offset_in_base_m: Vector3 = key(
        "offset",
        POINT,
        "from the desired TCP, along the axes of the base",
        "tcp start: {offset: [40 mm, -120 mm, 60 mm]}",
    )
    tilt_in_tcp_rad: Vector3 = keyed(_TILT, default=(0.0, 0.0, 0.0))


@declared
class JointStart:
    """A TCP start given by the arm's joint angles, beginning at the base."""

    joint_position_rad: tuple[float, ...] = key(
        "joints",
        _JOINTS,
        "from the base on, of a UR pan, lift, elbow, wrist 1, 2, 3; in place of `offset` and `tilt`",
        "tcp start: {joints: [-12 deg, -73 deg, 113 deg, -130 deg, -90 deg, -103 deg]}",
    )


@declared
class PoseStart:
    """A TCP start given by its position in the base frame.

    ``tilt_in_tcp_rad`` has the same meaning as in OffsetStart.
    """

    position_in_base_m: Vector3 = key(
        "position",
        POINT,
        "of the TCP in the base frame, in place of `offset`",
        "tcp start: {position: [680 mm, 60 mm, 410 mm]}",
    )
    tilt_in_tcp_rad: Vector3 = keyed(_TILT, default=(0.0, 0.0, 0.0))


TcpStart = OffsetStart | PoseStart | JointStart


START = Below(tables=tuple(table_of(kind, "tcp start") for kind in get_args(TcpStart)))

_HAND_NAME = Text(kind="name", expected="a name for the hand")
_STARTS_AT, _TOWARDS = "[1.2 m, -0.7 m, 100 mm]", "[1.6 m, -1.2 m, 300 mm]"
_SHIFT, _LATER = "[0 mm, 50 mm, 0 mm]", "500 ms"
_FASTER = "2.5 m/s"
_ELBOW = Key("elbow towards", POINT, "where the forearm points, at every moment", _TOWARDS)
_DELAY = QuantityValue(TIME, least=0.0, most=LONGEST_S)
_ACCELERATION = QuantityValue(ACCELERATION, least=ACCELERATIONS_MPS2[0], most=ACCELERATIONS_MPS2[1])


@declared
class MovingHand:
    """A hand that makes one move after another, and then rests.

    At every moment the forearm points from the hand's centre to ``elbow_towards_in_base_m``, where the person
    stands. ``shift_in_base_m`` is added to the start and to every point of the moves. The first move begins
    after ``delay_s``. The speed of the hand, with its tremor, never exceeds ``max_speed_mps``. The
    acceleration of the hand's moves never exceeds ``max_acceleration_mps2``; the tremor's acceleration comes
    in addition.
    """

    name: str = key(
        "hand", _HAND_NAME, "for messages and reports; another one for each hand", "- hand: right"
    )
    starts_at_in_base_m: Vector3 = key(
        "starts at", POINT, "the hand's centre at time 0, where it is at rest", _STARTS_AT
    )
    elbow_towards_in_base_m: Vector3 = keyed(_ELBOW)
    shift_in_base_m: Vector3 = key(
        "shifted by",
        POINT,
        "added to `starts at` and to every point of the moves",
        _SHIFT,
        default=(0.0, 0.0, 0.0),
    )
    delay_s: float = key("delayed by", _DELAY, "how long it waits before its first move", _LATER, default=0.0)
    max_speed_mps: float = key(
        "speed at most",
        SPEEDS,
        "no move may say more than this, less the tremor's own speed",
        _FASTER,
        default=REACHING_MPS,
    )
    max_acceleration_mps2: float = key(
        "acceleration at most",
        _ACCELERATION,
        "how hard the hand speeds up, turns and brakes",
        "20 m/s2",
        default=REACHING_MPS2,
    )
    tremor: Tremor | None = key(
        "tremor",
        Below(tables=(TREMOR,)),
        "a small motion on top, at rest too",
        TREMOR.keys[0].example,
        default=None,
    )
    moves: tuple[HandMove, ...] = key(
        "moves",
        Several(of=MOVE, kind="list", expected="a list of moves"),
        "what it does; an empty list for a hand that rests",
        "moves:\n  - wait: 1 s\n  - withdraw: 1.6 m/s",
    )

    @property
    def max_move_speed_mps(self) -> float:
        """The largest speed of the moves: the hand's bound minus the tremor's largest speed."""
        return self.max_speed_mps - (self.tremor.max_speed_mps if self.tremor else 0.0)


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """The samples of a recorded hand's motion in the robot's base frame.

    The positions and times are those of the run. ``time_s`` (n,) begins at 0 and rises strictly.
    ``hand_position_in_base_m`` and ``elbow_position_in_base_m`` are finite, each of shape (n, 3). Between
    samples the motion is straight. ``notes`` describes the gaps and jumps that are bridged by straight
    motion, and states their sizes.
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

    def __eq__(self, value: object) -> bool:
        if not isinstance(value, RecordedMotion):
            return NotImplemented
        return all(map(np.array_equal, vars(self).values(), vars(value).values()))

    def __hash__(self) -> int:
        return hash(self.sha256)


_NOTHING: NDArray[np.float64] = np.zeros((0, 3))
NOT_LOADED = RecordedMotion(_NOTHING[:, 0], _NOTHING, _NOTHING, (), "")  # of a hand until its file is read


_PATH = Text(kind="path", reads=lambda field: Path(field.sentence("the path of a recording")))
_DIGEST = replace(DIGEST, writes=lambda motion: f'"{motion.sha256}"')
# A track's name as in the columns: ``right hand`` becomes ``right_hand``.
_TRACK = Text(kind="name", reads=lambda field: field.sentence("the name of a track").replace(" ", "_"))


_FACTOR = QuantityValue(NUMBER, least=0.01, most=LARGEST_FACTOR)
_RECORDED_TIME = QuantityValue(TIME)
_GAP = QuantityValue(TIME, above=0.0, most=LONGEST_GAP_S)
_JUMP = QuantityValue(SPEED, above=0.0, most=FASTEST_JUMP_MPS)


@declared
class RecordedHand:
    """A hand that repeats a recording.

    The recording is turned by ``turn_rad`` about the vertical axis. The first used sample is moved to
    ``starts_at_in_base_m`` + ``shift_in_base_m``. The hand's motion begins after ``delay_s``. Its speed is
    ``speed_factor`` times the speed in the recording. Only the part from ``from_s`` to ``to_s`` on the
    recording's clock is used. None stands for the beginning or the end of the recording.

    Without a recorded elbow, the forearm points to the point ``elbow_towards_in_base_m``. If
    ``max_speed_mps`` is None, the bound is the highest speed in the recording, or REACHING_MPS if the
    recording is sped up.
    """

    recording: Path = key(
        "recording",
        _PATH,
        "of the CSV file, relative to the scenario file",
        "- recording: recordings/robothumanhandover-0.csv",
    )
    motion: RecordedMotion = key(
        "sha256", _DIGEST, "refuse a file with other contents", f"sha256: {'0123456789abcdef' * 4}", "none"
    )
    name: str = key("hand", _HAND_NAME, "for messages and reports", "right", "the track")
    track: str = key(
        "track", _TRACK, "`right hand` means the columns `right_hand_x_m` and so on", "right hand"
    )
    elbow_track: str | None = key(
        "elbow track",
        _TRACK,
        "the person's elbow",
        "right elbow",
        "the same side's elbow, if it was recorded",
        default=None,
    )
    elbow_towards_in_base_m: Vector3 | None = keyed(
        replace(_ELBOW, meaning=f"in place of an elbow track: {_ELBOW.meaning}", or_else="none"), default=None
    )
    starts_at_in_base_m: Vector3 = key(
        "starts at", POINT, "where the first sample that is used is put", _STARTS_AT
    )
    turn_rad: float = key(
        "turned", TURN, "about the vertical through that first sample", "20 deg", default=0.0
    )
    shift_in_base_m: Vector3 = key(
        "shifted by", POINT, "added to `starts at`", _SHIFT, default=(0.0, 0.0, 0.0)
    )
    delay_s: float = key(
        "delayed by", _DELAY, "how long the hand rests at its first sample", _LATER, default=0.0
    )
    speed_factor: float = key(
        "speed factor", _FACTOR, "how many times as fast as it was recorded", "1.5", "1.0", default=1.0
    )
    max_speed_mps: float | None = key(
        "speed at most",
        SPEEDS,
        "a recording that is faster, as it is used, is refused",
        _FASTER,
        "as recorded; 2 m/s with a `speed factor` above 1",
        default=None,
    )
    from_s: float | None = key(
        "from",
        _RECORDED_TIME,
        "where the part that is used begins, in the recording's own time",
        "1.5 s",
        "its beginning",
        default=None,
    )
    to_s: float | None = key(
        "to", _RECORDED_TIME, "where the part that is used ends", "13 s", "its end", default=None
    )
    longest_gap_s: float = key(
        "longest gap", _GAP, "how long the track may be missing", "300 ms", default=0.2
    )
    fastest_jump_mps: float = key(
        "fastest jump", _JUMP, "what is faster is another marker, not this one", "4 m/s", default=5.0
    )


@declared
class JoinedHand:
    """A hand that moves with an earlier hand, always at the offset ``apart_in_base_m`` from that hand."""

    name: str = key("hand", _HAND_NAME, "for messages and reports", "- hand: left")
    joined_to: str = key(
        "together with", Text(kind="name", expected="the name of a hand"), "of the hand that leads", "right"
    )
    apart_in_base_m: Vector3 = key(
        "apart", POINT, "from that hand's centre to this one's", "[0 mm, 300 mm, 0 mm]"
    )
    elbow_towards_in_base_m: Vector3 = keyed(_ELBOW)


HandTrajectory = MovingHand | RecordedHand | JoinedHand
MOVING_HAND = table_of(MovingHand, "a hand that moves", path="hands")
JOINED_HAND = table_of(JoinedHand, "a hand that goes with another", path="hands", told_by="together with")
RECORDED_HAND = table_of(RecordedHand, "a hand that repeats a recording", path="hands")
HAND = Below(tables=(MOVING_HAND, JOINED_HAND, RECORDED_HAND))
HANDS = Several(of=HAND, kind="list of at most eight", most=MAX_HANDS)


# The edition of the sentences' meanings.  In 1, people come at 1.6 m/s if a sentence names no speed.  In 1
# and 2 the arm stops from the TCP's speed, however fast its other points are, and a condition that holds from
# the start exercises "eventually".
EDITION = 3


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A sentence of the catalogue and the verdict that the author expects of it.

    Args:
        sentence: The sentence.
        expected: The expected verdict.
        most: The bound of an expected violation, with its SI unit: the margin must be at least the negative
            of this bound. None: no bound.
        edition: The edition of the catalogue that defines the sentence; an old trace or ledger states its
            own.
        place: The place of the claim in its file.

    """

    sentence: str
    expected: Verdict
    most: tuple[float, str] | None = None
    edition: int = EDITION
    place: Place = field(default_factory=Place, compare=False)

    def given(self, margin: float | None) -> Verdict:
        """Return the verdict that this claim expects of a run with the margin ``margin``.

        The result is HOLDS if the violation exceeds the claim's bound, and otherwise the expected verdict.
        ``margin`` is None for a run that has no margin.
        """
        is_beyond = self.most is not None and (margin is None or not -margin <= self.most[0])
        return Verdict.HOLDS if is_beyond else self.expected

    def is_loosely(self, verdict: Verdict) -> bool:
        """Return whether ``verdict`` is a violation that the author expects without a bound."""
        return verdict is Verdict.VIOLATED is self.expected and self.most is None

    @property
    def expectation(self) -> str:
        """The expected verdict with its bound, in the form that a file contains."""
        bound = "" if self.most is None else f"{BY_AT_MOST}{self.most[0]!r} {self.most[1]}".rstrip()
        return f"{self.expected.value}{bound}"


@dataclass(frozen=True, kw_only=True, repr=False)
class Scenario:
    """A test case: the hands, the TCP start, the system under test, the settings and the claims.

    Args:
        name: The name, unique among the scenarios of a command.
        title: The title, which is one line of text.
        about: A description for people, which may be empty.
        duration_s: The length of a run.
        seed: The seed from which all random numbers of a run derive.
        start: The TCP start.
        hands: At most MAX_HANDS hands.
        avoider: The reference to the avoider, or NO_AVOIDER if ``controller`` is not VISUAL_SERVO.
        claims: The claims with their expected verdicts.
        settings: The settings of the system and its cell.
        robot: The arm.
        faults: The faults of sensors, joints and avoider.
        obstacles: The boxes in the cell.
        controller: The reference to the controller that drives the arm.
        shield: The shield between the controller and the drives. None means that there is no shield.
        safety_filter: The reference to the user's filter between the controller and the drives. An empty text
            means that there is no filter.
        predictor: The reference to the predictor of the hands; An empty text means the Kalman filter, without
            predicted sets.
        gate: The requirements that are added to the gate's own checks. None means that there are no further
            requirements.
        extensions: Keys that packages add, each with its value.
        file: The file that contains the scenario. None means that the scenario comes from a text.
        places: The place of each field in the file.

    """

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
    robot: AnyRobot = Robot.UR10
    faults: tuple[Fault, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    controller: str = VISUAL_SERVO
    shield: Shield | None = None
    safety_filter: str = ""
    predictor: str = ""
    gate: GateRule | None = None
    extensions: tuple[tuple[str, Any], ...] = ()  # keys that packages add, each with its value
    file: Path | None = field(default=None, compare=False)
    places: Mapping[str, Place] = field(default_factory=dict, compare=False)

    def __repr__(self) -> str:
        """Return only the name and the title, because tests print this text.

        ``write_scenario`` returns the whole scenario.
        """
        return f"<scenario {self.name}: {self.title}>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))

    def place(self, *names: str) -> Place:
        """Return the place of the first field in ``names`` that the file contains.

        An error that is found after the file was read states this place. If the file contains no such field,
        the place has no line number.

        Args:
            *names: Paths of fields, such as ``hands[0].starts at``.

        """
        written = next((name for name in names if name in self.places), names[0])
        return self.places.get(written, Place(file=self.file, field=written))

    def inadmissible(self, expected: str, got: str, *names: str, hint: str = "") -> InadmissibleError:
        """Return an error that concerns fields of this scenario.

        Args:
            expected: Completes "expected ...".
            got: Completes "got ...".
            *names: Paths of the fields; the error states the first of them that the file contains.
            hint: One more line of help.

        """
        return InadmissibleError(place=self.place(*names), expected=expected, got=got, hint=hint)

    def with_files(self, name: Callable[[str], str]) -> Scenario:
        """Return this scenario after renaming the files of its recordings and of the user's own arm.

        Args:
            name: The function that returns the new name of a file.

        """
        hands = (
            replace(h, recording=Path(name(str(h.recording)))) if isinstance(h, RecordedHand) else h
            for h in self.hands
        )
        robot = self.robot.named(name) if isinstance(self.robot, OwnRobot) else self.robot
        return replace(self, hands=tuple(hands), robot=robot)

    def leader(self, hand: HandTrajectory) -> MovingHand | RecordedHand | None:
        """Return the hand that determines the motion of ``hand``.

        This leading hand is ``hand`` itself, or the earlier hand to which ``hand`` is joined. The result is
        None if ``hand`` is joined to another hand and no earlier hand has that hand's name.
        """
        if not isinstance(hand, JoinedHand):
            return hand
        past = self.hands[: self.hands.index(hand)]
        return next((o for o in past if o.name == hand.joined_to and not isinstance(o, JoinedHand)), None)

    @property
    def driven(self) -> bool:
        """Whether a controller other than the visual servo drives the arm.

        In this case, the run has no avoider and no gate.
        """
        return self.controller != VISUAL_SERVO

    @property
    def under_test(self) -> str:
        """The reference to the system under test: the avoider of the visual servo, or a ``Driver``."""
        return Driver(self.controller) if self.driven else self.avoider

    @property
    def parts_under_test(self) -> tuple[str, ...]:
        """The references to the system under test, its safety filter and its predictor.

        A safety filter or predictor that does not exist is left out.
        """
        return (self.under_test, *filter(None, (self.safety_filter, self.predictor)))

    @property
    def has_parts_beside(self) -> bool:
        """Whether a run calls a safety filter or a predictor at each tick.

        Such a run cannot be part of a batch.
        """
        return bool(self.safety_filter or self.predictor)

    @property
    def hand_slots(self) -> int:
        """The number of hands for which a tick of the run has room.

        It is the smallest available number that is sufficient. Raise ScenarioError if there are too many
        hands.
        """
        for slots in HAND_SLOTS:
            if len(self.hands) <= slots:
                return slots
        expected = f"at most {MAX_HANDS} hands"
        raise ScenarioError(place=self.place("hands"), expected=expected, got=f"{len(self.hands)}")

    @property
    def ticks(self) -> int:
        """The smallest number of control ticks that covers the duration."""
        return ceil(self.duration_s / self.settings.clock.control_period_s - 1e-9)
