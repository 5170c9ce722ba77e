"""An ONNX file in onnxruntime, as avoiders and controllers share it: opened, laid out and asked."""

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
    """The function of an ONNX file, on one thread of the CPU, in one order of operations."""

    inputs: list[Tensor]
    outputs: list[Tensor]

    def __init__(self, path: Path, data: bytes, layout: str = "") -> None:
        """Load the file ``path`` with the contents ``data``; ModelError says what is wrong.

        ``layout`` says what inputs and outputs hold whose names do not (``onnx_names``).
        """
        self.path, self.session, self.layout = path, open_session(path, data), layout_of(layout)
        self.metadata: dict[str, str] = dict(self.session.get_modelmeta().custom_metadata_map)

    def lay_out(self, takes: Quantities, gives: Quantities, required: set[str]) -> None:
        """Look for the quantities that inputs and outputs may hold; ModelError as of ``laid_out``."""
        self.inputs, self.outputs = laid_out(self.path, self.session, self.layout, takes, gives, required)

    def fed(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the inputs, made of the ``arrays`` (1, ...) of quantities."""
        return {one.name: one.packed(arrays) for one in self.inputs}

    def answers(
        self, arrays: Mapping[str, NDArray[Any]], widths: Mapping[str, int]
    ) -> dict[str, NDArray[Any]]:
        """Return the quantities of the outputs, of so many columns each."""
        values = self.session.run([one.name for one in self.outputs], self.fed(arrays))
        pairs = zip(self.outputs, values, strict=True)
        return dict(pair for one, value in pairs for pair in one.split(value, widths))


def open_session(path: Path, data: bytes) -> Any:
    """Return the file in onnxruntime: one thread, in order, no file beside it.

    Raise ModelError if the runtime cannot load it, if it draws random numbers, or if its answer depends on
    the runtime's optimisation.
    """
    session = _session(path, data, optimised=True)
    refuse_chance(path, data)
    refuse_dependence(path, session, _session(path, data, optimised=False))
    return session


def _session(path: Path, data: bytes, *, optimised: bool) -> Any:
    import onnxruntime  # an extra: who asks for one has looked

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    if not optimised:
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4  # what is wrong comes as an exception
    options.add_session_config_entry("session.load_model_format", "ONNX")
    # External data are sought in a folder, which this file is not: there are none.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(path))
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own have no common base but Exception
        hint = "torch.onnx.export(..., external_data=False) stores the tensors in the file itself"
        hint = hint if "xternal data" in str(error) else ""
        refuse(path, None, "an ONNX file that onnxruntime can load", described(error), hint)
