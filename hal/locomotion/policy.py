"""A learnt locomotion policy in rl_sar's layout (fan-ziqi/rl_sar, policy/go2w), run with numpy alone.

A policy folder holds `policy.pt` (TorchScript), `config.yaml` (observation, scales, gains) and optionally `base.yaml` (control
period), here or one folder up. The observation is made of 57 numbers in SDK motor order: gyro, gravity direction in
base_link, commanded vx, vy, wz, joint angles relative to the default pose (wheels zero), joint velocities, previous raw output;
each scaled, all clipped. The 16 outputs are leg angle offsets and wheel speeds, each times its scale.

The policy was trained to step at zero command and creeps by 2-3 cm/s, so at zero command the robot brakes, settles and then
holds its joints where they are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hal import go2w
from hal.locomotion.public import stored
from hal.locomotion.torchfile import Layer, PolicyError, read_mlp
from hal.lowlevel import LowCommand, LowState
from hal.rotation import up_of
from hal.types import Array, PostureCommand, VelocityCommand

__all__ = ["PolicyController", "PolicyError", "PolicyParams", "load_params"]

OBSERVATIONS = ("ang_vel", "gravity_vec", "commands", "dof_pos", "dof_vel", "actions")
"""The only observation layout that is understood, in this order."""

SETTLE_TIME = 0.6
"""[s] of zero command that the policy brakes before the joints are held."""
HOLD_KP, HOLD_KD = 90.0, 3.0
WHEEL_HOLD_KP, WHEEL_HOLD_KD = 12.0, 1.0
"""Gains of the stand-hold [Nm/rad, Nms/rad]."""
HOLD_BLEND = 0.4
"""[s] over which the policy's soft gains turn into the hold's."""


class PolicyParams(BaseModel):
    """What config.yaml says. Sixteen numbers each, SDK motor order; keys that do not matter here are left out."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    model_name: str = "policy.pt"
    observations: tuple[str, ...] = OBSERVATIONS
    observations_history: tuple[int, ...] = ()
    num_observations: int = 57
    clip_obs: float = Field(100.0, gt=0.0)
    clip_actions_lower: tuple[float, ...] = (-100.0,) * 16
    clip_actions_upper: tuple[float, ...] = (100.0,) * 16
    rl_kp: tuple[float, ...]
    rl_kd: tuple[float, ...]
    action_scale: tuple[float, ...]
    default_dof_pos: tuple[float, ...]
    ang_vel_scale: float = 0.25
    dof_pos_scale: float = 1.0
    dof_vel_scale: float = 0.05
    commands_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    wheel_indices: tuple[int, ...] = (12, 13, 14, 15)
    joint_mapping: tuple[int, ...] = tuple(range(16))
    dt: float = Field(0.005, gt=0.0)
    """Motor period [s], from base.yaml."""
    decimation: int = Field(4, ge=1)
    """Motor periods per policy step, from base.yaml."""

    @model_validator(mode="after")
    def _fits_the_go2w(self) -> PolicyParams:
        for name in (
            "clip_actions_lower",
            "clip_actions_upper",
            "rl_kp",
            "rl_kd",
            "action_scale",
            "default_dof_pos",
        ):
            values = getattr(self, name)
            if len(values) != 16 or not np.isfinite(values).all():
                raise ValueError(f"{name} must hold 16 numbers, one per motor")
        if self.observations != OBSERVATIONS or self.observations_history:
            raise ValueError(f"observations must be {', '.join(OBSERVATIONS)} without history")
        if self.wheel_indices != (12, 13, 14, 15) or self.joint_mapping != tuple(range(16)):
            raise ValueError("motors must be in SDK order (joint_mapping 0..15, wheels 12..15)")
        return self


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
    """`hal.lowlevel.Locomotion` from a policy folder (empty: the public policy that was fetched). Follows vx, vy and wz; ignores posture. Raises PolicyError."""

    def __init__(self, folder: str | Path) -> None:
        folder = Path(folder) if str(folder) else stored()
        self.params = p = load_params(folder)
        self.layers = read_mlp(folder / p.model_name)
        inputs, outputs = self.layers[0].weight.shape[1], self.layers[-1].weight.shape[0]
        if (inputs, outputs) != (p.num_observations, 16) or inputs != 57:
            raise PolicyError(
                f"{folder / p.model_name} maps {inputs} to {outputs} numbers, a Go2-W policy maps 57 to 16"
            )
        self.period = p.dt
        self._default = np.array(p.default_dof_pos)
        self._scale = np.array(p.action_scale)
        self._lower, self._upper = (
            np.array(p.clip_actions_lower, np.float32),
            np.array(p.clip_actions_upper, np.float32),
        )
        self._commands_scale = np.array(p.commands_scale)
        self._kp, self._kd = np.array(p.rl_kp), np.array(p.rl_kd)
        self._kp[go2w.WHEELS] = 0.0
        self._hold_kp = np.array([HOLD_KP] * 12 + [WHEEL_HOLD_KP] * 4)
        self._hold_kd = np.array([HOLD_KD] * 12 + [WHEEL_HOLD_KD] * 4)
        self._observation = np.zeros(57, np.float32)
        self._command = LowCommand(*(np.zeros(16) for _ in range(5)))
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self._action = np.zeros(16, np.float32)
        self._tick = 0
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
            self._held_tau = self._kp * (c.q - state.q)
            self._held_tau[go2w.WHEELS] = 0.0
        s = min((state.time - self._held_since) / HOLD_BLEND, 1.0)
        c.q[:] = self._held
        c.dq[:] = 0.0
        c.tau[:] = self._held_tau
        c.kp[:] = (1.0 - s) * self._kp + s * self._hold_kp
        c.kd[:] = (1.0 - s) * self._kd + s * self._hold_kd
        return c

    def _run(self, state: LowState, velocity: VelocityCommand) -> None:
        p, x = self.params, self._observation
        x[0:3] = state.gyro * p.ang_vel_scale
        x[3:6] = -np.array(up_of(state.quaternion))
        x[6] = velocity.vx * self._commands_scale[0]
        x[7] = velocity.vy * self._commands_scale[1]
        x[8] = velocity.wz * self._commands_scale[2]
        x[9:21] = (state.q[:12] - self._default[:12]) * p.dof_pos_scale
        x[21:25] = 0.0
        x[25:41] = state.dq * p.dof_vel_scale
        x[41:57] = self._action
        np.clip(x, -p.clip_obs, p.clip_obs, out=x)
        self._action = np.clip(forward(self.layers, x), self._lower, self._upper)
        target = self._action * self._scale
        c = self._command
        c.q[:12] = self._default[:12] + target[:12]
        c.q[12:] = 0.0
        c.dq[:12] = 0.0
        c.dq[12:] = target[12:]
        c.tau[:] = 0.0
        c.kp[:] = self._kp
        c.kd[:] = self._kd


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
