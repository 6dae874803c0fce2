"""The joint-level interface between a locomotion controller and a robot, shaped like the SDK's LowState/LowCmd.

Arrays are (16,) float64 in SDK motor order (`hal.limbs.MOTORS`): FR hip, thigh, calf; FL; RR; RL; wheels FR, FL, RR,
RL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from hal.types import Array, PostureCommand, VelocityCommand


@dataclass(slots=True)
class LowState:
    """What the motors and the IMU report at one control tick."""

    time: float
    """Source clock [s]."""
    q: Array
    """(16,) joint positions [rad]."""
    dq: Array
    """(16,) joint velocities [rad/s]."""
    tau: Array
    """(16,) estimated joint torques [Nm]."""
    quaternion: Array
    """(4,) w, x, y, z: gravity-aligned world <- base_link (heading arbitrary), from the IMU's attitude filter."""
    gyro: Array
    """(3,) [rad/s], base_link."""
    accel: Array
    """(3,) specific force [m/s^2], base_link."""


@dataclass(slots=True)
class LowCommand:
    """Per motor: torque = tau + kp (q - q_measured) + kd (dq - dq_measured), clipped by the motor."""

    q: Array
    dq: Array
    tau: Array
    kp: Array
    kd: Array


class Locomotion(Protocol):
    """Turns body velocity into joint commands. Deterministic; no wall clock, no I/O."""

    period: float
    """Control period [s]; the host calls `step` at this rate of the source clock."""

    def reset(self) -> None:
        """Forget all state: the robot was moved, stood up or fell."""

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One control tick. The returned arrays are owned by the controller and valid until the next call."""

    def warning(self) -> str:
        """Why it does not drive as commanded, in words for the operator; empty when it does."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground around a robot, as its map has it."""

    above: Array
    """(m,) base_link above the ground [m] at the places that were asked for; NaN: not known."""
    lacks: str
    """Why it is not known, in words; empty where it is."""


@runtime_checkable
class Sighted(Protocol):
    """A controller that wants to see the ground, and a backend that passes it on."""

    places: Array
    """(m, 2) where [m] in the heading frame about base_link: x forward, y left; none for a blind one."""

    def see(self, ground: Ground) -> None:
        """Until the next call. What is not known counts as the controller says."""
