"""The networks of ``check.py`` as affine maps and ReLUs, of their files alone: nothing of this package.

A step is (name, of which, weight, bias, size of the bias's terms), or (name, of which) for a ReLU; the inputs
of several are one beside the other.  A safetensors file has perceptrons of 32 and 32 units, computed in
float64.  Of an ONNX file the affine maps are what ONNX's own reference makes of 0 and of unit vectors, row by
row; what is no ReLU and no such map is left out, and the answer with it.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Steps = list[Any]

HAND, TCP, ANSWER = "hand_position_in_base_m", "tcp_position_in_base_m", "position_in_base_m"
SINGLE, DOUBLE = 6e-8, 2e-15  # above 2^-24 and 2^-53
SUMS, AFFINE = ("Add", "Sub", "Concat"), ("Gemm", "MatMul", "Mul", "Div", "Identity", "Flatten", "Cast")
NORM = "BatchNormalization"
LEGAL = {"training_mode": (0,), "to": (1, 11)}  # of attributes: no statistics of a batch, floats alone


def network_of(data: bytes) -> tuple[list[Steps], float, float]:
    """Members, their unit roundoff, the threshold of their spread [m], of a file; or ValueError."""
    if data[8:9] != b"{":
        return [of_onnx(data)], SINGLE, math.nan
    header = json.loads(data[8 : (start := 8 + int.from_bytes(data[:8], "little"))])
    about = json.loads(header.pop("__metadata__")["safety_harness"])
    if about["kind"] != "relu perceptron" or about["members"] < 1:
        raise ValueError("the network is no perceptron")

    def tensor(name: str) -> Array:
        (begin, end), shape = header[name]["data_offsets"], header[name]["shape"]
        return np.frombuffer(data[start + begin : start + end], "<f4").astype(float).reshape(shape)

    mean, std, to, by = (np.array(about[k]) for k in ("input_mean", "input_std", "target_mean", "target_std"))
    members = []
    for k in range(about["members"]):
        w, b = ([tensor(f"{k}/fc{n}.{part}") for n in ("1", "2", "_out")] for part in ("weight", "bias"))
        w[0], w[2] = w[0] / std, w[2] * by[:, None]
        b[0], b[2] = b[0] - w[0] @ mean, to + by * b[2]
        names = zip(("a", "b", ANSWER), ([HAND, TCP], ["ra"], ["rb"]), strict=True)
        layers = [(*name, w[n].T, b[n], np.abs(b[n])) for n, name in enumerate(names)]
        members.append([layers[0], ("ra", ["a"]), layers[1], ("rb", ["b"]), layers[2]])
    return members, DOUBLE, (about["calibration"] or {}).get("spread_threshold_m", math.nan)


def of_onnx(data: bytes) -> Steps:
    """The steps of an ONNX file; ValueError, or another exception, for what has none."""
    import onnx
    from onnx.reference import ReferenceEvaluator

    def reference(node: Any, feed: dict[str, Array]) -> Array:
        found: Any = ReferenceEvaluator(node).run(None, feed)
        return np.asarray(found[0])

    model: Any = onnx.load_from_string(data)
    graph = model.graph
    if model.opset_import[0].version < 9 or any(one.external_data for one in graph.initializer):
        raise ValueError("operators of an old version, or weights in another file")
    known = {one.name: onnx.numpy_helper.to_array(one).astype(float) for one in graph.initializer}
    widths: dict[str, int] = {HAND: 3, TCP: 3}
    steps: Steps = []
    for node in graph.node:
        forms, op, out = [name in widths for name in node.input], node.op_type, node.output[0]
        own = [name for name in dict.fromkeys(node.input) if name in widths]
        legal = not node.domain and all(one.i in LEGAL.get(one.name, (one.i,)) for one in node.attribute)
        alone = sum(forms) == 1 and (forms[0] or op == "Mul")
        if op == "Constant":
            known[out] = np.asarray(reference(node, {}), float)
        elif op == "Relu" and own:
            steps.append((out, own))
            widths[out] = widths[own[0]]
        elif legal and own and (op in SUMS or (alone and op in (*AFFINE, NORM))):
            ends = np.cumsum([0] + [widths[name] for name in own])
            rows = np.eye(ends[-1] + 1, ends[-1], k=-1)  # 0, then unit vectors
            feed: Any = {name: rows[:, a:b] for name, a, b in zip(own, ends[:-1], ends[1:], strict=True)}
            feed |= {name: known[name] for name in node.input if name in known}
            if len(feed) < len(set(node.input)):
                continue  # of something that was left out
            found = reference(node, feed)
            if found.ndim != 2 or len(found) != len(rows):
                raise ValueError(f"{op} is not of rows")
            weight, bias = found[1:] - found[0], found[0]
            more = 2.0 * np.abs(known[node.input[3]]) @ np.abs(weight) if op == NORM else 0.0  # the mean's
            steps.append((out, own, weight, bias, np.abs(bias) + more))
            widths[out] = found.shape[1]
    return steps
