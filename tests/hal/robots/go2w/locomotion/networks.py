"""Small networks with random weights, written as ONNX files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = helper.make_opsetid("", 17)


def write(
    path: Path, nodes: list[Any], given: dict[str, list], made: dict[str, list], **numbers: np.ndarray
) -> None:
    """`given`, `made`: shapes by name; `numbers`: initializers."""
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in given.items()],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in made.items()],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in numbers.items()],
    )
    model = helper.make_model(graph, opset_imports=[OPSET], ir_version=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString())


def linear(path: Path, inputs: int, outputs: int = 16, seed: int = 0, batch: Any = 1) -> np.ndarray:
    """actions = obs @ W; -> W (inputs, outputs)."""
    weight = np.random.default_rng(seed).normal(0.0, 0.1, (inputs, outputs)).astype(np.float32)
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["actions"])]
    write(path, nodes, {"obs": [batch, inputs]}, {"actions": [batch, outputs]}, w=weight)
    return weight


def counting(path: Path, inputs: int, outputs: int = 16) -> None:
    """A recurrent one: its state grows by the sum of the observation, and is every output."""
    nodes = [
        helper.make_node("ReduceSum", ["obs", "axis"], ["sum"], keepdims=1),
        helper.make_node("Add", ["h_in", "sum"], ["h_out"]),
        helper.make_node("Expand", ["h_out", "size"], ["actions"]),
    ]
    shapes = {"obs": [1, inputs], "h_in": [1, 1]}
    numbers = {"axis": np.array([1], np.int64), "size": np.array([1, outputs], np.int64)}
    write(path, nodes, shapes, {"actions": [1, outputs], "h_out": [1, 1]}, **numbers)


def spoiled(path: Path, how: str) -> None:
    """A network that must not be run."""
    linear(path, 57)
    model = onnx.load_model_from_string(path.read_bytes())
    node, weight = model.graph.node[0], model.graph.initializer[0]
    if how == "operator":
        node.op_type, node.domain = "Custom", "com.evil"
        model.opset_import.append(helper.make_opsetid("com.evil", 1))
    elif how == "loop":
        node.op_type = "Loop"
    elif how == "elsewhere":
        weight.ClearField("raw_data")
        weight.data_location = TensorProto.EXTERNAL
        entry = weight.external_data.add()
        entry.key, entry.value = "location", "/etc/passwd"
    elif how == "bomb":
        model.graph.node.append(helper.make_node("Expand", ["actions", "much"], ["huge"]))
        model.graph.initializer.append(numpy_helper.from_array(np.array([100_000, 16], np.int64), "much"))
    elif how == "unknown":
        model.graph.input.append(helper.make_tensor_value_info("n", TensorProto.FLOAT, [1]))
        model.graph.node.append(helper.make_node("Cast", ["n"], ["m"], to=TensorProto.INT64))
        model.graph.node.append(helper.make_node("Expand", ["obs", "m"], ["huge"]))
    elif how == "inputs":
        model.graph.input.append(helper.make_tensor_value_info("map", TensorProto.FLOAT, [1, 4]))
    elif how == "state":
        model.graph.input.append(helper.make_tensor_value_info("h_in", TensorProto.FLOAT, [1, 4]))
    elif how == "doubles":
        model.graph.input[0].type.tensor_type.elem_type = TensorProto.DOUBLE
    path.write_bytes(model.SerializeToString())
