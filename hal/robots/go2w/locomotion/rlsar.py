"""Policies in rl_sar's layout (fan-ziqi/rl_sar, policy/ROBOT/NAME): `config.yaml` over `base.yaml`, here or one folder
up."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hal.limbs import MOTORS
from hal.robots.go2w.locomotion.description import OLDEST_FRAME, Action, Description, History, Term
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.robots.go2w.locomotion.yamlfile import first_error, read_yaml

OBSERVATIONS = ("ang_vel", "gravity_vec", "commands", "dof_pos", "dof_vel", "actions")
FRAME_LENGTH = 57
"""Numbers of these for sixteen joints."""
_TERMS = dict(zip(OBSERVATIONS, ("gyro", "gravity", "command", "angles", "speeds", "action"), strict=True))
_LISTS = (
    "clip_actions_lower",
    "clip_actions_upper",
    "rl_kp",
    "rl_kd",
    "action_scale",
    "default_dof_pos",
    "joint_mapping",
)


class PolicyParams(BaseModel):
    """What config.yaml says, one number per joint in the policy's order; keys that do not matter here are left out.
    Files of ours (`hal.robots.go2w.locomotion.weights`) hold the same."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    model_name: str = "policy.pt"
    observations: tuple[str, ...] = OBSERVATIONS
    observations_history: tuple[int, ...] = ()
    """Ages [policy steps] of the frames of an observation; empty: the newest alone."""
    observations_history_priority: Literal["time", "term"] = "time"
    num_observations: int = FRAME_LENGTH
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
    """Motor of the SDK of each joint of the policy."""
    dt: float = Field(0.005, gt=0.0)
    """Motor period [s], from base.yaml."""
    decimation: int = Field(4, ge=1)
    """Motor periods per policy step, from base.yaml."""

    @model_validator(mode="after")
    def _fits(self) -> PolicyParams:
        n = len(self.joint_mapping)
        for name in _LISTS:
            values = getattr(self, name)
            if len(values) != n or not np.isfinite(values).all():
                raise ValueError(f"{name} must hold {n} numbers, one per motor")
        if not set(self.joint_mapping) <= set(range(len(MOTORS))):
            raise ValueError(f"joint_mapping must name motors 0 to {len(MOTORS) - 1}")
        unknown = [name for name in self.observations if name not in _TERMS]
        if unknown or not self.observations:
            raise ValueError(f"observations: {', '.join(unknown)}: there is {', '.join(OBSERVATIONS)}")
        size = sum(3 if name in OBSERVATIONS[:3] else n for name in self.observations)
        if self.num_observations != size:
            raise ValueError(
                f"observations are {size} numbers, num_observations says {self.num_observations}"
            )
        wheels = tuple(k for k, motor in enumerate(self.joint_mapping) if motor >= 12)
        if self.wheel_indices != wheels:
            raise ValueError(f"wheel_indices must be {wheels}, the wheels of joint_mapping")
        if any(not 0 <= age <= OLDEST_FRAME for age in self.ages) or len(set(self.ages)) != len(self.ages):
            raise ValueError(f"observations_history: ages from 0 to {OLDEST_FRAME}, each once")
        return self

    @property
    def ages(self) -> tuple[int, ...]:
        """Of the frames of an observation [policy steps]."""
        return self.observations_history or (0,)

    def described(self) -> Description:
        """The same in our own words. Raises pydantic's ValidationError."""
        scales: dict[str, Any] = {
            "ang_vel": self.ang_vel_scale,
            "gravity_vec": 1.0,
            "commands": self.commands_scale,
            "dof_pos": self.dof_pos_scale,
            "dof_vel": self.dof_vel_scale,
            "actions": self.actions_scale,
        }
        order = "frame" if self.observations_history_priority == "time" else "term"
        return Description(
            network=self.model_name,
            period=self.dt * self.decimation,
            motor_period=self.dt,
            joints=tuple(MOTORS[motor] for motor in self.joint_mapping),
            stand=self.default_dof_pos,
            kp=self.rl_kp,
            kd=self.rl_kd,
            action=Action(scale=self.action_scale, clip=(self.clip_actions_lower, self.clip_actions_upper)),
            history=History(ages=self.ages, order=order),
            observation=tuple(
                Term(term=_TERMS[name], scale=scales[name], clip=_before(self.clip_obs, scales[name]))
                for name in self.observations
            ),
        )


def _before(clip: float, scale: Any) -> Any:
    """Limits before scaling of what rl_sar clips after it."""
    limit = clip / np.maximum(np.abs(np.asarray(scale, float)), 1e-9)
    values = tuple(limit.tolist()) if limit.ndim else float(limit)
    lower = tuple((-limit).tolist()) if limit.ndim else -float(limit)
    return lower, values


def load_params(folder: Path) -> PolicyParams:
    """config.yaml over base.yaml. Raises PolicyError."""
    values: dict[str, Any] = {}
    for path, needed in (
        (folder / "base.yaml", False),
        (folder.parent / "base.yaml", False),
        (folder / "config.yaml", True),
    ):
        if not path.is_file() and not needed:
            continue
        tree = read_yaml(path)
        # One group named after the robot, e.g. `go2w/robot_lab:`.
        inner = next(iter(tree.values())) if len(tree) == 1 else tree
        if not isinstance(inner, dict):
            raise PolicyError(f"{path} must hold one group of `key: value` lines")
        values |= inner
    try:
        return PolicyParams.model_validate(values)
    except ValidationError as error:
        raise PolicyError(f"{folder / 'config.yaml'}: {first_error(error)}") from error
