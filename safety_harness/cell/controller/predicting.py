"""Run a predictor, which predicts the hands at the end of the horizon and a set for each hand.

The harness calls the predictor like a controller, before the visual servo at each tick. The predictor
replaces the Kalman filter of the servo. The gate's rule ``every hand in its set`` uses the predictor's sets.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import power
from safety_harness.base.exceptions import ControllerError, described, printable
from safety_harness.base.settings import Settings
from safety_harness.base.special import normal_quantile
from safety_harness.cell.controller.answers import numbers
from safety_harness.cell.controller.driven import DrivenController
from safety_harness.cell.controller.records import ObservationRecords, StateRecords, TrackRecords
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.seams.contract import (
    PREDICTED_HANDS,
    DrivenArm,
    HandSet,
    Predicted,
    Seen,
    Start,
    UserController,
)
from safety_harness.trace.consistency import are_positive_definite
from safety_harness.trace.records import predicted_dtype

Floats = NDArray[np.float64]
KALMAN_FILTER = "kalman filter"
SETS = ("radius_m", "half_widths_m", "ellipsoid_m2")  # of a HandSet
CONFIDENCE = 0.95  # of the sets of the Kalman filter


class PredictorCalls(DrivenController):
    """A predictor in an episode that lasts ``ticks`` control ticks.

    ``joint_position_rad`` (n,) is the arm's position at the start. ``predicted`` (n,) contains the sets of
    each tick, as records PREDICTED. ``half_widths_m`` (k, 3) contains the half widths of the k hands' sets at
    the present tick. The half widths are along the axes of the base frame.
    """

    def __init__(
        self,
        user: UserController,
        settings: Settings,
        arm: ArmModel,
        view: DesiredView | None,
        joint_position_rad: Floats,
        seed: int,
        hand_slots: int,
        ticks: int,
    ) -> None:
        super().__init__(user, settings, arm, view, joint_position_rad, seed, hand_slots)
        self.predicted = np.zeros(ticks, predicted_dtype(hand_slots))
        self.half_widths_m = np.zeros((0, 3))

    def failed(self, why: str) -> ControllerError:
        """Return the error that ends the run at this tick.

        ``why`` is the reason of the error.
        """
        return ControllerError(str(super().failed(why)).replace("the controller", "the predictor", 1))

    def predict(self, observation: ObservationRecords, state: StateRecords, tracks: TrackRecords) -> None:
        """Write the predicted hands of this tick into the servo's records.

        ``state`` (1,) is a record STATE, and ``tracks`` (n,) contains records TRACK.

        Raises:
            ControllerError: The predictor raises an exception, or its answer is invalid.

        """
        self.perceive(observation)
        try:
            hands = _hands_of(self.user.act(self._seen_now()), len(tracks))
            self._write(hands, state[0], tracks)
        except ControllerError as error:
            raise self.failed(str(error).replace("no Move and no Stop", "no Predicted")) from error
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            raise self.failed(f"act raised: {described(error)}") from error
        self.question["tick"] += 1

    def _write(self, hands: tuple[HandSet, ...], state: np.void, tracks: TrackRecords) -> None:
        """Write the ``hands`` into the servo's records and into the record of this tick.

        ``state`` is a record STATE, and ``tracks`` (n,) contains records TRACK.
        """
        sets = self.predicted[int(self.question[0]["tick"])]
        state["track_valid"][:] = False
        tracks["valid"] = False
        for k, hand in enumerate(hands):
            state["predicted_hand_in_base_m"][k] = _finite(
                "position_in_base_m", hand.position_in_base_m, (3,)
            )
            state["track_valid"][k] = tracks["valid"][k] = True
            tracks["id"][k] = hand.number
            sets["shape_m2"][k], sets["box"][k] = _shape_of(hand), hand.half_widths_m is not None
        squares_m2 = np.diagonal(sets["shape_m2"][: len(hands)], axis1=1, axis2=2)
        self.half_widths_m = np.sqrt(squares_m2)


def _hands_of(answer: object, most: int) -> tuple[HandSet, ...]:
    """Return the hands in a predictor's ``answer``.

    Raise ``ControllerError`` if they are invalid.
    """
    if not isinstance(answer, Predicted):
        raise ControllerError(f"act returned no Predicted: {printable(repr(answer))}")
    hands = tuple(answer.hands)
    if len(hands) > most:
        raise ControllerError(f"act predicted {len(hands)} hands; a run has room for {most}")
    for hand in hands:
        if not isinstance(hand, HandSet):
            raise ControllerError(f"act predicted no HandSet: {printable(repr(hand))}")
        if isinstance(hand.number, bool) or not isinstance(hand.number, int) or hand.number < 1:
            raise ControllerError(f"act predicted a hand whose number is no integer from 1: {hand.number!r}")
    if len({hand.number for hand in hands}) < len(hands):
        raise ControllerError("act predicted two hands with the same number")
    return hands


def _shape_of(hand: HandSet) -> Floats:
    """Return the matrix S (3, 3) [m^2] of a hand's set, as PREDICTED defines it.

    Raise ``ControllerError`` if the set is invalid.
    """
    given = [name for name in SETS if getattr(hand, name) is not None]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise ControllerError(f"act predicted a hand whose set is not one of ball, box and ellipsoid: {got}")
    if hand.ellipsoid_m2 is not None:
        shape = _finite("ellipsoid_m2", hand.ellipsoid_m2, (3, 3))
        if not (np.array_equal(shape, shape.T) and are_positive_definite(shape)):
            raise ControllerError("act predicted an ellipsoid_m2 that is not symmetric and positive definite")
        return shape
    name, size = given[0], () if hand.radius_m is not None else (3,)
    widths = _finite(name, getattr(hand, name), size)
    if not (widths > 0.0).all():
        raise ControllerError(f"act predicted a {name} that is not positive: {widths.tolist()}")
    shape = np.asarray(np.diag(np.broadcast_to(widths * widths, 3)))
    if not are_positive_definite(shape):
        raise ControllerError(f"act predicted a {name} whose square is no number: {widths.tolist()}")
    return shape


def _finite(name: str, value: object, shape: tuple[int, ...]) -> Floats:
    """Return ``value`` as an array of the shape ``shape``.

    Raise ``ControllerError`` unless all numbers are finite.
    """
    given = np.asarray(numbers(name, value, shape), dtype=np.float64)
    if not np.isfinite(given).all():
        raise ControllerError(f"act predicted a {name} that is not finite: {given.tolist()}")
    return given


class KalmanFilter:
    """The shipped predictor, which is the Kalman filter.

    Each hand has a box that should contain the hand with a probability of 95 %. Along each axis, the half
    width of the box is k standard deviations of the position. Here k is the normal quantile of (1 +
    0.95^(1/3))/2. The probability is right only if the filter's covariance is right.
    """

    name: ClassVar[str] = KALMAN_FILTER
    sees: ClassVar[tuple[str, ...]] = (PREDICTED_HANDS,)

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode.

        The predictor has no memory of earlier episodes.
        """
        self._deviations = normal_quantile(0.5 + 0.5 * power(CONFIDENCE, 1.0 / 3.0))

    def act(self, seen: Seen) -> Any:
        """Return the Kalman filter's hands with their boxes."""
        return Predicted(
            hands=tuple(
                HandSet(
                    position_in_base_m=hand.position_in_base_m,
                    number=hand.number,
                    half_widths_m=self._deviations * np.sqrt(np.diagonal(hand.covariance)[:3]),
                )
                for hand in seen.predicted_hands
            )
        )
