"""What a learnt policy sees and what its outputs mean: `policy.yaml` beside a network, and what rl_sar's and
unitree_rl_lab's files are read into.

    network: policy.onnx            # or policy.pt, in this folder
    period: 0.02                    # [s] between two outputs
    joints: [FR_hip, FR_thigh, ...] # in the policy's order; left out: that of hal.limbs.MOTORS
    stand: [0.0, 0.8, -1.5, ...]    # angles that outputs and observed angles count from [rad]
    kp: 20.0                        # of the legs' joints [Nm/rad]; wheels have none
    kd: 0.5                         # [Nms/rad]
    action: {scale: 0.25, clip: [-100, 100]}
    history: {ages: [0, 1, 2], order: frame}
    observation:
      - {term: gyro, scale: 0.25}
      - {term: heights, offset: 0.5, clip: [-1, 1], unknown: 0.5, x: [-0.8, 0.8, 17], y: [-0.5, 0.5, 11]}

One number stands for as many as are needed. A term is clipped, then scaled. Ages are policy steps, 0 is now; `order:
frame` is one whole observation after the other, `order: term` each term with all its ages. Joints that a policy does
not name must be wheels: those are braked.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hal.limbs import MOTORS
from hal.types import Array

_CHECKED = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

OLDEST_FRAME = 99
"""Oldest frame that may be asked for [policy steps]."""
MOST_SEEN = 20_000
"""Numbers of an observation with its history."""
MOST_PLACES = 1_000
"""Places whose heights may be asked for."""
MOTOR_PERIOD = 0.005
"""[s] at which a policy's gains act where nothing else is said; the nearest divisor of its period."""

Numbers = float | tuple[float, ...]
TERMS = {
    "gyro": "turning rates [rad/s], base_link",
    "gravity": "direction of gravity in base_link",
    "command": "vx, vy [m/s], wz [rad/s]",
    "angles": "joint angles less `stand` [rad], wheels zero",
    "speeds": "joint speeds [rad/s]",
    "action": "the output before",
    "heights": "base_link above the ground at places in the heading frame, less `offset` [m]",
}
"""What a policy may be shown, in the units before `scale`."""
ABSENT = {
    "lin_vel": "no sensor at the motors measures the speed of the body: train without it",
    "base_lin_vel": "no sensor at the motors measures the speed of the body: train without it",
}
"""Known terms that nobody can fill, and why."""


class Term(BaseModel):
    """One part of the observation."""

    model_config = _CHECKED

    term: str
    scale: Numbers = 1.0
    clip: tuple[Numbers, Numbers] | None = Field(None, description="before scaling")
    ages: tuple[int, ...] | None = Field(None, description="of this term alone; None: those of `history`")
    offset: float = Field(0.0, description="of `heights` [m]")
    unknown: float | None = Field(
        None, description="of `heights`: what a place counts as that is not known, base_link above it [m]"
    )
    x: tuple[float, float, int] | None = Field(
        None, description="of `heights`: first, last, count [m], forward"
    )
    y: tuple[float, float, int] | None = Field(None, description="the same to the left")

    @model_validator(mode="after")
    def _known(self) -> Term:
        if self.term in ABSENT:
            raise ValueError(f"{self.term}: {ABSENT[self.term]}")
        if self.term not in TERMS:
            raise ValueError(f"unknown term {self.term!r}: there is {', '.join(TERMS)}")
        if any((self.term == "heights") != (v is not None) for v in (self.x, self.y, self.unknown)):
            raise ValueError(
                "heights, and they alone, need x and y: [first, last, count], and unknown: "
                "what a place counts as that is not known, base_link above it [m]"
            )
        if self.x is not None and self.y is not None:
            counts = (self.x[2], self.y[2])
            if min(counts) < 1 or counts[0] * counts[1] > MOST_PLACES:
                raise ValueError(f"heights of {counts[0]} x {counts[1]} places: 1 to {MOST_PLACES} are read")
        return self

    def places(self) -> Array:
        """(n, 2) of the heights [m] in the heading frame, x fastest; none for another term."""
        if self.x is None or self.y is None:
            return np.empty((0, 2))
        x, y = np.linspace(*self.x), np.linspace(*self.y)
        return np.stack([np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)


class Action(BaseModel):
    """What the outputs mean: leg joints turn to `stand` + scale x output [rad], wheels at scale x output [rad/s]."""

    model_config = _CHECKED

    scale: Numbers
    clip: tuple[Numbers, Numbers] = Field((-100.0, 100.0), description="of the outputs, also as observed")
    targets: tuple[Numbers, Numbers] | None = Field(None, description="limits of what they turn into")
    offset: Numbers | None = Field(None, description="None: `stand`, and 0 for wheels")


class History(BaseModel):
    """Older observations that a policy sees with the newest."""

    model_config = _CHECKED

    ages: tuple[int, ...] = (0,)
    order: Literal["frame", "term"] = "frame"


class Description(BaseModel):
    """Everything about a policy but its network. Raises pydantic's ValidationError."""

    model_config = _CHECKED

    network: str = Field("policy.onnx", description="file in the folder of the description")
    period: float = Field(0.02, ge=0.001, le=0.2)
    motor_period: float | None = Field(None, ge=0.0005, le=0.2, description="[s]")
    joints: tuple[str, ...] = MOTORS
    stand: tuple[float, ...]
    kp: Numbers
    kd: Numbers
    action: Action
    history: History = History()
    observation: tuple[Term, ...] = Field(min_length=1, max_length=32)

    @model_validator(mode="after")
    def _fits(self) -> Description:
        joints, n = self.joints, len(self.joints)
        unknown = [name for name in joints if name not in MOTORS]
        if unknown or len(set(joints)) != n:
            raise ValueError(
                f"joints: {', '.join(unknown) or 'one stands twice'}; there are {', '.join(MOTORS)}, each once"
            )
        if left := [name for name in MOTORS if name not in joints and not name.endswith("_wheel")]:
            raise ValueError(f"joints: {', '.join(left)} would hang free: a policy moves all legs")
        if len(self.stand) != n:
            raise ValueError(f"stand must hold {n} numbers, one per joint, not {len(self.stand)}")
        scale, offset = self.action.scale, self.action.offset
        sizes = {"kp": self.kp, "kd": self.kd, "action.scale": scale, "action.offset": offset or 0.0}
        for name, values in sizes.items():
            _sized(name, values, n)
        for name, limits in (("action.clip", self.action.clip), ("action.targets", self.action.targets)):
            _limits(name, limits, n)
        for gains in (self.kp, self.kd):
            if np.any(np.asarray(gains) < 0.0):
                raise ValueError("kp and kd are not negative")
        total = 0
        for term in self.observation:
            size = self.size(term)
            _sized(f"{term.term}.scale", term.scale, size)
            _limits(f"{term.term}.clip", term.clip, size)
            ages = self.ages(term)
            if not ages or len(set(ages)) != len(ages) or min(ages) < 0 or max(ages) > OLDEST_FRAME:
                raise ValueError(f"{term.term}: ages are from 0 to {OLDEST_FRAME}, each once")
            if self.history.order == "frame" and ages != self.history.ages:
                raise ValueError(f"{term.term}: ages of one term alone need `order: term`")
            total += size * len(ages)
        names = [term.term for term in self.observation]
        if len(set(names)) != len(names):
            raise ValueError("observation: each term once")
        if total > MOST_SEEN:
            raise ValueError(f"an observation of {total} numbers: at most {MOST_SEEN} are read")
        return self

    @property
    def every(self) -> int:
        """Motor periods per output."""
        return max(1, round(self.period / (self.motor_period or MOTOR_PERIOD)))

    def size(self, term: Term) -> int:
        """Numbers of one term of one age."""
        if term.term in ("gyro", "gravity", "command"):
            return 3
        return len(term.places()) if term.term == "heights" else len(self.joints)

    def ages(self, term: Term) -> tuple[int, ...]:
        """Of a term [policy steps]."""
        return self.history.ages if term.ages is None else term.ages

    @property
    def seen(self) -> int:
        """Numbers of an observation with its history."""
        return sum(self.size(term) * len(self.ages(term)) for term in self.observation)


def _sized(name: str, values: Numbers, n: int) -> None:
    if isinstance(values, Sequence) and len(values) != n:
        raise ValueError(f"{name} must be one number or {n} numbers, not {len(values)}")


def _limits(name: str, limits: tuple[Numbers, Numbers] | None, n: int) -> None:
    if limits is None:
        return
    for values in limits:
        _sized(name, values, n)
    low, high = (np.asarray(values, float) for values in limits)
    if not np.all(low <= high):
        raise ValueError(f"{name}: the lower limit is above the upper one")
