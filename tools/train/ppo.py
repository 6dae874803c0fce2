"""Proximal policy optimisation (Schulman et al. 2017) of a policy and a critic that sees more."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from tools.train.environment import KNOWN_COUNT, SEEN
from tools.train.network import Weights, fresh
from tools.train.perceptron import as_tree, forward
from tools.train.settings import CRITIC_LAYERS, Ppo

Float32 = NDArray[np.float32]
SPREAD_LIMITS = (0.08, 0.8)
"""Least and largest spread of the outputs."""
RATE_LIMITS = (2e-5, 1e-3)
"""Least and largest learning rate of the policy."""
RATE_FACTOR = 1.5
"""Of the learning rate, where the divergence is not as wanted."""
HALF_LOG_2PI = 0.5 * float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Experience:
    """`horizon` steps of n robots; first axis the time."""

    known: Float32
    """(t, n, KNOWN_COUNT)"""
    action: Float32
    """(t, n, 16)"""
    chance: Float32
    """(t, n) log probability of the action."""
    mean: Float32
    """(t, n, 16) of the policy that acted."""
    value: Float32
    """(t + 1, n)"""
    reward: Float32
    ended: NDArray[np.bool_]
    """(t, n) a robot began anew after the step."""


def advantages(e: Experience, gamma: float, lam: float) -> tuple[Float32, Float32]:
    """Generalised advantage estimation (Schulman et al. 2016) -> advantages and returns, (t, n)."""
    out = np.zeros_like(e.reward)
    sofar = np.zeros(e.reward.shape[1], np.float32)
    for t in reversed(range(len(e.reward))):
        goes_on = 1.0 - e.ended[t].astype(np.float32)
        error = e.reward[t] + gamma * e.value[t + 1] * goes_on - e.value[t]
        sofar = error + gamma * lam * goes_on * sofar
        out[t] = sofar
    return out, out + e.value[:-1]


class Learner:
    """A policy, its spread, a critic, and their optimisers."""

    def __init__(
        self, ppo: Ppo, policy: Weights, mean: Float32, spread: Float32, seed: int, critic: Weights | None = None,
        log_std: Float32 | None = None, rate: float | None = None,
    ) -> None:  # fmt: skip
        rest = KNOWN_COUNT - SEEN
        self.ppo, self.mean, self.spread = ppo, mean, spread
        self._offset = jnp.asarray(np.concatenate([mean, np.zeros(rest, np.float32)]))
        self._scale = jnp.asarray(np.concatenate([spread, np.ones(rest, np.float32)]))
        rng = np.random.default_rng(seed)
        self.actor: Any = {
            "net": as_tree(policy),
            "log_std": jnp.asarray(
                log_std if log_std is not None else np.full(16, np.log(ppo.std), np.float32)
            ),
        }
        self.critic: Any = as_tree(
            critic if critic is not None else fresh([KNOWN_COUNT, *CRITIC_LAYERS, 1], 0.1, rng)
        )
        self.rate = rate or ppo.rate
        """Learning rate of the policy."""
        self._actor_optimiser = optax.inject_hyperparams(_adam)(learning_rate=self.rate)
        self._critic_optimiser = _adam(ppo.critic_rate)
        self._critic_state = self._critic_optimiser.init(self.critic)
        self.begin()
        self._key = jax.random.PRNGKey(seed)
        self._act = jax.jit(self._act_of)
        self._value = jax.jit(self._value_of)
        self._improve_actor = jax.jit(self._improve_actor_of)
        self._improve_critic = jax.jit(self._improve_critic_of)
        # Neither needs the other: each has a core of its own.
        self._critic_thread = ThreadPoolExecutor(1)
        self._rng = rng

    def begin(self) -> None:
        """Forget the policy's moments: those from before its critic was any good would throw it far off at once."""
        self._actor_state: Any = self._actor_optimiser.init(self.actor)

    # --- acting -----------------------------------------------------------------------------------------------------
    def act(self, known: Float32) -> tuple[Float32, Float32, Float32, Float32]:
        """For (n, KNOWN_COUNT): drawn outputs (n, 16), their log probability (n,), the mean outputs (n, 16), the values
        (n,)."""
        self._key, key = jax.random.split(self._key)
        return tuple(np.asarray(v) for v in self._act(self.actor, self.critic, known, key))  # type: ignore[return-value]

    def value(self, known: Float32) -> Float32:
        """(n,) of (n, KNOWN_COUNT)."""
        return np.asarray(self._value(self.critic, known))

    def _input(self, known: Any) -> Any:
        return (known - self._offset) / self._scale

    def _value_of(self, critic: Any, known: Any) -> Any:
        return forward(critic, self._input(known))[..., 0]

    def _act_of(self, actor: Any, critic: Any, known: Any, key: Any) -> Any:
        mean = forward(actor["net"], self._input(known)[:, :SEEN])
        action = mean + jnp.exp(actor["log_std"]) * jax.random.normal(key, mean.shape)
        return action, _chance(mean, actor["log_std"], action), mean, self._value_of(critic, known)

    # --- learning ---------------------------------------------------------------------------------------------------
    def learn(self, e: Experience, policy_too: bool) -> tuple[float, float]:
        """All epochs over an experience -> divergence of the policies [nat], mean squared error of the values."""
        p = self.ppo
        gain, returns = advantages(e, p.gamma, p.lam)
        gain = (gain - gain.mean()) / (gain.std() + 1e-6)
        n = returns.size
        flat = (
            e.known.reshape(n, -1),
            e.action.reshape(n, 16),
            e.chance.ravel(),
            e.mean.reshape(n, 16),
            gain.ravel(),
            returns.ravel(),
        )
        batch = tuple(jnp.asarray(v) for v in flat)
        size = n // p.batches
        order = np.concatenate(
            [self._rng.permutation(n)[: size * p.batches].reshape(p.batches, size) for _ in range(p.epochs)]
        )
        old = self.actor["log_std"]
        self._actor_state.hyperparams["learning_rate"] = jnp.float32(self.rate)
        learnt = self._critic_thread.submit(
            self._improve_critic, self.critic, self._critic_state, batch, jnp.asarray(order)
        )
        self.actor, self._actor_state, divergence = self._improve_actor(
            self.actor, self._actor_state, batch, old, jnp.asarray(order), jnp.float32(policy_too)
        )
        far = float(divergence[-p.batches :].mean())
        self.critic, self._critic_state, error = learnt.result()
        if policy_too and far > 2.0 * p.divergence:
            self.rate = max(self.rate / RATE_FACTOR, RATE_LIMITS[0])
        elif policy_too and far < 0.5 * p.divergence:
            self.rate = min(self.rate * RATE_FACTOR, RATE_LIMITS[1])
        return far, float(error.mean())

    def _improve_actor_of(
        self, actor: Any, state: Any, batch: Any, old_log_std: Any, order: Any, policy_too: Any
    ) -> Any:
        p = self.ppo

        def loss_of(actor: Any, part: Any) -> Any:
            known, action, chance, old_mean, gain, _ = part
            mean, log_std = forward(actor["net"], self._input(known)[:, :SEEN]), actor["log_std"]
            ratio = jnp.exp(jnp.clip(_chance(mean, log_std, action) - chance, -5.0, 5.0))
            clipped = jnp.clip(ratio, 1.0 - p.clip, 1.0 + p.clip)
            loss = -jnp.minimum(ratio * gain, clipped * gain).mean() - p.entropy * log_std.sum()
            variance = jnp.exp(2.0 * old_log_std) + (old_mean - mean) ** 2
            divergence = (
                (log_std - old_log_std + variance / (2.0 * jnp.exp(2.0 * log_std)) - 0.5).sum(axis=-1).mean()
            )
            return loss, divergence

        def step(carry: Any, at: Any) -> Any:
            actor, state = carry
            part = jax.tree.map(lambda v: v[at], batch)
            (_, divergence), gradient = jax.value_and_grad(loss_of, has_aux=True)(actor, part)
            change, state = self._actor_optimiser.update(gradient, state, actor)
            actor = optax.apply_updates(actor, jax.tree.map(lambda v: policy_too * v, change))
            actor = {
                **actor,
                "log_std": jnp.clip(actor["log_std"], np.log(SPREAD_LIMITS[0]), np.log(SPREAD_LIMITS[1])),
            }
            return (actor, state), divergence

        (actor, state), divergence = jax.lax.scan(step, (actor, state), order)
        return actor, state, divergence

    def _improve_critic_of(self, critic: Any, state: Any, batch: Any, order: Any) -> Any:
        def loss_of(critic: Any, known: Any, returns: Any) -> Any:
            return ((self._value_of(critic, known) - returns) ** 2).mean()

        def step(carry: Any, at: Any) -> Any:
            critic, state = carry
            error, gradient = jax.value_and_grad(loss_of)(critic, batch[0][at], batch[5][at])
            change, state = self._critic_optimiser.update(gradient, state, critic)
            return (optax.apply_updates(critic, change), state), error

        (critic, state), error = jax.lax.scan(step, (critic, state), order)
        return critic, state, error


def _adam(learning_rate: Any) -> optax.GradientTransformation:
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(learning_rate, eps=1e-5))


def _chance(mean: Any, log_std: Any, action: Any) -> Any:
    """Log probability of an action under independent normal distributions."""
    return (-0.5 * ((action - mean) / jnp.exp(log_std)) ** 2 - log_std - HALF_LOG_2PI).sum(axis=-1)
