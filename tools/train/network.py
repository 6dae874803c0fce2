"""Weights of perceptrons as numpy arrays, and what makes a policy of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.robots.go2w.locomotion.torchfile import Layer

Weights = list[tuple[Any, Any]]
"""Weight (inputs, outputs) and bias (outputs,) of each layer."""
LEAST_SPREAD = 0.05
"""Of an input; what hardly varies in the clone's data must not be blown up."""


def fresh(sizes: Sequence[int], last: float, rng: np.random.Generator) -> Weights:
    """Random weights; the last layer's are `last` times as large."""
    out = [
        ((rng.normal(size=(a, b)) / np.sqrt(a)).astype(np.float32), np.zeros(b, np.float32))
        for a, b in itertools.pairwise(sizes)
    ]
    out[-1] = (out[-1][0] * np.float32(last), out[-1][1])
    return out


def normalised(weights: Weights, mean: NDArray[np.float32], spread: NDArray[np.float32]) -> Weights:
    """The same perceptron for inputs that were not divided by their spread: the first layer does it."""
    first, bias = np.asarray(weights[0][0], np.float64), np.asarray(weights[0][1], np.float64)
    scaled = first / spread[:, None]
    return [(scaled.astype(np.float32), (bias - mean @ scaled).astype(np.float32)), *weights[1:]]


def as_layers(weights: Weights) -> list[Layer]:
    """For `hal.robots.go2w.locomotion.weights`."""
    last = len(weights) - 1
    return [
        Layer(
            np.asarray(w, np.float32).T.copy(), np.asarray(b, np.float32), "Identity" if k == last else "ELU"
        )
        for k, (w, b) in enumerate(weights)
    ]
