"""The motion of a synthetic run: where base_link is at any instant, and what the legs do below it.

Everything is a smooth closed-form function of time, so that inertial samples follow by differentiation and truth can
be asked for at any stamp.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians
from typing import Literal

import numpy as np

from hal.robots.go2w.facts import (
    CALF,
    HIP_X,
    HIP_Y,
    IMU_POSITION,
    SIGN_X,
    SIGN_Y,
    THIGH,
    THIGH_Y,
    TREAD_Y,
    WHEEL_RADIUS,
)
from hal.rotation import rotation_rpy
from hal.types import GRAVITY, Array

Kind = Literal["figure_eight", "straight", "standstill"]

EIGHT_EXTENTS = (3.2, 1.5)
"""Half extents of the figure-eight along x and y [m]."""
RAMP_TIME = 1.0
"""Seconds to get from rest to full motion and back."""


@dataclass(frozen=True, slots=True)
class Motion:
    """A path and the shaking of the trunk on it. Times [s] count from the start of the run."""

    kind: Kind = "figure_eight"
    speed: float = 0.41
    """Mean speed [m/s]."""
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x, y [m], yaw [rad] for `straight` and `standstill`; the figure-eight crosses the origin."""
    rest: float = 1.0
    """Standing still first [s]."""
    stop: float = np.inf
    """Coming to rest again from here on [s]."""
    height: float = 0.40
    """Mean height of base_link above the ground [m]."""
    pitch: float = radians(10.0)
    """Amplitude [rad]."""
    pitch_rate: float = 0.7
    """[Hz]."""
    roll: float = radians(4.0)
    roll_rate: float = 1.1
    bob: float = 0.02
    """Amplitude of the vertical motion [m]."""
    bob_rate: float = 1.4

    def _share(self, t: Array) -> Array:
        """0 at rest, 1 in motion, C2."""
        return _step((t - self.rest) / RAMP_TIME) - _step((t - self.stop) / RAMP_TIME)

    def travelled(self, t: Array) -> Array:
        """Distance [m] a point at mean speed has gone by t (n,) [s]."""
        if self.kind == "standstill":
            return np.zeros_like(t)
        return (
            self.speed
            * RAMP_TIME
            * (_step_integral((t - self.rest) / RAMP_TIME) - _step_integral((t - self.stop) / RAMP_TIME))
        )

    def planar(self, t: Array) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] at t (n,) [s]."""
        s = self.travelled(t)
        if self.kind != "figure_eight":
            x, y, yaw = self.start
            return x + s * np.cos(yaw), y + s * np.sin(yaw), np.full_like(t, yaw)
        a, b = EIGHT_EXTENTS
        phase = 2.0 * pi * s / eight_length()
        heading = np.arctan2(2.0 * b * np.cos(2.0 * phase), a * np.cos(phase))
        return a * np.sin(phase), b * np.sin(2.0 * phase), heading

    def attitude(self, t: Array) -> tuple[Array, Array, Array]:
        """Roll, pitch [rad] and height [m] of base_link above the ground at t (n,) [s]."""
        share = np.zeros_like(t) if self.kind == "standstill" else self._share(t)
        return (
            share * self.roll * np.sin(2.0 * pi * self.roll_rate * t),
            share * self.pitch * np.sin(2.0 * pi * self.pitch_rate * t),
            self.height + share * self.bob * np.sin(2.0 * pi * self.bob_rate * t),
        )

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Position (n, 3) [m] and rotation (n, 3, 3) world <- base_link at t (n,) [s]; level ground at z = 0."""
        x, y, yaw = self.planar(t)
        roll, pitch, z = self.attitude(t)
        return np.stack([x, y, z], axis=-1), rotation_rpy(roll, pitch, yaw)

    def twist(self, t: Array) -> tuple[Array, Array]:
        """Linear velocity (n, 3) [m/s] and angular velocity (n, 3) [rad/s] of base_link, both in base_link."""
        d = 1e-4
        p0, r0 = self.pose(t - d)
        p1, r1 = self.pose(t + d)
        r = self.pose(t)[1]
        skew = np.einsum("nji,njk->nik", r, r1 - r0) / (2.0 * d)
        angular = 0.5 * np.stack(
            [skew[:, 2, 1] - skew[:, 1, 2], skew[:, 0, 2] - skew[:, 2, 0], skew[:, 1, 0] - skew[:, 0, 1]],
            axis=-1,
        )
        return np.einsum("nji,nj->ni", r, (p1 - p0) / (2.0 * d)), angular

    def specific_force(self, t: Array) -> Array:
        """(n, 3) [m/s^2] at the IMU, base_link axes."""
        d = 1e-3
        lever = np.asarray(IMU_POSITION)
        at = [p + r @ lever for p, r in (self.pose(t - d), self.pose(t), self.pose(t + d))]
        acceleration = (at[0] - 2.0 * at[1] + at[2]) / d**2 + np.array([0.0, 0.0, GRAVITY])
        return np.einsum("nji,nj->ni", self.pose(t)[1], acceleration)


def _step(u: Array) -> Array:
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 + u * (6.0 * u - 15.0))


def _step_integral(u: Array) -> Array:
    v = np.clip(u, 0.0, 1.0)
    return np.where(u > 1.0, u - 0.5, v**4 * (2.5 + v * (v - 3.0)))


def eight_length() -> float:
    """Length of one round of the figure-eight [m]."""
    a, b = EIGHT_EXTENTS
    phase = np.linspace(0.0, 2.0 * pi, 2000, endpoint=False)
    return float(np.hypot(a * np.cos(phase), 2.0 * b * np.cos(2.0 * phase)).mean() * 2.0 * pi)


def quaternions(rotation: Array) -> Array:
    """(n, 4) x, y, z, w of rotations (n, 3, 3), w >= 0; attitudes short of a half turn about x or y only."""
    r = rotation
    w = 0.5 * np.sqrt(np.maximum(1.0 + r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2], 0.0))
    z = 0.5 * np.sqrt(np.maximum(1.0 - r[:, 0, 0] - r[:, 1, 1] + r[:, 2, 2], 0.0))
    z = np.where(r[:, 1, 0] < r[:, 0, 1], -z, z)
    # For upright trunks w and z are never both small; divide by the larger one.
    big = np.maximum(w, np.abs(z))
    by_w = w >= np.abs(z)
    x = np.where(by_w, r[:, 2, 1] - r[:, 1, 2], (r[:, 0, 2] + r[:, 2, 0]) * np.sign(z)) / (4.0 * big)
    y = np.where(by_w, r[:, 0, 2] - r[:, 2, 0], (r[:, 1, 2] + r[:, 2, 1]) * np.sign(z)) / (4.0 * big)
    q = np.stack([x, y, z, w], axis=-1)
    return q / np.linalg.norm(q, axis=1)[:, None]


# --- legs ---------------------------------------------------------------------------------------------------------
STANCE = np.stack([HIP_X * SIGN_X, (HIP_Y + THIGH_Y + TREAD_Y) * SIGN_Y], axis=-1)
"""(4, 2) wheel centres in the heading frame below base_link [m]: below the hips."""


def leg_angles(centres: Array) -> Array:
    """Joint angles (n, 12) [rad] that put the wheel centres at (n, 4, 3) [m], base_link, SDK order.

    Inverse of `hal.robots.go2w.facts.wheel_centres` with the knee bent backwards. Raises ValueError out of reach.
    """
    offset = (THIGH_Y + TREAD_Y) * SIGN_Y
    x = centres[..., 0] - HIP_X * SIGN_X
    y = centres[..., 1] - HIP_Y * SIGN_Y
    z = centres[..., 2]
    below = y**2 + z**2 - offset**2
    reach = x**2 + below
    bend = (reach - THIGH**2 - CALF**2) / (2.0 * THIGH * CALF)
    if (below <= 0.0).any() or (np.abs(bend) >= 1.0).any():
        raise ValueError("a wheel is out of the leg's reach: lower the trunk or shake it less")
    down = -np.sqrt(below)
    hip = np.arctan2(z, y) - np.arctan2(down, offset)
    calf = -np.arccos(bend)
    thigh = np.arctan2(-x, -down) - np.arctan2(CALF * np.sin(calf), THIGH + CALF * np.cos(calf))
    hip = (hip + pi) % (2.0 * pi) - pi
    return np.stack([hip, thigh, calf], axis=-1).reshape(len(centres), 12)


@dataclass(frozen=True, slots=True)
class Legs:
    """Leg joints and wheels of a run, one row per instant."""

    position: Array
    """(n, 12) [rad], SDK order."""
    velocity: Array
    """(n, 12) [rad/s]."""
    spin: Array
    """(n, 4) wheel joint rates for rolling without slip along the heading [rad/s]."""
    ground_speed: Array
    """(n, 4) speed of each wheel over the ground along the heading [m/s]."""


def legs(motion: Motion, t: Array) -> Legs:
    """What the joints do at t (n,) [s] so that the wheels stay on the ground below the hips while the trunk shakes."""
    d = 1e-4
    before, here, after = (_stand(motion, u) for u in (t - d, t, t + d))
    q = here[1]
    dq = (after[1] - before[1]) / (2.0 * d)
    velocity = (after[0] - before[0]) / (2.0 * d)  # wheel centres in the world, (n, 4, 3)
    rotation = motion.pose(t)[1]
    angular = motion.twist(t)[1]
    yaw = motion.planar(t)[2]
    hip, dhip = q[:, 0::3], dq[:, 0::3]
    zero = np.zeros_like(hip)
    axle = np.einsum("nij,nlj->nli", rotation, np.stack([zero, np.cos(hip), np.sin(hip)], axis=-1))
    # Trunk and hip rotation turn the wheel, too; the rest comes from thigh, calf and wheel joint about the axle.
    carried = angular[:, None, :] + np.stack([dhip, zero, zero], axis=-1)
    carried = np.einsum("nij,nlj->nli", rotation, carried)
    contact = _contact(axle)
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)[:, None, :]
    ground = np.sum(velocity * forward, axis=-1)
    dragged = np.sum((velocity + np.cross(carried, contact)) * forward, axis=-1)
    lever = np.sum(np.cross(axle, contact) * forward, axis=-1)  # about -WHEEL_RADIUS
    spin = -dragged / lever - dq[:, 1::3] - dq[:, 2::3]
    return Legs(q, dq, spin, ground)


def _contact(axle: Array) -> Array:
    """(n, 4, 3) from wheel centre to the point on the ground, for axles (n, 4, 3) in the world."""
    down = np.array([0.0, 0.0, -1.0]) + axle[..., 2:3] * axle
    return WHEEL_RADIUS * down / np.linalg.norm(down, axis=-1, keepdims=True)


def _stand(motion: Motion, t: Array) -> tuple[Array, Array]:
    """Wheel centres in the world (n, 4, 3) and leg angles (n, 12)."""
    x, y, yaw = motion.planar(t)
    position, rotation = motion.pose(t)
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    centre = np.empty((len(t), 4, 3))
    centre[..., 0] = x[:, None] + c * STANCE[:, 0] - s * STANCE[:, 1]
    centre[..., 1] = y[:, None] + s * STANCE[:, 0] + c * STANCE[:, 1]
    centre[..., 2] = WHEEL_RADIUS
    # A tilted wheel stands a little lower; its tilt follows from the angles, so iterate (converges in two rounds).
    for _ in range(3):
        body = np.einsum("nji,nlj->nli", rotation, centre - position[:, None, :])
        q = leg_angles(body)
        hip = q[:, 0::3]
        axle_z = rotation[:, 2, 1, None] * np.cos(hip) + rotation[:, 2, 2, None] * np.sin(hip)
        centre[..., 2] = WHEEL_RADIUS * np.sqrt(1.0 - axle_z**2)
    return centre, q
