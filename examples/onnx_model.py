"""An ONNX file of one's own: the least that the contract asks for.

safety-harness docs reference/onnx has the contract.

    python onnx_model.py up.onnx  # safety-harness copy shipped:onnx_model.py
    safety-harness run shipped:hand-visits-and-leaves --avoider up.onnx

PyTorch, TensorFlow or scikit-learn write such files as well; give inputs and outputs these names.
Needs the package onnx, which only writing does: pip install 'hand-safety-harness[learning]'.
"""

import sys
from pathlib import Path

import onnx
from onnx import TensorProto, helper


def straight_up(by_m: float = 0.1, spread_m: float = 0.005) -> onnx.ModelProto:
    """A proposal ``by_m`` above the TCP, with the same spread on every axis, whatever the hand does."""
    hand, tcp, position, spread = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3])  # metres, float32 or float64
        for name in ("hand_position_in_base_m", "tcp_position_in_base_m", "position_in_base_m", "spread_m")
    )
    up = helper.make_tensor("up", TensorProto.FLOAT, [1, 3], [0.0, 0.0, by_m])
    doubt = helper.make_tensor("doubt", TensorProto.FLOAT, [1, 3], [spread_m] * 3)
    graph = helper.make_graph(
        [
            helper.make_node("Add", ["tcp_position_in_base_m", "up"], ["position_in_base_m"]),
            helper.make_node("Identity", ["doubt"], ["spread_m"]),
        ],
        "straight up",
        inputs=[hand, tcp],
        outputs=[position, spread],
        initializer=[up, doubt],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(model, {"spread_threshold_m": "0.01"})  # above it the gate refuses a proposal
    onnx.checker.check_model(model)
    return model


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(straight_up().SerializeToString())
