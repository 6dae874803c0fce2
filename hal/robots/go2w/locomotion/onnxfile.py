"""A policy's network from an ONNX file, run by onnxruntime on one thread of the CPU. Needs the extra `policies`.

The file comes from somebody else. Before the runtime is given it, its parts are counted: operators of an allow-list
alone, no numbers in other files, no code of its own, and every array that it computes has a known size, so that it
cannot take more memory than a policy needs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.errors import one_line
from hal.regular import open_regular
from hal.robots.go2w.locomotion.torchfile import MAX_BYTES, PolicyError

OPERATORS = frozenset(
    [
        "Abs",
        "Add",
        "And",
        "BatchNormalization",
        "Cast",
        "Celu",
        "Clip",
        "Concat",
        "Constant",
        "ConstantOfShape",
        "Conv",
        "Div",
        "Dropout",
        "Elu",
        "Equal",
        "Erf",
        "Exp",
        "Expand",
        "Flatten",
        "GRU",
        "Gather",
        "Gelu",
        "Gemm",
        "Greater",
        "HardSigmoid",
        "HardSwish",
        "Identity",
        "LSTM",
        "LayerNormalization",
        "LeakyRelu",
        "Less",
        "Log",
        "MatMul",
        "Max",
        "Min",
        "Mul",
        "Neg",
        "Not",
        "Or",
        "PRelu",
        "Pow",
        "RNN",
        "Reciprocal",
        "ReduceL2",
        "ReduceMean",
        "ReduceSum",
        "Relu",
        "Reshape",
        "Selu",
        "Shape",
        "Sigmoid",
        "Slice",
        "Softmax",
        "Softplus",
        "Softsign",
        "Split",
        "Sqrt",
        "Squeeze",
        "Sub",
        "Tanh",
        "Transpose",
        "Unsqueeze",
        "Where",
    ]
)
SHAPED = {"Expand": 1, "ConstantOfShape": 0, "Reshape": 1}
"""Which input of an operator is a size: it must stand in the file, not be computed."""
MAX_NODES, MAX_NUMBERS = 2_000, 1_000_000
"""Operators of a network, and numbers of one array that it computes."""
MISSING = "needs onnxruntime: uv sync --extra policies, or pip install 'rbtrg-robot[policies]'"


class OnnxNetwork:
    """`hal.robots.go2w.locomotion.network.Network` from a file. Raises PolicyError."""

    def __init__(self, file: Path) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise PolicyError(f"{file} {MISSING}") from error
        data = checked(file)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the runtime has a dozen classes of its own
            raise PolicyError(f"{file}: onnxruntime does not take it: {one_line(error)[:200]}") from error
        self._file = file
        given = {node.name: _shape(node) for node in self._session.get_inputs()}
        made = {node.name: _shape(node) for node in self._session.get_outputs()}
        self._carried = {name: name.removesuffix("_in") + "_out" for name in given if name.endswith("_in")}
        for name, out in self._carried.items():
            if made.get(out) != given[name]:
                raise PolicyError(f"{file}: the state {name} needs an output {out} of the same shape")
        seen = [name for name in given if name not in self._carried]
        acted = [name for name in made if name not in self._carried.values()]
        if len(seen) != 1 or not acted:
            raise PolicyError(
                f"{file}: inputs {', '.join(given)}: there is one for the observation, and NAME_in with NAME_out "
                "for each state"
            )
        self._seen, self._shape, self._acted = seen[0], given[seen[0]], acted[0]
        self._fetched = [self._acted, *self._carried.values()]
        self._zero = {name: np.zeros(given[name], np.float32) for name in self._carried}
        self.inputs, self.outputs = math.prod(self._shape), math.prod(made[self._acted])
        self.remembers = sum(array.size for array in self._zero.values())
        self.what = f"ONNX network of {len(data) / 1e6:.1f} MB"
        self.reset()

    def reset(self) -> None:
        """The recurrent state is zero again."""
        self._state = dict(self._zero)

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """(inputs,) -> (outputs,). Raises PolicyError."""
        feed = {self._seen: observation.reshape(self._shape), **self._state}
        try:
            action, *state = self._session.run(self._fetched, feed)
        except Exception as error:
            raise PolicyError(f"{self._file} fails as it runs: {one_line(error)[:200]}") from error
        self._state = dict(zip(self._carried, state, strict=True))
        return np.asarray(action, np.float32).ravel()


def _shape(node: Any) -> tuple[int, ...]:
    """Every size of one robot: a batch of free size is one."""
    return tuple(size if isinstance(size, int) and size > 0 else 1 for size in node.shape)


def checked(file: Path) -> bytes:
    """The file, its shapes fixed for one robot. Raises PolicyError."""
    try:
        import onnx
    except ImportError as error:
        raise PolicyError(f"{file} {MISSING}") from error
    try:
        with open_regular(file) as stream:
            data = stream.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise PolicyError(f"{file} does not exist: give the folder of a policy with --policy DIR") from error
    except OSError as error:
        raise PolicyError(f"cannot read {file}: {error.strerror or error}") from error
    if len(data) > MAX_BYTES:
        raise PolicyError(
            f"{file} takes more than {MAX_BYTES / 1e6:.0f} MB: that is no policy for this robot"
        )
    try:
        model = onnx.load_model_from_string(data)
    except Exception as error:
        raise PolicyError(f"{file} is damaged or no ONNX file: export it again") from error
    for refused in _refusals(model):
        raise PolicyError(f"{file}: {refused}")
    known = {tensor.name for tensor in model.graph.initializer}
    for value in (*model.graph.input, *model.graph.output):
        kind = value.type.tensor_type
        if value.name not in known and kind.elem_type != onnx.TensorProto.FLOAT:
            raise PolicyError(f"{file}: {value.name[:40]} is not of 32 bit floats: export it so")
        for size in kind.shape.dim:
            if not size.dim_value:
                size.dim_value = 1
    try:
        onnx.checker.check_model(model)
        inferred = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
    except Exception as error:
        raise PolicyError(f"{file}: it does not hold together: {one_line(error)[:200]}") from error
    _sized(file, inferred)
    return bytes(model.SerializeToString())


def _refusals(model: Any) -> Iterator[str]:
    import onnx

    graph = model.graph
    if len(graph.node) > MAX_NODES:
        yield f"{len(graph.node)} operators: at most {MAX_NODES} are read"
    if model.functions or graph.sparse_initializer or model.training_info:
        yield "functions, sparse numbers and training are not read: export plain operators"
    tensors = list(graph.initializer)
    fixed = {tensor.name for tensor in tensors}
    fixed |= {name for node in graph.node if node.op_type == "Constant" for name in node.output}
    for node in graph.node:
        if node.op_type in SHAPED and set(node.input[SHAPED[node.op_type] :][:1]) - fixed:
            yield f"the size of what {node.op_type} makes is not known before it runs: export it with fixed shapes"
        if node.op_type not in OPERATORS or node.domain not in ("", "ai.onnx"):
            name = f"{node.domain[:40]}{'.' if node.domain else ''}{node.op_type[:40]}"
            yield f"the operator {name} is not one of those a policy needs"
        for attribute in node.attribute:
            if attribute.type in (onnx.AttributeProto.GRAPH, onnx.AttributeProto.GRAPHS):
                yield f"{node.op_type}: has a graph of its own"
            tensors += [attribute.t, *attribute.tensors]
    if any(tensor.external_data or tensor.data_location for tensor in tensors):
        yield "its numbers lie in another file: export one file"


def _sized(file: Path, model: Any) -> None:
    """Raises PolicyError where the size of an array is not known or too large."""
    values = (*model.graph.value_info, *model.graph.input, *model.graph.output)
    sizes: dict[str, float] = {}
    for value in values:
        kind = value.type.tensor_type
        known = kind.HasField("shape") and all(dim.HasField("dim_value") for dim in kind.shape.dim)
        sizes[value.name] = math.prod(dim.dim_value for dim in kind.shape.dim) if known else math.inf
    for node in model.graph.node:
        for name in filter(None, node.output):
            size = sizes.get(name, math.inf)
            if size > MAX_NUMBERS:
                much = "is not known before it runs" if math.isinf(size) else f"is {size:.0f} numbers"
                raise PolicyError(
                    f"{file}: the size of what {node.op_type} makes ({name[:40]}) {much}: export it with fixed shapes"
                )
