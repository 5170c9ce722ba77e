"""All quantities that a controller may see at a tick, stored as one row of numbers.

A field is computed from the row when it is first read. This module imports no compiler, because the process
of a user's file also needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError
from safety_harness.seams.contract import (
    HAND_BOXES,
    HANDS,
    IMAGE,
    JOINTS,
    OBJECT,
    PREDICTED_HANDS,
    WANTED,
    HandBoxes,
    PredictedHand,
    Seen,
    SeenHand,
    SeenObject,
    WantedCommand,
)
from safety_harness.trace.records import JOINTS as SHIPPED_JOINTS
from safety_harness.trace.records import TRACKS_PER_HAND

Row = NDArray[np.float64]  # of SEEN, as far as it is wanted
Maker = Callable[[Row], Any]


@lru_cache
def seen_dtype(hands: int, joints: int = SHIPPED_JOINTS) -> np.dtype[Any]:
    """Return SEEN, the layout of a row with all quantities that a controller may see.

    The fields are only float64 and 8-byte int64. The most frequently needed fields come first. Therefore a
    controller that only sees hands needs only the beginning of a row.

    Args:
        hands: The number of hands for which the scenario has slots. The row has room for TRACKS_PER_HAND
            boxes and tracks per hand.
        joints: The number of the arm's joints.

    """
    boxes = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("time_s", np.float64),
            ("joint_position_rad", np.float64, (joints,)),
            ("joint_velocity_radps", np.float64, (joints,)),
            ("transform_tcp_to_base", np.float64, (4, 4)),
            ("tcp_position_in_base_m", np.float64, (3,)),
            ("hand_count", np.int64),
            ("hands", np.float64, (boxes, 3)),
            ("boxes_new", np.int64),
            ("boxes_time_s", np.float64),
            ("box_count", np.int64),
            ("boxes", np.float64, (boxes, 5)),
            ("transform_sensor_to_base", np.float64, (4, 4)),
            ("object_new", np.int64),
            ("object_visible", np.int64),
            ("features", np.float64, (6,)),
            ("feature_error", np.float64, (6,)),
            ("tracked", np.int64, (boxes,)),  # 0, or the number of the track
            ("last_seen_s", np.float64, (boxes,)),
            ("predicted", np.float64, (boxes, 3)),
            ("predicted_velocity", np.float64, (boxes, 3)),
            ("predicted_covariance", np.float64, (boxes, 6, 6)),
            ("wanted_radps", np.float64, (joints,)),  # the last two only for a safety filter
            ("wanted_stop", np.int64),
        ],
        align=True,
    )


class SeenLayout(dict[str, Maker]):
    """A mapping from the names of the visible fields to the functions that compute them from a row.

    ``hand_slots`` and ``joints`` are the arguments of ``seen_dtype``. The words in ``sees`` need only the
    first ``wanted`` numbers of a row.
    """

    def __init__(self, hand_slots: int, joints: int, sees: tuple[str, ...]) -> None:
        dtype = seen_dtype(hand_slots, joints)
        super().__init__(_makers(dtype, sees))
        self.hand_slots, self.joints, self.sees = hand_slots, joints, sees
        self.wanted = max([1, *(int(_part(dtype, _LAST[sight])[0].stop) for sight in sees)])


PackedSeen = tuple[float, int, int, tuple[str, ...], bytes]  # period, hands, joints, sees, row


def packed_seen(seen: Seen) -> PackedSeen:
    """Return the row of ``seen`` and its sizes, in a form that can be sent to another process.

    Raise ControllerError if ``seen`` was not created by the harness.
    """
    own = seen.__dict__
    if "_row" not in own:
        raise ControllerError("cannot send a Seen that the harness has not made")
    layout: SeenLayout = own["_makers"]
    return seen.period_s, layout.hand_slots, layout.joints, layout.sees, own["_row"].tobytes()


def unpacked(sent: PackedSeen) -> Seen:
    """Return the ``Seen`` object that ``packed_seen`` converted to ``sent``."""
    period_s, hand_slots, joints, sees, numbers = sent
    row = np.frombuffer(numbers)
    return Seen.of_row(row.item(0), period_s, layout_of(hand_slots, joints, sees), row)


layout_of = lru_cache(maxsize=64)(SeenLayout)
# The last field of a row that each word of ``sees`` needs.  The rest of the row is never sent.
_LAST = {
    JOINTS: "tcp_position_in_base_m",
    HANDS: "hands",
    HAND_BOXES: "transform_sensor_to_base",
    OBJECT: "feature_error",
    PREDICTED_HANDS: "predicted_covariance",
    IMAGE: "time_s",
    WANTED: "wanted_stop",
}


def _part(dtype: np.dtype[Any], name: str) -> tuple[slice, tuple[int, ...]]:
    """Return the slice of a row's numbers that contains a field, and the field's shape."""
    fields: Mapping[str, Any] = dtype.fields or {}
    kind, offset = fields[name][:2]
    return slice(offset // 8, (offset + kind.itemsize) // 8), kind.shape


def _makers(dtype: np.dtype[Any], sees: tuple[str, ...]) -> Iterator[tuple[str, Maker]]:
    """Yield the name of each visible field, and the function that computes the field from a row."""

    def array(name: str) -> Maker:
        part, shape = _part(dtype, name)
        if len(shape) == 1:
            return lambda row: row[part]
        return lambda row: row[part].reshape(shape)

    def whole(name: str) -> Callable[[Row], NDArray[np.int64]]:
        part, _ = _part(dtype, name)
        # The whole numbers are stored in the same row of 8-byte numbers, so reinterpret their bits.
        return lambda row: row[part].view(np.int64)

    if JOINTS in sees:
        for name in (
            "joint_position_rad",
            "joint_velocity_radps",
            "transform_tcp_to_base",
            "tcp_position_in_base_m",
        ):
            yield name, array(name)
    if HANDS in sees:
        count, centres = whole("hand_count"), array("hands")
        yield (
            "hands",
            lambda row: tuple(SeenHand(position_in_base_m=c) for c in centres(row)[: count(row)[0]]),
        )
    if HAND_BOXES in sees:
        yield "hand_boxes", _boxes(array, whole)
    if OBJECT in sees:
        yield "object", _object(array, whole)
    if PREDICTED_HANDS in sees:
        yield "predicted_hands", _predicted(array, whole)
    if WANTED in sees:
        rates, stop = array("wanted_radps"), whole("wanted_stop")
        yield (
            "wanted_command",
            lambda row: WantedCommand(joint_velocity_radps=rates(row), stop=bool(stop(row)[0])),
        )


def _boxes(array: Callable[[str], Maker], whole: Callable[[str], Maker]) -> Maker:
    time_s, boxes, pose = array("boxes_time_s"), array("boxes"), array("transform_sensor_to_base")
    new, count = whole("boxes_new"), whole("box_count")
    return lambda row: HandBoxes(
        time_s=float(time_s(row).item()),
        new=bool(new(row)[0]),
        boxes=boxes(row)[: count(row)[0]],
        transform_sensor_to_base=pose(row),
    )


def _object(array: Callable[[str], Maker], whole: Callable[[str], Maker]) -> Maker:
    features, error = array("features"), array("feature_error")
    visible, new = whole("object_visible"), whole("object_new")
    return lambda row: SeenObject(
        visible=bool(visible(row)[0]), new=bool(new(row)[0]), features=features(row), feature_error=error(row)
    )


def _predicted(array: Callable[[str], Maker], whole: Callable[[str], Maker]) -> Maker:
    number, last_seen = whole("tracked"), array("last_seen_s")
    position, velocity = array("predicted"), array("predicted_velocity")
    covariance = array("predicted_covariance")

    def made(row: Row) -> tuple[PredictedHand, ...]:
        return tuple(
            PredictedHand(
                position_in_base_m=position(row)[k],
                velocity_in_base_mps=velocity(row)[k],
                covariance=covariance(row)[k],
                number=int(number(row)[k]),
                last_seen_s=float(last_seen(row)[k]),
            )
            for k in np.flatnonzero(number(row))
        )

    return made
