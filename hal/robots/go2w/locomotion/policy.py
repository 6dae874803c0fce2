"""A learnt locomotion policy, run with numpy alone: rl_sar's folders (fan-ziqi/rl_sar, policy/go2w) and files of our
own.

A policy folder holds `policy.pt` (TorchScript), `config.yaml` (observation, scales, gains) and optionally `base.yaml`
(control period), here or one folder up. A file of ours (`hal.robots.go2w.locomotion.weights`) holds the same in one.
`hal.robots.go2w.locomotion.layout` has the observation.

Policies were trained to step at zero command and creep by 2-3 cm/s, so at zero command the robot brakes, settles and
then holds its joints where they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError

from hal.lowlevel import LowCommand, LowState
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.layout import FRAME, Layout, PolicyParams
from hal.robots.go2w.locomotion.torchfile import Layer, PolicyError, read_mlp
from hal.robots.go2w.locomotion.weights import load_weights
from hal.rotation import up_of
from hal.types import Array, PostureCommand, VelocityCommand

__all__ = ["PolicyController", "PolicyError", "PolicyParams", "load_params"]

SETTLE_TIME = 0.6
"""[s] of zero command that the policy brakes before the joints are held."""
HOLD_KP, HOLD_KD = 90.0, 3.0
WHEEL_HOLD_KP, WHEEL_HOLD_KD = 12.0, 1.0
"""Gains of the stand-hold [Nm/rad, Nms/rad]."""
HOLD_BLEND = 0.4
"""[s] over which the policy's soft gains turn into the hold's."""


def load_params(folder: Path) -> PolicyParams:
    """config.yaml over base.yaml. Raises PolicyError."""
    if not folder.is_dir():
        raise PolicyError(
            f"policy folder {folder} does not exist: give one that holds config.yaml and policy.pt"
        )
    values: dict[str, Any] = {}
    for path, needed in (
        (folder / "base.yaml", False),
        (folder.parent / "base.yaml", False),
        (folder / "config.yaml", True),
    ):
        if not path.is_file():
            if needed:
                raise PolicyError(f"{path} is missing: give a policy folder in rl_sar's layout")
            continue
        try:
            tree = yaml.safe_load(path.read_text())
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise PolicyError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
        # One group named after the robot, e.g. `go2w/robot_lab:`.
        inner = next(iter(tree.values())) if isinstance(tree, dict) and len(tree) == 1 else tree
        if not isinstance(inner, dict):
            raise PolicyError(f"{path} must hold one group of `key: value` lines")
        values |= inner
    try:
        return PolicyParams.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise PolicyError(f"{folder / 'config.yaml'}: {key + ': ' if key else ''}{first['msg']}") from error


class PolicyController:
    """`hal.lowlevel.Locomotion` from a policy folder or a file of ours. Follows vx, vy and wz; ignores posture.
    Raises PolicyError."""

    def __init__(self, source: Path) -> None:
        if source.suffix == ".npz":
            self.params, self.layers, _ = load_weights(source)
        else:
            self.params, self.layers = _rl_sar(source)
        self.period = self.params.dt
        self.layout = Layout(self.params)
        self._hold_kp = np.array([HOLD_KP] * 12 + [WHEEL_HOLD_KP] * 4)
        self._hold_kd = np.array([HOLD_KD] * 12 + [WHEEL_HOLD_KD] * 4)
        self._frames = np.zeros((self.params.ages[-1] + 1, FRAME), np.float32)
        self._command = LowCommand(*(np.zeros(16) for _ in range(5)))
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self.shake = 0.0
        """Standard deviation of noise on the outputs, as policies are trained with. The same after each reset."""
        self._noise = np.random.default_rng(0)
        self._action = np.zeros(16, np.float32)
        self._tick = 0
        self._begun = False
        self._idle_since: float | None = None
        self._held: Array | None = None

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One motor period; the network runs every `decimation`-th."""
        del posture
        if velocity.vx != 0.0 or velocity.vy != 0.0 or velocity.wz != 0.0:
            self._idle_since = None
            if self._held is not None:
                self._held = None
                self._action[:] = 0.0
                self._tick = 0
                self._begun = False
        elif self._idle_since is None:
            self._idle_since = state.time
        if self._idle_since is not None and state.time - self._idle_since >= SETTLE_TIME:
            return self._hold(state)
        if self._tick % self.params.decimation == 0:
            self._run(state, velocity)
        self._tick += 1
        return self._command

    def warning(self) -> str:
        """Always empty: a network does not tell why it stops."""
        return ""

    def _hold(self, state: LowState) -> LowCommand:
        c = self._command
        if self._held is None:
            self._held = state.q.copy()
            self._held_since = state.time
            # What the springs carry now, they carry on: no sag when the gains change.
            self._held_tau = self.layout.kp * (c.q - state.q)
            self._held_tau[go2w.WHEELS] = 0.0
        s = min((state.time - self._held_since) / HOLD_BLEND, 1.0)
        c.q[:] = self._held
        c.dq[:] = 0.0
        c.tau[:] = self._held_tau
        c.kp[:] = (1.0 - s) * self.layout.kp + s * self._hold_kp
        c.kd[:] = (1.0 - s) * self.layout.kd + s * self._hold_kd
        return c

    def _run(self, state: LowState, velocity: VelocityCommand) -> None:
        frames, layout = self._frames, self.layout
        frames[1:] = frames[:-1].copy()
        command = np.array([velocity.vx, velocity.vy, velocity.wz])
        up = np.array(up_of(state.quaternion))
        layout.frame(state.gyro, up, command, state.q, state.dq, self._action, frames[0])
        if not self._begun:
            frames[1:] = frames[0]
            self._begun = True
        observation = frames[list(self.params.ages)].ravel()
        action = forward(self.layers, observation)
        if self.shake > 0.0:
            action = action + self._noise.normal(0.0, self.shake, 16).astype(np.float32)
        self._action = np.clip(action, layout.lower, layout.upper)
        c = self._command
        c.q[:], c.dq[:] = layout.targets(self._action)
        c.tau[:] = 0.0
        c.kp[:] = layout.kp
        c.kd[:] = layout.kd


def _rl_sar(folder: Path) -> tuple[PolicyParams, list[Layer]]:
    """A folder in rl_sar's layout. Raises PolicyError."""
    params = load_params(folder)
    layers = read_mlp(folder / params.model_name)
    inputs, outputs = layers[0].weight.shape[1], layers[-1].weight.shape[0]
    wanted = FRAME * len(params.ages)
    if (inputs, outputs) != (wanted, 16):
        raise PolicyError(
            f"{folder / params.model_name} maps {inputs} to {outputs} numbers, this policy should map {wanted} to 16"
        )
    return params, layers


def forward(layers: list[Layer], x: NDArray[np.float32]) -> NDArray[np.float32]:
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
