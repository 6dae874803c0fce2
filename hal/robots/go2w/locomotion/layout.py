"""What a policy sees and what its outputs mean, in rl_sar's layout: the same for driving and for training.

A frame is 57 numbers in SDK motor order: gyro, gravity direction in base_link, commanded vx, vy, wz, joint angles
relative to the default pose (wheels zero), joint velocities, previous raw output; each scaled, all clipped. The
observation is one frame, or frames of several ticks (`observations_history`). The 16 outputs are leg angle offsets
and wheel speeds, each times its scale."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hal.robots.go2w import facts as go2w
from hal.types import Array

OBSERVATIONS = ("ang_vel", "gravity_vec", "commands", "dof_pos", "dof_vel", "actions")
"""The only order of a frame that is understood."""
FRAME = 57
LONGEST = 50
"""Oldest frame that may be asked for [policy steps]."""


class PolicyParams(BaseModel):
    """What config.yaml says. Sixteen numbers each, SDK motor order; keys that do not matter here are left out."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    model_name: str = "policy.pt"
    observations: tuple[str, ...] = OBSERVATIONS
    observations_history: tuple[int, ...] = ()
    """Ages [policy steps] of the frames of an observation, 0 first; empty: the newest alone."""
    num_observations: int = FRAME
    """Of one frame."""
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
    actions_scale: float = 1.0
    """Of the previous output in a frame."""
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
        if self.observations != OBSERVATIONS or self.num_observations != FRAME:
            raise ValueError(f"observations must be {', '.join(OBSERVATIONS)}: {FRAME} numbers")
        ages = self.ages
        if ages[0] != 0 or list(ages) != sorted(set(ages)) or ages[-1] > LONGEST:
            raise ValueError(f"observations_history must rise from 0 to at most {LONGEST}")
        if self.wheel_indices != (12, 13, 14, 15) or self.joint_mapping != tuple(range(16)):
            raise ValueError("motors must be in SDK order (joint_mapping 0..15, wheels 12..15)")
        return self

    @property
    def ages(self) -> tuple[int, ...]:
        """Of the frames of an observation [policy steps], newest first."""
        return self.observations_history or (0,)


class Layout:
    """`PolicyParams` as arrays, for one robot or for many: every array may have leading axes."""

    def __init__(self, params: PolicyParams) -> None:
        self.params = params
        self.default = np.array(params.default_dof_pos)
        self.scale = np.array(params.action_scale)
        self.lower = np.array(params.clip_actions_lower, np.float32)
        self.upper = np.array(params.clip_actions_upper, np.float32)
        self.kp, self.kd = np.array(params.rl_kp), np.array(params.rl_kd)
        self.kp[go2w.WHEELS] = 0.0
        self._commands = np.array(params.commands_scale)

    def frame(
        self, gyro: Array, up: Array, command: Array, q: Array, dq: Array, action: NDArray[np.float32],
        out: NDArray[np.float32],
    ) -> None:  # fmt: skip
        """Write `out` (..., 57).

        gyro (..., 3) [rad/s] and world z `up` (..., 3) in base_link; `command` (..., 3): vx, vy [m/s], wz [rad/s]; q,
        dq (..., 16) [rad, rad/s]; `action` (..., 16): the output of the step before."""
        p = self.params
        out[..., 0:3] = gyro * p.ang_vel_scale
        out[..., 3:6] = -up
        out[..., 6:9] = command * self._commands
        out[..., 9:21] = (q[..., :12] - self.default[:12]) * p.dof_pos_scale
        out[..., 21:25] = 0.0
        out[..., 25:41] = dq * p.dof_vel_scale
        out[..., 41:57] = action * np.float32(p.actions_scale)
        np.clip(out, -p.clip_obs, p.clip_obs, out=out)

    def targets(self, action: NDArray[np.float32]) -> tuple[Array, Array]:
        """Joint angles [rad] and velocities [rad/s], both (..., 16), that the motors hold for a clipped output (...,
        16)."""
        target = action * self.scale
        q, dq = np.zeros(target.shape), np.zeros(target.shape)
        q[..., :12] = self.default[:12] + target[..., :12]
        dq[..., 12:] = target[..., 12:]
        return q, dq
