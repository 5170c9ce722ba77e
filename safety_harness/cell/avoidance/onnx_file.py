"""Open, lay out and run an ONNX file in onnxruntime, for avoiders and controllers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from safety_harness.base.exceptions import described
from safety_harness.cell.avoidance.model_file import refuse
from safety_harness.cell.avoidance.onnx_graph import refuse_chance, refuse_dependence
from safety_harness.cell.avoidance.onnx_names import Quantities, Tensor, laid_out, layout_of


class OnnxFile:
    """An ONNX file as a function, which runs on one thread of the CPU in a fixed order of operations."""

    inputs: list[Tensor]
    outputs: list[Tensor]

    def __init__(self, path: Path, data: bytes, layout: str = "") -> None:
        """Load the file ``path`` with the contents ``data``; raise a ``ModelError`` that states its fault.

        ``layout`` states the quantities of inputs and outputs whose names are not ours (``onnx_names``).
        """
        self.path, self.session, self.layout = path, open_session(path, data), layout_of(layout)
        self.metadata: dict[str, str] = dict(self.session.get_modelmeta().custom_metadata_map)

    def lay_out(self, takes: Quantities, gives: Quantities, required: set[str]) -> None:
        """Find the quantities that each input and output holds; raise ``ModelError`` as ``laid_out`` does.

        Args:
            takes: The quantities that inputs may hold, by name.
            gives: The quantities that outputs may hold, by name.
            required: The quantities that the file must have.

        """
        self.inputs, self.outputs = laid_out(self.path, self.session, self.layout, takes, gives, required)

    def fed(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the file's inputs by name, made of the ``arrays`` (1, ...) of quantities."""
        return {tensor.name: tensor.packed(arrays) for tensor in self.inputs}

    def answers(
        self, arrays: Mapping[str, NDArray[Any]], widths: Mapping[str, int]
    ) -> dict[str, NDArray[Any]]:
        """Run the file; return the quantities of its outputs, each with its columns by ``widths``."""
        values = self.session.run([tensor.name for tensor in self.outputs], self.fed(arrays))
        pairs = zip(self.outputs, values, strict=True)
        return dict(pair for tensor, value in pairs for pair in tensor.split(value, widths))


def open_session(path: Path, data: bytes) -> Any:
    """Return a session of onnxruntime with the file: one thread, a fixed order, no further file.

    Args:
        path: The file, for errors.
        data: Its bytes.

    Raises:
        ModelError: The runtime cannot load it, it draws random numbers, or its answer depends on the
            runtime's optimisation.

    """
    session = _session(path, data, optimised=True)
    refuse_chance(path, data)
    refuse_dependence(path, session, _session(path, data, optimised=False))
    return session


def _session(path: Path, data: bytes, *, optimised: bool) -> Any:
    """Load the file in onnxruntime, with or without optimisation; raise ``ModelError`` if that fails."""
    import onnxruntime  # an extra, which the caller has checked

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    if not optimised:
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4  # errors come as exceptions
    options.add_session_config_entry("session.load_model_format", "ONNX")
    # The runtime seeks external data in this folder.  The path is a file, so the runtime finds none.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(path))
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own errors have no other common base
        hint = "torch.onnx.export(..., external_data=False) stores the tensors in the file itself"
        hint = hint if "xternal data" in str(error) else ""
        refuse(path, None, "an ONNX file that onnxruntime can load", described(error), hint)
