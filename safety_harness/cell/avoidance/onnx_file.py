"""Load an ONNX file in onnxruntime, find the quantities in its tensors, and run it."""

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
    """An ONNX file as a function.

    The runtime uses one thread of the CPU and a fixed order of operations.
    """

    inputs: list[Tensor]
    outputs: list[Tensor]

    def __init__(self, path: Path, data: bytes, layout: str = "") -> None:
        """Load the ONNX file ``path``, whose contents are ``data``.

        Raise a ``ModelError`` that states the fault. If an input or output does not have a name of the
        harness, ``layout`` states its quantities (``onnx_names``).
        """
        self.path, self.session, self.layout = path, open_session(path, data), layout_of(layout)
        self.metadata: dict[str, str] = dict(self.session.get_modelmeta().custom_metadata_map)

    def lay_out(self, takes: Quantities, gives: Quantities, required: set[str]) -> None:
        """Find the quantities that each input and output contains.

        Raise ``ModelError`` in the same cases as ``laid_out``.

        Args:
            takes: The quantities that inputs may contain, by name.
            gives: The quantities that outputs may contain, by name.
            required: The quantities that the file must contain.

        """
        self.inputs, self.outputs = laid_out(self.path, self.session, self.layout, takes, gives, required)

    def fed(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the file's input tensors by name.

        The tensors are composed of ``arrays``, which have the shape (1, ...).
        """
        return {tensor.name: tensor.packed(arrays) for tensor in self.inputs}

    def answers(
        self, arrays: Mapping[str, NDArray[Any]], widths: Mapping[str, int]
    ) -> dict[str, NDArray[Any]]:
        """Run the file and return the quantities in its outputs.

        ``widths`` states the number of columns of each quantity.
        """
        values = self.session.run([tensor.name for tensor in self.outputs], self.fed(arrays))
        pairs = zip(self.outputs, values, strict=True)
        return dict(pair for tensor, value in pairs for pair in tensor.split(value, widths))


def open_session(path: Path, data: bytes) -> Any:
    """Return a session of onnxruntime for the file.

    The session uses one thread and a fixed order of operations, and does not open another file.

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
    """Load the file in onnxruntime, with or without optimisation.

    Raise ``ModelError`` if this fails.
    """
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
