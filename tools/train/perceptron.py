"""Perceptrons in JAX."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from tools.train.network import Weights


def forward(weights: Weights, x: Any) -> Any:
    """The perceptron with ELU between its layers."""
    for k, (weight, bias) in enumerate(weights):
        x = x @ weight + bias
        if k < len(weights) - 1:
            x = jax.nn.elu(x)
    return x


def as_tree(weights: Weights) -> Weights:
    """As JAX arrays."""
    return [(jnp.asarray(w), jnp.asarray(b)) for w, b in weights]
