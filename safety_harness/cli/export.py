"""``safety-harness export``: a model file as ONNX or TorchScript, tried against the original."""

from __future__ import annotations

from pathlib import Path

from safety_harness.avoidance.model_file import load_model
from safety_harness.avoidance.shipped import model_file
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, explain, result, say
from safety_harness.exceptions import InputError, ModelError, Place

FORMATS = ("onnx", "torchscript")


def export(model: str | Path, *, out: Path, format: str = "onnx", seed: int = 0) -> int:
    """Write a model file, or a shipped model by name, to ``out`` in another format; say how far it is off.

    ``seed`` is that of the random questions.  Exit code 0; 2 for bad input, or if the written file does
    not answer as the original does (then ``out`` is as it was before); 130 after Ctrl-C.
    """
    try:
        path = model_file(str(model))
        difference_m = _export(path, out, format, seed)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted: nothing was exported")
        return INTERRUPTED
    result(f"{format}: {out}")
    result(f"differs from {path} by {1e3 * difference_m:.1e} mm at most")
    return AS_EXPECTED


def _export(model: Path, out: Path, format: str, seed: int) -> float:
    if format not in FORMATS:
        raise ModelError(
            place=Place(field="--format"), expected=" or ".join(map(repr, FORMATS)), got=repr(format)
        )
    if seed < 0:
        raise ModelError(place=Place(field="--seed"), expected="a seed of at least 0", got=str(seed))
    loaded = load_model(model)
    try:
        from safety_harness.learning.export import Format, write_export  # brings PyTorch

        return write_export(loaded, model.read_bytes(), out, Format(format), seed=seed)
    except ModuleNotFoundError as error:  # onnxscript is asked for by PyTorch, and late
        raise ModelError(
            place=Place(field="export"),
            expected="PyTorch with its ONNX exporter, which only export needs",
            got=str(error),
            hint="pip install 'safety-harness[learning]'",
        ) from error
