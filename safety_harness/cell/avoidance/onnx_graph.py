"""Find the parts of an ONNX graph that make its answers random, or that make them depend on optimisation.

An optimising runtime may replace dropout by the identity, even if the exporter left dropout active. Such a
file would then seem deterministic, and the spread of several passes would be 0. So this module reads the
graph itself, including its functions and inner graphs. The module also compares the file's answers with and
without the runtime's optimisation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import described
from safety_harness.cell.avoidance.model_file import refuse
from safety_harness.cell.avoidance.onnx_names import dtype_of

RANDOM = frozenset(
    {"Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike"}
    | {"BiasDropout", "BitmaskBiasDropout", "BitmaskDropout", "Sampling"}  # the runtime's own
)
TRAINING_SAID_SINCE = {"Dropout": 12, "BatchNormalization": 14}  # older versions do not state the mode
MASKS_HINT = (
    "export the network in evaluation mode; safety-harness docs reference/onnx shows how to keep its passes"
)
SEED_HINT = "random numbers must come from the input 'seed'"
QUESTIONS, RELATIVE, ABSOLUTE = 4, 1e-4, 1e-6  # another order of float32 sums changes far less

Constants = Mapping[str, NDArray[Any]]


def refuse_chance(path: Path, data: bytes) -> None:
    """Raise ``ModelError`` if the graph in ``data`` has a random operator or an operator in training mode."""
    import onnx
    import onnx.inliner

    try:
        model = onnx.load_from_string(data)
        if model.functions:  # inlined, so that the arguments of their calls are known
            model = onnx.inliner.inline_local_functions(model)
    except Exception as error:  # protobuf's own errors, and the inliner's
        refuse(path, None, "a graph that the package onnx can read", described(error)[:300])
    _refuse_nodes(path, model.graph.node, model.opset_import, _stored(model.graph.initializer))
    for function in model.functions:  # operators of another version, with unknown inputs
        _refuse_nodes(path, function.node, function.opset_import, {})


def _stored(tensors: Iterable[Any]) -> Constants:
    """Return the boolean scalars and vectors among ``tensors``.

    Other tensors cannot set a training mode.
    """
    from onnx import TensorProto, numpy_helper

    wanted = [tensor for tensor in tensors if tensor.data_type == TensorProto.BOOL and len(tensor.dims) <= 1]
    return {tensor.name: numpy_helper.to_array(tensor) for tensor in wanted if not tensor.external_data}


def _refuse_nodes(path: Path, nodes: Sequence[Any], opsets: Iterable[Any], outer: Constants) -> None:
    """Raise ``ModelError`` at the first node that is random or may be in training mode.

    ``outer`` contains the constants of the enclosing graph.
    """
    from onnx import helper

    version = max((item.version for item in opsets if item.domain in ("", "ai.onnx")), default=1)
    constants = dict(outer)
    for node in nodes:
        own = {item.name: helper.get_attribute_value(item) for item in node.attribute}
        if node.op_type == "Constant" and "value" in own:
            constants.update(zip(node.output, _stored([own["value"]]).values(), strict=False))
        place = f"{node.op_type} {node.name or next(iter(node.output), '')!r}"
        if node.op_type in RANDOM:
            refuse(path, place, "no operator that draws without a seed of ours", "one", SEED_HINT)
        if node.op_type in TRAINING_SAID_SINCE and _may_train(node, own, version, constants):
            verb = "says" if version >= TRAINING_SAID_SINCE[node.op_type] else "may say"
            refuse(path, place, "an operator in evaluation mode", f"one that {verb} training", MASKS_HINT)
        for inner in (item for item in own.values() for item in (item if isinstance(item, list) else [item])):
            if hasattr(inner, "initializer"):
                _refuse_nodes(path, inner.node, opsets, {**constants, **_stored(inner.initializer)})


def _may_train(node: Any, more: Mapping[str, Any], version: int, constants: Constants) -> bool:
    """Return whether a node is or may be in training mode."""
    if node.op_type == "BatchNormalization":
        return bool(more.get("training_mode", 0)) or sum(map(bool, node.output)) > 1
    if version < TRAINING_SAID_SINCE["Dropout"]:
        return True  # "random or a copy": the file does not state the mode
    mode = node.input[2] if len(node.input) > 2 else ""
    known = constants.get(mode)
    return bool(mode) and (known is None or bool(np.any(known)))


def refuse_dependence(path: Path, optimised: Any, plain: Any) -> None:
    """Raise ``ModelError`` if a file answers differently with and without optimisation.

    Args:
        path: The file, for errors.
        optimised: The session with optimisation.
        plain: The session without it.

    """
    feeds = [_feed(plain, np.random.default_rng(seed)) for seed in range(QUESTIONS)]
    names = [output.name for output in plain.get_outputs()]
    for feed in feeds:
        output, plain_output = (_answers(session, feed) for session in (optimised, plain))
        if (output is None) != (plain_output is None):
            refuse(path, None, "a graph that answers with and without optimisation", "one that fails in one")
        for name, a, b in zip(names, output or [], plain_output or [], strict=False):
            if not _close(a, b):
                expected = "the same answer with and without the runtime's optimisation"
                refuse(path, name, expected, f"{_first(a)}, and {_first(b)} without", MASKS_HINT)


def _feed(session: Any, rng: np.random.Generator) -> dict[str, NDArray[Any]] | None:
    """Return one row of random numbers for each input, or None if an input has no numeric type."""
    feed: dict[str, NDArray[Any]] = {}
    for tensor in session.get_inputs():
        dtype = dtype_of(tensor)
        shape = [size if isinstance(size, int) else 1 for size in tensor.shape]
        if dtype == "bool":
            feed[tensor.name] = rng.random(shape) < 0.5
        elif dtype.startswith("float"):
            feed[tensor.name] = rng.uniform(-1.0, 1.0, shape).astype(dtype)
        elif dtype.startswith(("int", "uint")):
            feed[tensor.name] = rng.integers(16, 127, shape).astype(dtype)
        else:
            return None
    return feed


def _answers(session: Any, feed: dict[str, NDArray[Any]] | None) -> list[Any] | None:
    """Return the outputs of the session, or None if it fails.

    If the session fails, the code that later uses the file reports the reason.
    """
    try:
        return None if feed is None else list(session.run(None, feed))
    except Exception:  # onnxruntime's own errors have no other common base
        return None


def _close(a: Any, b: Any) -> bool:
    """Return whether two outputs differ only by rounding.

    A runtime may compute sums in a different order, which changes the rounding.
    """
    if not (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.dtype.kind in "bfiu"):
        return True  # no contract has a sequence or text
    left, right = a.astype(np.float64), b.astype(np.float64)
    largest = max((float(np.max(np.abs(x[np.isfinite(x)]), initial=0.0)) for x in (left, right)), default=0.0)
    return left.shape == right.shape and np.allclose(
        left, right, rtol=0.0, atol=ABSOLUTE + RELATIVE * largest, equal_nan=True
    )


def _first(answer: NDArray[Any]) -> str:
    """Return the first numbers of an answer as text."""
    return str(answer.reshape(-1)[:3].tolist())
