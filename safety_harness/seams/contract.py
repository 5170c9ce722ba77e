"""The contract of a user's controller: what it sees, what it may do and what it may report.

A controller's attribute ``sees`` lists words of ``SIGHTS``. The harness provides only the fields of these
words. The fields contain sensor data that have already arrived, with noise, delay and missed detections. The
controller cannot see the true values in the simulator. All quantities are SI. ``_in_base_`` in a name refers
to the robot's base frame. A twist (v, w) is the velocity of the TCP, expressed in the base frame.
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
    """A word of ``SIGHTS`` or ``REPORTS``.

    ``fields`` lists the fields that belong to the word.
    """

    word: str
    fields: tuple[str, ...]
    meaning: str


JOINTS, HANDS, HAND_BOXES = "joints", "hands", "hand boxes"
OBJECT, IMAGE, PREDICTED_HANDS = "object", "image", "predicted hands"
WANTED = "wanted command"  # only of a safety filter
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
FILTER_SIGHTS = (
    *SIGHTS,
    SightWord(WANTED, ("wanted_command",), "the command that the controller wants at this tick"),
)

MODE, DECISIONS, DOUBT = "mode", "decisions", "doubt"
REPORTS = (
    SightWord(MODE, ("mode",), "what it is doing, at every tick"),
    SightWord(DECISIONS, ("decision",), "every decision to give way, at its tick"),
    SightWord(DOUBT, ("spread_m", "spread_threshold_m"), "how sure it was of each, by its predictive spread"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenHand:
    """A hand as measured by the sensor.

    ``position_in_base_m`` (3,) is the centre of a sphere whose radius is the hand radius that the filter
    assumes. The position is computed with the sensor's pose at the time when the frame arrived.
    """

    position_in_base_m: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class HandBoxes:
    """The last frame of the hand sensor, as bounding boxes in the sensor's image.

    ``time_s`` is the time of exposure, or NaN before the first frame. ``new`` is true if the frame arrived at
    this tick. Each row of ``boxes`` (n, 5) contains the box centre u, v [px], the depth of the surface there
    [m], the area [px^2], and the width divided by the height. ``transform_sensor_to_base`` (4, 4) is the
    sensor's present pose.
    """

    time_s: float
    new: bool
    boxes: Floats
    transform_sensor_to_base: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class PredictedHand:
    """A tracked hand, predicted for the time of this tick plus the prediction horizon of the settings.

    The Kalman filter computes ``position_in_base_m`` (3,), ``velocity_in_base_mps`` (3,) and their joint
    ``covariance`` (6, 6), using the sensor's present pose. ``number`` does not change while the filter tracks
    the same hand.
    """

    position_in_base_m: Floats
    velocity_in_base_mps: Floats
    covariance: Floats
    number: int
    last_seen_s: float


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenObject:
    """The object as seen in the last image of its camera.

    ``new`` is true if the image arrived at this tick. ``features`` (6,) are x_n, y_n, a_n [m], gamma, delta
    [-], alpha [rad] (eqs. 3 to 5). ``feature_error`` (6,) is f - f*, the difference from the desired
    features. If the object is not ``visible``, these two arrays are NaN.
    """

    visible: bool
    new: bool
    features: Floats
    feature_error: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class Image:
    """The last image of the object's camera.

    ``new`` is true if the image arrived at this tick. ``pixels`` (height, width, 3) are uint8 in the order
    red, green, blue, and are black before the first image. ``time_s`` is the time of exposure, or NaN before
    the first image.
    """

    time_s: float
    new: bool
    pixels: NDArray[np.uint8]


@dataclass(frozen=True, eq=False, kw_only=True)
class WantedCommand:
    """The command that the controller wants at this tick, already limited by the harness.

    ``joint_velocity_radps`` (n,) are the joints' speeds. If ``stop`` is true, the controller wants a
    protective stop.
    """

    joint_velocity_radps: Floats
    stop: bool

    @property
    def action(self) -> Action:
        """The action that leaves this command unchanged."""
        return Stop() if self.stop else Move(joint_velocity_radps=self.joint_velocity_radps)


class UnseenError(ControllerError, AttributeError):
    """A controller read a field that its ``sees`` does not list."""


@dataclass(frozen=True, eq=False, init=False)
class Seen:
    """A controller's view at a tick: the time, the period and the fields listed in ``sees``, all read-only.

    Access to any other field raises UnseenError, which states the word that ``sees`` lacks. The word "joints"
    provides ``joint_position_rad`` (n,), ``joint_velocity_radps`` (n,), ``transform_tcp_to_base`` (4, 4) and
    ``tcp_position_in_base_m`` (3,).
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
    wanted_command: WantedCommand

    def __init__(self, *, time_s: float, period_s: float, **seen: Any) -> None:
        self.__dict__.update(seen, time_s=time_s, period_s=period_s)

    @classmethod
    def of_row(
        cls, time_s: float, period_s: float, makers: Mapping[str, Callable[[Floats], Any]], row: Floats
    ) -> Seen:
        """Return the view at a tick.

        A field is computed from ``row`` when the controller first reads it.

        Args:
            time_s: The time of the tick [s].
            period_s: The control period [s].
            makers: The function for each visible field that computes the field from ``row``.
            row: The first k numbers (k,) of a record of ``rows.seen_dtype``, up to the last number that a
                visible field needs.

        """
        seen = object.__new__(cls)
        seen.__dict__.update(time_s=time_s, period_s=period_s, _makers=makers, _row=row)
        return seen

    def __getattr__(self, name: str) -> Any:
        own = self.__dict__
        maker = own["_makers"].get(name) if "_makers" in own else None
        if maker is not None:
            value = own[name] = maker(own["_row"])
            return value
        for sight in FILTER_SIGHTS:
            if name in sight.fields:
                raise UnseenError(f'{name} is not seen: "{sight.word}" is not among this controller\'s sees')
        hint = near_miss(name, [known.name for known in fields(self)])
        raise AttributeError(f"a controller never sees {name!r}" + (f": {hint}" if hint else ""))


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """A controller's decision to move away from a hand.

    Claims about decisions judge these data. The three positions (3,) [m] are in the base frame. The positions
    are of the hand that the arm avoids, of the proposed TCP, and of the chosen TCP. If the decision is a
    stop, the chosen position is NaN. ``spread_m`` (3,) is the standard deviation along each axis.
    ``spread_threshold_m`` is the largest spread at which the controller still uses a proposal, or NaN if it
    has no threshold.
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
    """A controller's report about itself at a tick.

    If a field is missing, claims about the field are inconclusive.
    """

    mode: Mode | None = None
    decision: Decision | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Move:
    """The action to move with the given velocities until the next tick.

    If no velocity is given, the arm holds still. ``tcp_velocity_mps`` (3,) and ``tcp_angular_velocity_radps``
    (3,) are in the base frame, and either of them is zero if it is missing. The harness does not change the
    direction of the twist. The harness limits the twist by the TCP's speed and acceleration limits in the
    settings, and by the joints' speed limits. Near a singularity, the harness stops the arm. If
    ``joint_velocity_radps`` (n,) is given and a joint exceeds its limit, the harness slows all joints by the
    same factor. The trace records which limit was active.
    """

    tcp_velocity_mps: Floats | None = None
    tcp_angular_velocity_radps: Floats | None = None
    joint_velocity_radps: Floats | None = None
    report: Report | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Stop:
    """The action of a protective stop, in which the brakes act until the controller moves the arm again."""

    report: Report | None = None


Action = Move | Stop


@dataclass(frozen=True, eq=False, kw_only=True)
class HandSet:
    """A predicted hand, with a set that should contain its centre at the end of the prediction horizon.

    ``position_in_base_m`` p (3,) is the expected centre. ``number`` is at least 1, and does not change while
    the predictor refers to the same hand. Exactly one of the remaining fields describes the set: a ball of
    ``radius_m`` around p, a box around p with ``half_widths_m`` (3,) along the base's axes, or an ellipsoid.
    The ellipsoid contains all h with (h - p)' S^-1 (h - p) <= 1, where ``ellipsoid_m2`` S (3, 3) is symmetric
    and positive definite.
    """

    position_in_base_m: Floats
    number: int
    radius_m: float | None = None
    half_widths_m: Floats | None = None
    ellipsoid_m2: Floats | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Predicted:
    """The answer of a predictor at a tick, with one set for each hand that it expects.

    Without hands, ``hands`` is empty.
    """

    hands: tuple[HandSet, ...] = ()


Answer = Action | Predicted


@dataclass(frozen=True, eq=False, kw_only=True)
class Moves:
    """The result of ``act_many``: a ``Move`` or ``Stop`` for each of n episodes.

    ``tcp_velocity_mps`` (n, 3), ``tcp_angular_velocity_radps`` (n, 3) and ``joint_velocity_radps`` (n, j)
    have the same meaning as in ``Move``. ``stop`` (n,) is true for an episode in which the arm stops.
    ``mode`` (n,) contains the ``Mode`` of each episode, or is None if the controller does not report its
    mode.
    """

    tcp_velocity_mps: Floats | None = None
    tcp_angular_velocity_radps: Floats | None = None
    joint_velocity_radps: Floats | None = None
    stop: NDArray[np.bool_] | None = None
    mode: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class DrivenArm:
    """The arm that the controller drives.

    The arm has n revolute joints, and the arrays are read-only. ``position_lower_rad``,
    ``position_upper_rad`` and ``velocity_limit_radps`` have shape (n,). ``joint_origins`` (n, 4, 4) map the
    frame of link i + 1 at q = 0 to the frame of link i. ``joint_axes`` (n, 3) are in the frame of the link
    that the joint moves. ``flange`` (4, 4) maps the TCP frame to the last link's frame.
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
    """The arm's pose at the start: ``joint_position_rad`` (n,) and ``transform_tcp_to_base`` (4, 4)."""

    joint_position_rad: Floats
    transform_tcp_to_base: Floats


@runtime_checkable
class UserController(Protocol):
    """The methods and attributes of a user's own controller.

    An optional attribute ``reports`` lists words of ``REPORTS``, whose fields the controller fills in the
    ``report`` of its actions. If the controller raises an exception or does not return an action, the episode
    fails and states this reason.

    An optional attribute ``acts_per_answer`` is the number of calls of ``act`` for which one answer lasts,
    for example if a policy answers in chunks. If the scenario states a decision time, only the first of these
    calls takes that time, and the later calls get the same view as the first.

    The class may also have a function ``act_many(controllers, seen)``, with which many episodes run side by
    side in lanes. This function returns the ``Moves`` of n episodes at once, which must equal the results of
    ``act`` bit for bit. ``seen`` contains the arrays of ``arrays.observed`` for the words in ``sees``, each
    with n rows, and also ``time_s`` (n,) and ``period_s``.
    """

    @property
    def name(self) -> str:
        """The name of the controller in reports."""
        ...

    @property
    def sees(self) -> tuple[str, ...]:
        """The quantities that the controller needs, as words of ``SIGHTS``."""
        ...

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode, and forget the previous episode.

        Args:
            settings: The settings of the run.
            arm: The arm that the controller drives.
            start: The arm's position at the start of the episode.
            seed: The seed for all random draws of the controller.

        """
        ...

    def act(self, seen: Seen) -> Answer:
        """Return the action until the next tick, or, if the object is a predictor, the predicted hands.

        Args:
            seen: The view at this tick, with the fields that ``sees`` lists.

        """
        ...


@dataclass(frozen=True, kw_only=True)
class ControllerOpener:
    """A package's function that opens a controller for ``controller: NAME:REST``.

    NAME is the name of the package's entry point.

    Args:
        open: A function that returns a new controller for a complete reference. The controller may run in
            this process or be connected to another process. If it raises an exception, the scenario is
            refused.
        sha256: A function that returns the hash of the code behind the reference, for traces and evidence.
            None means that no hash is recorded.

    """

    open: Callable[[str], UserController]
    sha256: Callable[[str], str] | None = None


def sees_of(controller: UserController, sights: tuple[SightWord, ...] = FILTER_SIGHTS) -> tuple[str, ...]:
    """Return the controller's ``sees`` in the order of ``sights``.

    Raise ControllerError if a word is unknown.
    """
    return _words_of(controller, "sees", getattr(controller, "sees", None), sights)


def reports_of(controller: UserController) -> tuple[str, ...]:
    """Return the controller's ``reports`` in the order of ``REPORTS``.

    Raise ControllerError if a word is unknown. Also raise this error if the controller declares
    ``decision_time_s``, because only the scenario may state the decision time.
    """
    if getattr(controller, "decision_time_s", None):
        raise ControllerError(
            "decision_time_s is not read: a scenario states the time of a controller, as settings: "
            "{avoidance: {decision time: 40 ms}}; a safety filter answers in its own tick"
        )
    reports = _words_of(controller, "reports", getattr(controller, "reports", ()), REPORTS)
    if DOUBT in reports and DECISIONS not in reports:
        raise ControllerError('reports: "doubt" needs "decisions", which they lack')
    return reports


def acts_per_answer_of(controller: UserController) -> int:
    """Return the controller's ``acts_per_answer``, or 1 if it has no such attribute.

    Raise ControllerError if the value is not a positive integer.
    """
    count = getattr(controller, "acts_per_answer", 1)
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise ControllerError(f"acts_per_answer must be a whole number of at least 1; got {count!r}")
    return count


def _words_of(controller: object, name: str, given: object, table: tuple[SightWord, ...]) -> tuple[str, ...]:
    """Return the words of ``table`` that ``given`` contains.

    Raise ControllerError if ``given`` contains any other word.
    """
    known = [entry.word for entry in table]
    if isinstance(given, str) or not isinstance(given, tuple | list | set | frozenset):
        raise ControllerError(f"{name} must be a tuple of: {', '.join(known)}; got {given!r}")
    for term in given:
        if term not in known:
            hint = near_miss(str(term), known)
            raise ControllerError(
                f"{name} must be words of: {', '.join(known)}; got {term!r}" + (f" ({hint})" if hint else "")
            )
    return tuple(term for term in known if term in given)
