"""The contract of a user's controller: what it may see, what it may do, what it may report.

A controller says which ``sees`` it has, words of ``SIGHTS``, and gets that and nothing else: what sensors
delivered by now, with their noise, delay and dropout, never the simulator's truth.  All is SI; ``_in_base_``
is the robot's base frame, v and w of a twist are the TCP's, both in the base frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError, near_miss
from safety_harness.base.settings import Settings
from safety_harness.trace.records import DecisionOutcome, Mode, Trigger

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SightWord:
    """A word of a vocabulary, the fields that it stands for, and what it means."""

    word: str
    fields: tuple[str, ...]
    meaning: str


JOINTS, HANDS, HAND_BOXES = "joints", "hands", "hand boxes"
OBJECT, IMAGE, PREDICTED_HANDS = "object", "image", "predicted hands"
SIGHTS = (
    SightWord(
        JOINTS,
        ("joint_position_rad", "joint_velocity_radps", "transform_tcp_to_base", "tcp_position_in_base_m"),
        "the encoders, and where the TCP is by them",
    ),
    SightWord(HANDS, ("hands",), "each hand of the last frame of the hand sensor, as measured, unfiltered"),
    SightWord(HAND_BOXES, ("hand_boxes",), "the same frame as boxes in the sensor's image"),
    SightWord(OBJECT, ("object",), "moments and features of the last image of the object, and their error"),
    SightWord(IMAGE, ("image",), "the pixels of that image"),
    SightWord(
        PREDICTED_HANDS,
        ("predicted_hands",),
        "tracked hands from the Kalman filter, predicted to now and the horizon, with covariance",
    ),
)

MODE, DECISIONS, DOUBT = "mode", "decisions", "doubt"
REPORTS = (
    SightWord(MODE, ("mode",), "what it is doing, at every tick"),
    SightWord(DECISIONS, ("decision",), "every decision to give way, at the tick at which it was made"),
    SightWord(DOUBT, ("spread_m", "spread_threshold_m"), "how sure it was of each, by its predictive spread"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenHand:
    """A hand as the sensor measured it: its centre, for a sphere of the radius that the filter assumes.

    ``position_in_base_m`` (3,), by the sensor's pose when the frame arrived.
    """

    position_in_base_m: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class HandBoxes:
    """The last frame of the hand sensor; ``time_s`` is when it was taken, NaN before the first.

    ``new``: it arrived at this tick.  ``boxes`` (n, 5): u, v of the centre [px], depth of the surface there
    [m], area [px^2], width over height.  ``transform_sensor_to_base`` (4, 4) is the sensor's pose now.
    """

    time_s: float
    new: bool
    boxes: Floats
    transform_sensor_to_base: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class PredictedHand:
    """A tracked hand, predicted to the time of this tick and the settings' prediction horizon.

    ``position_in_base_m`` (3,) and ``velocity_in_base_mps`` (3,), and the ``covariance`` (6, 6) of both, as
    the Kalman filter has them, by the sensor's pose of now.  ``number`` stays while the hand is tracked.
    """

    position_in_base_m: Floats
    velocity_in_base_mps: Floats
    covariance: Floats
    number: int
    last_seen_s: float


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenObject:
    """The object in the last image of it; ``new``: the image arrived at this tick.

    ``features`` (6,) x_n, y_n, a_n [m], gamma, delta [-], alpha [rad] (eqs. 3 to 5), ``feature_error`` (6,)
    f - f*; NaN where the object is not ``visible``.
    """

    visible: bool
    new: bool
    features: Floats
    feature_error: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class Image:
    """The last image of the object's camera; ``new``: it arrived at this tick.

    ``pixels`` (height, width, 3) uint8, red, green, blue, black before the first; ``time_s`` is when it was
    taken, NaN before the first.
    """

    time_s: float
    new: bool
    pixels: NDArray[np.uint8]


class UnseenError(ControllerError, AttributeError):
    """A controller touched what it did not say that it sees."""


@dataclass(frozen=True, eq=False, init=False)
class Seen:
    """What a controller sees at a tick: time and period, and what its ``sees`` name; all arrays read-only.

    Anything else is not there, and touching it is an UnseenError that says which word of ``sees`` is missing.
    ``joint_position_rad`` and ``joint_velocity_radps`` (n,), ``transform_tcp_to_base`` (4, 4) and
    ``tcp_position_in_base_m`` (3,) come with "joints".
    """

    time_s: float
    period_s: float
    joint_position_rad: Floats
    joint_velocity_radps: Floats
    transform_tcp_to_base: Floats
    tcp_position_in_base_m: Floats
    hands: tuple[SeenHand, ...]
    hand_boxes: HandBoxes
    object: SeenObject
    image: Image
    predicted_hands: tuple[PredictedHand, ...]

    def __init__(self, *, time_s: float, period_s: float, **seen: Any) -> None:
        self.__dict__.update(seen, time_s=time_s, period_s=period_s)

    @classmethod
    def of_row(
        cls, time_s: float, period_s: float, makers: Mapping[str, Callable[[Floats], Any]], row: Floats
    ) -> Seen:
        """As the harness makes it: each field of the numbers of a ``row`` (k,), when it is touched."""
        seen = object.__new__(cls)
        seen.__dict__.update(time_s=time_s, period_s=period_s, _makers=makers, _row=row)
        return seen

    def __getattr__(self, name: str) -> Any:
        own = self.__dict__
        maker = own["_makers"].get(name) if "_makers" in own else None
        if maker is not None:
            found = own[name] = maker(own["_row"])
            return found
        for sight in SIGHTS:
            if name in sight.fields:
                raise UnseenError(f'{name} is not seen: "{sight.word}" is not among this controller\'s sees')
        hint = near_miss(name, [one.name for one in fields(self)])
        raise AttributeError(f"nothing that is seen is called {name!r}" + (f": {hint}" if hint else ""))


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """A decision to give way to a hand, for claims about decisions.

    Positions (3,) of hand and TCP in the base frame: the hand given way to, the position proposed and the one
    chosen, NaN for a stop.  ``spread_m`` (3,) is one standard deviation an axis, ``spread_threshold_m`` the
    largest with which a proposal is used, NaN for none.
    """

    hand_position_in_base_m: Floats
    proposed_position_in_base_m: Floats
    chosen_position_in_base_m: Floats
    outcome: DecisionOutcome = DecisionOutcome.PROPOSED
    trigger: Trigger = Trigger.HAND_ENTERED
    spread_m: Floats = field(default_factory=lambda: np.full(3, np.nan))
    spread_threshold_m: float = np.nan


@dataclass(frozen=True, eq=False, kw_only=True)
class Report:
    """What a controller says of itself at a tick; claims on what it does not say are inconclusive."""

    mode: Mode | None = None
    decision: Decision | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Move:
    """Move so until the next tick: by the TCP, or by the joints; nothing given is to hold still.

    ``tcp_velocity_mps`` (3,) and ``tcp_angular_velocity_radps`` (3,) in the base frame, zero where only the
    other is given: bounded to the settings' TCP speed and acceleration and to the joints' speeds, the
    direction kept; near a singularity the arm stops.  ``joint_velocity_radps`` (n,): all slowed down alike
    where one is beyond its limit.  Which limit acted is in the trace.
    """

    tcp_velocity_mps: Floats | None = None
    tcp_angular_velocity_radps: Floats | None = None
    joint_velocity_radps: Floats | None = None
    report: Report | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Stop:
    """A protective stop: the brakes act, until the controller moves again."""

    report: Report | None = None


Action = Move | Stop


@dataclass(frozen=True, eq=False, kw_only=True)
class Moves:
    """What ``act_many`` returns: the ``Move`` or ``Stop`` of each of n episodes.

    ``tcp_velocity_mps`` (n, 3), ``tcp_angular_velocity_radps`` (n, 3) and ``joint_velocity_radps`` (n, j) as
    of ``Move``; ``stop`` (n,) is true of those that stop.  ``mode`` (n,) is each one's, if it is reported.
    """

    tcp_velocity_mps: Floats | None = None
    tcp_angular_velocity_radps: Floats | None = None
    joint_velocity_radps: Floats | None = None
    stop: NDArray[np.bool_] | None = None
    mode: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class DrivenArm:
    """The arm that is driven, n turning joints; arrays are read-only.

    ``position_lower_rad``, ``position_upper_rad`` and ``velocity_limit_radps`` (n,).  ``joint_origins``
    (n, 4, 4) frame of link i + 1 at q = 0 to the frame of link i, ``joint_axes`` (n, 3) in the frame of the
    link that is moved, ``flange`` (4, 4) from the TCP to the last link.
    """

    name: str
    joint_names: tuple[str, ...]
    position_lower_rad: Floats
    position_upper_rad: Floats
    velocity_limit_radps: Floats
    joint_origins: Floats
    joint_axes: Floats
    flange: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class Start:
    """Where an episode starts: ``joint_position_rad`` (n,), ``transform_tcp_to_base`` (4, 4)."""

    joint_position_rad: Floats
    transform_tcp_to_base: Floats


@runtime_checkable
class UserController(Protocol):
    """What a controller of a user's own has to offer.

    It may also have ``reports``, words of ``REPORTS``: what it says of itself in the ``report`` of each
    action.  What it raises, and an action that is none, cost the episode: it has failed, with that reason.

    Its class may have ``act_many(controllers, seen)``, which gives the ``Moves`` of so many episodes at once,
    the bits that ``act`` of each controller gives.  ``seen`` has the arrays of ``arrays.observed`` of what it
    ``sees``, n rows each, ``time_s`` (n,) and ``period_s``.  Many episodes then run in lanes, side by side.
    """

    @property
    def name(self) -> str:
        """How reports call it."""
        ...

    @property
    def sees(self) -> tuple[str, ...]:
        """Words of ``SIGHTS``."""
        ...

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode, with nothing left of the one before; ``seed`` is for whatever it draws."""
        ...

    def act(self, seen: Seen) -> Action:
        """What to do until the next tick."""
        ...


@dataclass(frozen=True, kw_only=True)
class ControllerOpener:
    """A way to a controller that a package adds: ``controller: NAME:REST``, with the name of its entry point.

    Args:
        open: Return a fresh controller for a whole reference, in this process or connected to another one.
            What it raises refuses the scenario.
        sha256: Return the hash of what the reference runs, for traces and evidence.  None: nothing is hashed.

    """

    open: Callable[[str], UserController]
    sha256: Callable[[str], str] | None = None


def sees_of(controller: UserController) -> tuple[str, ...]:
    """What it sees, in the order of ``SIGHTS``; ControllerError for a word that is none of them."""
    return _words(controller, "sees", getattr(controller, "sees", None), SIGHTS)


def reports_of(controller: UserController) -> tuple[str, ...]:
    """Return what it reports, in the order of ``REPORTS``.

    Raise ControllerError for a word that is none of them, or for a declared delay, which no run would have.
    """
    if getattr(controller, "decision_time_s", None):
        raise ControllerError(
            "decision_time_s of a controller is not simulated: every answer counts in its own tick; "
            "hold the answers back in act itself"
        )
    said = _words(controller, "reports", getattr(controller, "reports", ()), REPORTS)
    if DOUBT in said and DECISIONS not in said:
        raise ControllerError('reports: "doubt" is of decisions, and "decisions" are not among them')
    return said


def _words(controller: object, name: str, said: object, table: tuple[SightWord, ...]) -> tuple[str, ...]:
    """Of ``table``, those that are ``said``."""
    known = [one.word for one in table]
    if isinstance(said, str) or not isinstance(said, tuple | list | set | frozenset):
        raise ControllerError(f"{name} must be a tuple of: {', '.join(known)}; got {said!r}")
    for word in said:
        if word not in known:
            hint = near_miss(str(word), known)
            raise ControllerError(
                f"{name} must be words of: {', '.join(known)}; got {word!r}" + (f" ({hint})" if hint else "")
            )
    return tuple(word for word in known if word in said)
