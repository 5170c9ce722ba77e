"""What in an ONNX graph makes its answer a matter of chance, or of the runtime's optimisation.

A runtime that optimises may take dropout for the identity, even where the exporter left it active.  Such a
file would be called repeatable, and several passes in it would have the spread 0.  So the graph itself is
read, with its functions and inner graphs, and its answers with and without optimisation are compared.
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
TRAINING_SAID_SINCE = {"Dropout": 12, "BatchNormalization": 14}  # before, no attribute or input says it
MASKS_HINT = (
    "export the network in evaluation mode; safety-harness docs avoiders shows how to keep its passes"
)
SEED_HINT = "random numbers must come from the input 'seed'"
QUESTIONS, RELATIVE, ABSOLUTE = 4, 1e-4, 1e-6  # sums in another order, in float32, differ by far less

Constants = Mapping[str, NDArray[Any]]


def refuse_chance(path: Path, data: bytes) -> None:
    """Raise ModelError if the graph of ``data`` holds a random operator, or one left in training."""
    import onnx
    import onnx.inliner

    try:
        model = onnx.load_from_string(data)
        if model.functions:  # what a call hands over is known after this
            model = onnx.inliner.inline_local_functions(model)
    except Exception as error:  # protobuf's own, and of the inliner
        refuse(path, None, "a graph that the package onnx can read", described(error)[:300])
    _look(path, model.graph.node, model.opset_import, _stored(model.graph.initializer))
    for function in model.functions:  # with operators of another version: nothing is known of its inputs
        _look(path, function.node, function.opset_import, {})


def _stored(tensors: Iterable[Any]) -> Constants:
    """The single truth values among ``tensors``; larger tensors say nothing about training."""
    from onnx import TensorProto, numpy_helper

    wanted = [one for one in tensors if one.data_type == TensorProto.BOOL and len(one.dims) <= 1]
    return {one.name: numpy_helper.to_array(one) for one in wanted if not one.external_data}


def _look(path: Path, nodes: Sequence[Any], opsets: Iterable[Any], outer: Constants) -> None:
    """Raise ModelError for the first of ``nodes`` that draws; ``outer`` are the constants around them."""
    from onnx import helper

    version = max((one.version for one in opsets if one.domain in ("", "ai.onnx")), default=1)
    constants = dict(outer)
    for node in nodes:
        more = {one.name: helper.get_attribute_value(one) for one in node.attribute}
        if node.op_type == "Constant" and "value" in more:
            constants.update(zip(node.output, _stored([more["value"]]).values(), strict=False))
        place = f"{node.op_type} {node.name or next(iter(node.output), '')!r}"
        if node.op_type in RANDOM:
            refuse(path, place, "no operator that draws without a seed of ours", "one", SEED_HINT)
        if node.op_type in TRAINING_SAID_SINCE and _may_train(node, more, version, constants):
            says = "says" if version >= TRAINING_SAID_SINCE[node.op_type] else "may say"
            refuse(path, place, "an operator in evaluation mode", f"one that {says} training", MASKS_HINT)
        for inner in (one for one in more.values() for one in (one if isinstance(one, list) else [one])):
            if hasattr(inner, "initializer"):
                _look(path, inner.node, opsets, {**constants, **_stored(inner.initializer)})


def _may_train(node: Any, more: Mapping[str, Any], version: int, constants: Constants) -> bool:
    if node.op_type == "BatchNormalization":
        return bool(more.get("training_mode", 0)) or sum(map(bool, node.output)) > 1
    if version < TRAINING_SAID_SINCE["Dropout"]:
        return True  # "random or a copy": the file does not say which
    mode = node.input[2] if len(node.input) > 2 else ""
    known = constants.get(mode)
    return bool(mode) and (known is None or bool(np.any(known)))


def refuse_dependence(path: Path, optimised: Any, plain: Any) -> None:
    """Raise ModelError if two sessions of one file, with and without optimisation, answer differently."""
    feeds = [_feed(plain, np.random.default_rng(seed)) for seed in range(QUESTIONS)]
    names = [one.name for one in plain.get_outputs()]
    for feed in feeds:
        one, other = (_answers(session, feed) for session in (optimised, plain))
        if (one is None) != (other is None):
            refuse(path, None, "a graph that answers with and without optimisation", "one that fails in one")
        for name, a, b in zip(names, one or [], other or [], strict=False):
            if not _close(a, b):
                expected = "the same answer with and without the runtime's optimisation"
                refuse(path, name, expected, f"{_first(a)}, and {_first(b)} without", MASKS_HINT)


def _feed(session: Any, rng: np.random.Generator) -> dict[str, NDArray[Any]] | None:
    """Numbers for each input, one row; None where an input is of no numeric type."""
    feed: dict[str, NDArray[Any]] = {}
    for one in session.get_inputs():
        dtype = dtype_of(one)
        shape = [size if isinstance(size, int) else 1 for size in one.shape]
        if dtype == "bool":
            feed[one.name] = rng.random(shape) < 0.5
        elif dtype.startswith("float"):
            feed[one.name] = rng.uniform(-1.0, 1.0, shape).astype(dtype)
        elif dtype.startswith(("int", "uint")):
            feed[one.name] = rng.integers(16, 127, shape).astype(dtype)
        else:
            return None
    return feed


def _answers(session: Any, feed: dict[str, NDArray[Any]] | None) -> list[Any] | None:
    """The outputs; None for none: whoever uses the file asks it again, and says why it failed."""
    try:
        return None if feed is None else list(session.run(None, feed))
    except Exception:  # onnxruntime's own have no common base but Exception
        return None


def _close(a: Any, b: Any) -> bool:
    if not (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.dtype.kind in "bfiu"):
        return True  # a sequence or text: no contract has it
    one, other = a.astype(np.float64), b.astype(np.float64)
    largest = max((float(np.max(np.abs(x[np.isfinite(x)]), initial=0.0)) for x in (one, other)), default=0.0)
    return one.shape == other.shape and np.allclose(
        one, other, rtol=0.0, atol=ABSOLUTE + RELATIVE * largest, equal_nan=True
    )


def _first(answer: NDArray[Any]) -> str:
    return str(answer.reshape(-1)[:3].tolist())
