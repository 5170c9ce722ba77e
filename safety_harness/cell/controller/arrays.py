"""Turn a controller's view into arrays, for environments (observations) and ONNX policies (inputs).

Absent hands and unknown numbers have the value zero. An additional flag states whether the hand or the number
is present. This module imports only modules that need no compiler.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from safety_harness.seams.contract import HAND_BOXES, HANDS, JOINTS, OBJECT, PREDICTED_HANDS

SeenRows = NDArray[np.void]  # (n,) SEEN
Arrays = dict[str, NDArray[np.generic]]  # by name, of n rows each


def observed(seen: SeenRows, sees: Iterable[str]) -> Arrays:
    """Return the arrays of the quantities ``sees``, each with n rows.

    ``seen`` (n,) contains records SEEN. The arrays have the same names and frames as in the contract's
    ``Seen``.
    """
    arrays: Arrays = {}
    for sight in sees:
        arrays |= _READERS[sight](seen)
    return arrays


def _joints(seen: SeenRows) -> Arrays:
    """Return the positions and velocities of the joints, and the pose of the TCP."""
    names = ("joint_position_rad", "joint_velocity_radps", "transform_tcp_to_base", "tcp_position_in_base_m")
    return {name: seen[name].copy() for name in names}


def _hands(seen: SeenRows) -> Arrays:
    """Return the measured hands, and flags that state which hands are present."""
    there = _first(seen["hand_count"], seen["hands"])
    return {"hands": _where(there, seen["hands"]), "hands_there": there}


def _boxes(seen: SeenRows) -> Arrays:
    """Return the boxes of hands, and flags that state which boxes are present."""
    there = _first(seen["box_count"], seen["boxes"])
    return {
        "hand_boxes": _where(there, seen["boxes"]),
        "hand_boxes_there": there,
        "hand_boxes_new": _flag(seen["boxes_new"]),
        "hand_boxes_age_s": np.nan_to_num(seen["time_s"] - seen["boxes_time_s"])[:, None],
        "transform_sensor_to_base": seen["transform_sensor_to_base"].copy(),
    }


def _object(seen: SeenRows) -> Arrays:
    """Return the features of the object, and a flag that states whether the object is visible."""
    visible = _flag(seen["object_visible"])
    return {
        "object_visible": visible,
        "object_new": _flag(seen["object_new"]),
        "features": _where(visible[:, 0], seen["features"]),
        "feature_error": _where(visible[:, 0], seen["feature_error"]),
    }


def _predicted(seen: SeenRows) -> Arrays:
    """Return the predicted hands, and flags that state which hands are present."""
    there = (seen["tracked"] != 0).astype(np.int8)
    return {
        "predicted_hands": _where(there, seen["predicted"]),
        "predicted_hands_there": there,
        "predicted_hands_velocity_mps": _where(there, seen["predicted_velocity"]),
        "predicted_hands_covariance": _where(there, seen["predicted_covariance"]),
        "predicted_hands_age_s": _where(there, seen["time_s"][:, None] - seen["last_seen_s"]),
    }


_READERS: dict[str, Callable[[SeenRows], Arrays]] = {
    JOINTS: _joints,
    HANDS: _hands,
    HAND_BOXES: _boxes,
    OBJECT: _object,
    PREDICTED_HANDS: _predicted,
}


def _flag(true: NDArray[np.int64]) -> NDArray[np.int8]:  # (n,)
    """Return the flag ``true`` (n,) as a column (n, 1)."""
    flags: NDArray[np.int8] = (true != 0).astype(np.int8)
    return flags[:, None]


def _first(count: NDArray[np.int64], rows: NDArray[np.float64]) -> NDArray[np.int8]:
    """Return flags (n, k) that are 1 for the first ``count`` rows and 0 for the rest.

    ``rows`` has the shape (n, k, ...), and ``count`` (n,) is a number of rows.
    """
    return (np.arange(rows.shape[1]) < count[:, None]).astype(np.int8)


def _where(there: NDArray[np.int8], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``rows`` (n, ...), with zeros where a flag in ``there`` is zero.

    ``there`` has the shape (n,) or (n, k).
    """
    kept: NDArray[np.bool_] = (there != 0).reshape(there.shape + (1,) * (rows.ndim - there.ndim))
    return np.where(kept, rows, 0.0)
