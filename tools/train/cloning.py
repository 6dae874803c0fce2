"""The first policy: the model-based controller, cloned by regression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from tools.train.environment import SEEN
from tools.train.network import LEAST_SPREAD, Weights, fresh
from tools.train.perceptron import as_tree, forward
from tools.train.settings import POLICY_LAYERS

BATCH_SIZE = 1024
LARGEST_ERROR = 9.0
"""Of one squared error, in spreads of the output: what the teacher does once in a while must not rule."""


@dataclass(frozen=True, slots=True, eq=False)
class Clone:
    """A policy for normalised inputs, and what normalises them."""

    weights: Weights
    mean: NDArray[np.float32]
    spread: NDArray[np.float32]
    error: float
    """Mean squared error in spreads of the outputs."""


def fit(
    seen: NDArray[np.float32],
    outputs: NDArray[np.float32],
    epochs: int = 20,
    rate: float = 1e-3,
    seed: int = 0,
) -> Clone:
    """Regress outputs (n, 16) on observations (n, SEEN)."""
    rng = np.random.default_rng(seed)
    mean = seen.mean(axis=0)
    spread = np.maximum(seen.std(axis=0), LEAST_SPREAD)
    weights = fresh([SEEN, *POLICY_LAYERS, 16], 0.1, rng)
    weights[-1] = (weights[-1][0], outputs.mean(axis=0))
    x, y = jnp.asarray((seen - mean) / spread), jnp.asarray(outputs)
    scale = jnp.maximum(y.std(axis=0), 0.05)
    batch = min(BATCH_SIZE, len(seen))
    batches = len(seen) // batch
    optimiser = optax.chain(
        optax.clip_by_global_norm(1.0), optax.adam(optax.cosine_decay_schedule(rate, epochs * batches, 0.05))
    )

    def loss(weights: Any, at: Any) -> Any:
        return jnp.mean(jnp.minimum(((forward(weights, x[at]) - y[at]) / scale) ** 2, LARGEST_ERROR))

    @jax.jit
    def epoch(weights: Any, state: Any, order: Any) -> Any:
        def update(carry: Any, at: Any) -> Any:
            weights, state = carry
            value, gradient = jax.value_and_grad(loss)(weights, at)
            change, state = optimiser.update(gradient, state, weights)
            return (optax.apply_updates(weights, change), state), value

        (weights, state), values = jax.lax.scan(update, (weights, state), order)
        return weights, state, values.mean()

    tree = as_tree(weights)
    state = optimiser.init(tree)
    error = float("nan")
    for _ in range(epochs):
        order = rng.permutation(len(seen))[: batches * batch].reshape(batches, batch)
        tree, state, value = epoch(tree, state, jnp.asarray(order))
        error = float(value)
    return Clone([(np.asarray(w), np.asarray(b)) for w, b in tree], mean, spread, error)
