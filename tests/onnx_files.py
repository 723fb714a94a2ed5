"""Policies that tests write: linear laws as ONNX files."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

IR_VERSION, OPSET = 9, 17


def write_linear_law(path: Path, gain: NDArray[Any], *, batch: bool = False, bits: int = 64) -> Path:
    """Write u = K x, of which K has the shape (m, n)."""
    m, n = gain.shape
    number = TensorProto.DOUBLE if bits == 64 else TensorProto.FLOAT
    dtype: Any = np.float64 if bits == 64 else np.float32
    leading = ["batch"] if batch else []
    # Row vectors times the transpose: with or without a dimension for several.
    return write_onnx(
        path,
        [helper.make_node("MatMul", ["x", "gain"], ["u"])],
        [helper.make_tensor_value_info("x", number, [*leading, n])],
        [helper.make_tensor_value_info("u", number, [*leading, m])],
        {"gain": np.ascontiguousarray(gain.T).astype(dtype)},
    )


def write_onnx(
    path: Path, nodes: list[Any], inputs: list[Any], outputs: list[Any], constants: dict[str, NDArray[Any]]
) -> Path:
    """Write a graph."""
    given = [numpy_helper.from_array(values, name) for name, values in constants.items()]
    graph = helper.make_graph(nodes, "policy", inputs, outputs, given)
    opset = helper.make_opsetid("", OPSET)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=IR_VERSION)
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())
    return path
