"""Networks of learnt policies: a perceptron in numpy, or an ONNX file."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hal.robots.go2w.locomotion.onnxfile import OnnxNetwork
from hal.robots.go2w.locomotion.torchfile import Layer, PolicyError, read_mlp

Float32 = NDArray[np.float32]


class Network(Protocol):
    """Observation in, action out. It may remember."""

    inputs: int
    outputs: int
    remembers: int
    """Numbers of its recurrent state; 0: none."""
    what: str
    """In words."""

    def reset(self) -> None:
        """Forget all state."""

    def __call__(self, observation: Float32) -> Float32:
        """(inputs,) -> (outputs,)."""


class Perceptron:
    """`Network` of plain layers."""

    remembers = 0

    def __init__(self, layers: list[Layer]) -> None:
        self.layers = layers
        self.inputs, self.outputs = layers[0].weight.shape[1], layers[-1].weight.shape[0]
        self.what = "perceptron of " + " x ".join(str(len(layer.bias)) for layer in layers)

    def reset(self) -> None:
        """There is none."""

    def __call__(self, observation: Float32) -> Float32:
        """(inputs,) -> (outputs,)."""
        return forward(self.layers, observation)


def forward(layers: list[Layer], x: Float32) -> Float32:
    """The perceptron's output (n,) for its input (m,), float32."""
    for weight, bias, activation in layers:
        x = weight @ x + bias
        if activation == "ELU":
            x = np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
        elif activation == "ReLU":
            x = np.maximum(x, 0.0)
        elif activation == "Tanh":
            x = np.tanh(x)
    return x


def read_network(file: Path, seen: int, size: int) -> Network:
    """A `.onnx` or a TorchScript `.pt`, which must map `seen` numbers to `size`. Raises PolicyError."""
    if file.suffix == ".onnx":
        network: Network = OnnxNetwork(file)
    elif file.suffix in (".pt", ".pth", ".jit"):
        network = Perceptron(read_mlp(file))
    else:
        raise PolicyError(f"{file}: a network is an .onnx file or a TorchScript .pt")
    if (network.inputs, network.outputs) != (seen, size):
        raise PolicyError(
            f"{file} maps {network.inputs} to {network.outputs} numbers, this policy should map {seen} to {size}"
        )
    return network
