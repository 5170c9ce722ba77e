"""Faults with their times: what a sensor, a joint or the avoider does wrongly, and when.

Each is a frozen dataclass; ``fault_phrases`` says how it is written.  A fault acts from ``from_s``
until ``end_s``, which is one of three: so long after the beginning, a moment of the run, or its end.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import inf

from safety_harness.settings import Vector3

MOST_FAULTS = 16  # a trace has a bit for each
MOST_FALSE_HANDS = 2  # beside two true hands: a frame holds four


class Joint(Enum):
    """The joints of the arm, from its foot."""

    PAN = "pan"
    LIFT = "lift"
    ELBOW = "elbow"
    WRIST_1 = "wrist 1"
    WRIST_2 = "wrist 2"
    WRIST_3 = "wrist 3"


@dataclass(frozen=True, kw_only=True)
class Timed:
    """When a fault acts; at most one of ``for_s`` and ``until_s`` is given."""

    from_s: float = 0.0
    for_s: float | None = None
    until_s: float | None = None

    @property
    def end_s(self) -> float:
        """The first moment without the fault; infinity for one that stays."""
        if self.for_s is not None:
            return self.from_s + self.for_s
        return inf if self.until_s is None else self.until_s


@dataclass(frozen=True, kw_only=True)
class HandSensorBlind(Timed):
    """Its pictures show no hand."""


@dataclass(frozen=True, kw_only=True)
class HandSensorFrozen(Timed):
    """Its pictures are the last one before, with times of their own; none before: no hand."""


@dataclass(frozen=True, kw_only=True)
class HandSensorLate(Timed):
    """Its pictures arrive later by ``delay_s``, in their order."""

    delay_s: float


@dataclass(frozen=True, kw_only=True)
class HandSensorOff(Timed):
    """It measures every hand at a place that is off by ``offset_in_base_m``."""

    offset_in_base_m: Vector3


@dataclass(frozen=True, kw_only=True)
class FalseHand(Timed):
    """It sees one hand more, with its centre at ``position_in_base_m``; nothing is there."""

    position_in_base_m: Vector3


@dataclass(frozen=True, kw_only=True)
class CameraBlind(Timed):
    """The servoing camera's pictures do not show the object."""


@dataclass(frozen=True, kw_only=True)
class CameraFrozen(Timed):
    """Its pictures are the last one before, with times of their own; none before: no object."""


@dataclass(frozen=True, kw_only=True)
class CameraLate(Timed):
    """Its pictures arrive later by ``delay_s``, in their order."""

    delay_s: float


@dataclass(frozen=True, kw_only=True)
class CameraKnocked(Timed):
    """It sits otherwise than it was calibrated, and than when the desired picture was taken.

    Turned by a rotation vector in the camera frame, shifted in the TCP frame; of several at a time
    the turns follow one another and the shifts add up.
    """

    turned_in_camera_rad: Vector3 = (0.0, 0.0, 0.0)
    shifted_in_tcp_m: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class CameraHidden(Timed):
    """A hand or forearm between the camera and any part of the object hides the object."""


@dataclass(frozen=True, kw_only=True)
class JointStuck(Timed):
    """A joint stands still whatever is commanded."""

    joint: Joint


@dataclass(frozen=True, kw_only=True)
class AvoiderLate(Timed):
    """An answer to what is asked now counts ``delay_s`` later; at the decision deadline there is none."""

    delay_s: float


@dataclass(frozen=True, kw_only=True)
class AvoiderSilent(Timed):
    """What is asked now is never answered."""


@dataclass(frozen=True, kw_only=True)
class AvoiderNaN(Timed):
    """What is asked now is answered with a position that is no number."""


HandSensorFault = HandSensorBlind | HandSensorFrozen | HandSensorLate | HandSensorOff | FalseHand
CameraFault = CameraBlind | CameraFrozen | CameraLate | CameraKnocked | CameraHidden
AvoiderFault = AvoiderLate | AvoiderSilent | AvoiderNaN
Fault = HandSensorFault | CameraFault | JointStuck | AvoiderFault
