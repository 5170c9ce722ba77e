"""One input X of scikit-learn becomes the two inputs that an avoider has: hand and TCP.

skl2onnx writes a file with one input of six columns and an output called variable; of an MLPRegressor of
three targets it makes one column of all numbers.  This writes it anew with our names, three numbers a row, so
that no layout has to be given; safety-harness docs reference/onnx has both ways.

    python sklearn_to_onnx.py model.onnx mine.onnx  # safety-harness copy shipped:sklearn_to_onnx.py
    safety-harness run shipped:hand-visits-and-leaves --avoider mine.onnx

How model.onnx comes to be (pip install scikit-learn skl2onnx), X being the hand, then the TCP, in metres:

    from skl2onnx import to_onnx
    from sklearn.linear_model import LinearRegression

    fitted = LinearRegression().fit(X, positions_in_base_m)  # X (n, 6), positions (n, 3)
    open("model.onnx", "wb").write(to_onnx(fitted, X[:1].astype("float32")).SerializeToString())

Needs the package onnx: pip install 'hand-safety-harness[onnx]'.
"""

import sys
from pathlib import Path

import onnx
from onnx import TensorProto, helper

HAND, TCP, POSITION = "hand_position_in_base_m", "tcp_position_in_base_m", "position_in_base_m"


def with_our_names(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model of one input (n, 6), the hand and then the TCP, and one output (n, 3), under our names."""
    graph = model.graph
    constants = {one.name for one in graph.initializer}
    (x,) = (one for one in graph.input if one.name not in constants)
    (y,) = graph.output
    columns = x.type.tensor_type.shape.dim[1].dim_value
    if columns != 6:
        raise SystemExit(f"{x.name}: expected six columns, the hand's and the TCP's position; got {columns}")
    kind = x.type.tensor_type.elem_type
    inputs = [helper.make_tensor_value_info(name, kind, ["n", 3]) for name in (HAND, TCP)]
    output = helper.make_tensor_value_info(POSITION, y.type.tensor_type.elem_type, ["n", 3])
    nodes = [
        helper.make_node("Concat", [HAND, TCP], [x.name], axis=1),
        *graph.node,
        helper.make_node("Reshape", [y.name, "three_a_row"], [POSITION]),
    ]
    graph.initializer.append(helper.make_tensor("three_a_row", TensorProto.INT64, [2], [-1, 3]))
    own = [one for one in graph.input if one.name in constants]
    for field, value in (("node", nodes), ("input", [*inputs, *own]), ("output", [output])):
        graph.ClearField(field)
        getattr(graph, field).extend(value)
    onnx.checker.check_model(model)
    return model


if __name__ == "__main__":
    source, out = map(Path, sys.argv[1:])
    out.write_bytes(with_our_names(onnx.load(source)).SerializeToString())
