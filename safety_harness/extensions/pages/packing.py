"""Pack columns of numbers as short text for a page's script.

The numbers are stored as fixed-point differences, which are compressed with deflate and encoded as text.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

PER_UNIT = 1e5  # real numbers are rounded to 1e-5 of their SI unit
NAN, INF = -(2**31), 2**31 - 1  # sentinels; values beyond them count as not finite


def packed(columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Pack arrays (n, ...) into the form that ``unpack`` in replay.js reads.

    The result has the number of rows, the width and the scale of each array, and the bytes of all arrays.
    Integers stay exact. Real numbers are rounded to 10 um, 10 urad or 10 us. NaN and infinity are preserved.
    Consecutive values of a component differ little. The function therefore stores differences and groups
    their bytes by significance, because such data compress well.
    """
    shapes, steps = {}, [np.zeros(0, np.int32)]
    for name, values in columns.items():
        scale = PER_UNIT if values.dtype.kind == "f" else 1.0
        rows = values.reshape(len(values), int(np.prod(values.shape[1:], dtype=np.int64))).T * scale
        there = np.isfinite(rows) & (np.abs(rows) < INF)
        whole = np.where(there, rows, np.where(np.isposinf(rows), INF, NAN)).round().astype(np.int64)
        shapes[name] = [len(values), len(whole), scale]
        shifted = np.hstack([np.zeros((len(whole), 1), np.int64), whole[:, :-1]])
        steps.append((whole - shifted).astype(np.int32).ravel())  # modulo 2^32, as the script adds
    planes = np.concatenate(steps).astype("<i4").view(np.uint8).reshape(-1, 4).T
    return {"columns": shapes, "packed": deflated(np.ascontiguousarray(planes).tobytes())}


def deflated(plain: bytes) -> str:
    """Return bytes as text that ``inflate`` of replay.js reads."""
    return base64.b64encode(zlib.compress(plain, 9)).decode()


def as_attribute(data: dict[str, Any]) -> str:
    """Return ``data`` as deflated JSON in a text that contains only letters, digits, +, / and =."""
    return deflated(json.dumps(data, separators=(",", ":"), allow_nan=False).encode())
