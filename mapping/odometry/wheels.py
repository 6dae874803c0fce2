"""Body velocity from wheel speed, leg kinematics and contact.

A loaded wheel does not slip, so its contact point stands still in the world. That gives one velocity of the trunk per
wheel. Their mean is the measurement; their spread tells how much they slip. In a skid-steered turn the wheels slip
sideways against each other, which the mean cancels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.limbs import Limbs, wheel_centres, wheel_jacobians
from hal.types import Array
from hal.wheel_force import CONTACT_FORCE, axle_force, is_rigid


@dataclass(frozen=True, slots=True)
class WheelOdometry:
    """Wheel-leg-inertial dead reckoning, no LiDAR: drifts, never jumps."""

    stamp: int
    """[ns]"""
    position: Array
    """(3,) base_link in the dead-reckoning frame [m]: the robot's start, gravity-aligned."""
    orientation: Array
    """(4,) x, y, z, w."""
    linear: Array
    """(3,) [m/s], base_link: what the wheels say at this stamp, unfiltered."""
    angular: Array
    """(3,) [rad/s], base_link."""
    covariance: Array
    """(6, 6) of the pose: position [m], rotation [rad], axes of the dead-reckoning frame."""
    contact: tuple[bool, bool, bool, bool]
    """Wheel on ground: FR, FL, RR, RL."""


SPREAD_WEIGHT = 0.25, 0.25, 100.0
"""Weight of the spread of the wheels' velocities, body x, y, z. Ahead and sideways the wheels slip against each
other, and the mean cancels it. Up and down they disagree while some climb a face: their contact is not below them,
and the mean is wrong the same way for a second, 50 samples. Ten drives over kerbs of 20 cm: the height was 25, 22, 21
mm off at most with weights of 25, 100, 400 (mean of the drives); with 0.25 it was 44 mm."""


@njit(cache=True)
def wheel_velocities(
    limbs: Limbs, q: Array, dq: Array, tau: Array, gyro: Array, velocity: Array, height: Array
) -> None:
    """Velocity of base_link [m/s] by each wheel alone, base_link axes, into `velocity` (4, 3); its height above the
    contact [m], along the normal of the plane under the wheels, into `height` (4,). NaN for a wheel that does not
    touch.

    `q`, `dq`, `tau`: (16,) as `hal.limbs.MOTORS`; `gyro` (3,) without bias. If all efforts are exactly zero they are
    not reported: then every wheel counts, as of a robot whose wheels sit on the body."""
    centre = wheel_centres(limbs, q)
    jacobian = wheel_jacobians(limbs, q)
    # Normal of the plane through the wheel centres, from its diagonals FL-RR and FR-RL.
    ax, ay, az = centre[1, 0] - centre[2, 0], centre[1, 1] - centre[2, 1], centre[1, 2] - centre[2, 2]
    bx, by, bz = centre[0, 0] - centre[3, 0], centre[0, 1] - centre[3, 1], centre[0, 2] - centre[3, 2]
    nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length < 1e-6:
        nx, ny, nz, length = 0.0, 0.0, 1.0, 1.0
    if nz < 0.0:
        length = -length
    nx, ny, nz = nx / length, ny / length, nz / length
    reported = False
    for k in range(16):
        reported = reported or (tau[k] != 0.0 and not is_rigid(limbs))
    velocity[:] = np.nan
    height[:] = np.nan
    for leg in range(4):
        j = jacobian[leg]
        if reported:
            fx, fy, fz = axle_force(j, -tau[3 * leg], -tau[3 * leg + 1], -tau[3 * leg + 2])
            if not fx * nx + fy * ny + fz * nz > CONTACT_FORCE:
                continue
        hip = q[3 * leg]
        uy, uz = math.cos(hip), math.sin(hip)  # axle
        along = ny * uy + nz * uz
        gx, gy, gz = nx, ny - along * uy, nz - along * uz
        scale = -limbs.radius / math.sqrt(gx * gx + gy * gy + gz * gz)
        gx, gy, gz = gx * scale, gy * scale, gz * scale  # wheel centre to contact
        spin = dq[3 * leg + 1] + dq[3 * leg + 2] + dq[12 + leg]
        wx, wy, wz = dq[3 * leg] + gyro[0], spin * uy + gyro[1], spin * uz + gyro[2]
        px, py, pz = centre[leg, 0], centre[leg, 1], centre[leg, 2]
        d0, d1, d2 = dq[3 * leg], dq[3 * leg + 1], dq[3 * leg + 2]
        velocity[leg, 0] = -(
            gyro[1] * pz - gyro[2] * py + j[0, 0] * d0 + j[0, 1] * d1 + j[0, 2] * d2 + wy * gz - wz * gy
        )
        velocity[leg, 1] = -(
            gyro[2] * px - gyro[0] * pz + j[1, 0] * d0 + j[1, 1] * d1 + j[1, 2] * d2 + wz * gx - wx * gz
        )
        velocity[leg, 2] = -(
            gyro[0] * py - gyro[1] * px + j[2, 0] * d0 + j[2, 1] * d1 + j[2, 2] * d2 + wx * gy - wy * gx
        )
        height[leg] = -(nx * (px + gx) + ny * (py + gy) + nz * (pz + gz))


@njit(cache=True)
def leg_velocity(
    limbs: Limbs,
    q: Array,
    dq: Array,
    tau: Array,
    gyro: Array,
    noise: Array,
    out: Array,
    sigma: Array,
    contact: NDArray[np.bool_],
) -> float:
    """Velocity of base_link [m/s], base_link axes, into `out` (3,), its standard deviation into `sigma` (3,), contact
    into (4,).

    `q`, `dq`, `tau`, `gyro`: see `wheel_velocities`; `noise` (3,): standard deviation without slip. Returns base_link's
    height above the plane under the wheels [m]; NaN (and infinite sigma) when no wheel touches."""
    each, heights = np.empty((4, 3)), np.empty(4)
    wheel_velocities(limbs, q, dq, tau, gyro, each, heights)
    count = 0
    height = 0.0
    for leg in range(4):
        contact[leg] = not math.isnan(heights[leg])
        if contact[leg]:
            for k in range(3):  # a row at once compiles for 2 s
                each[count, k] = each[leg, k]
            height += heights[leg]
            count += 1
    if count == 0:
        out[:] = 0.0
        sigma[:] = np.inf
        return np.nan
    for k in range(3):
        mean = 0.0
        for i in range(count):
            mean += each[i, k]
        mean /= count
        spread = 0.0
        for i in range(count):
            spread += (each[i, k] - mean) ** 2
        out[k] = mean
        # Fewer wheels: less to average and more likely to slip.
        sigma[k] = math.sqrt(noise[k] * noise[k] * 4.0 / count + SPREAD_WEIGHT[k] * spread / count)
    return height / count


@njit(cache=True)
def velocities(
    limbs: Limbs,
    joint_stamp: NDArray[np.int64],
    joints: Array,
    imu_stamp: NDArray[np.int64],
    imu: Array,
    bias: Array,
    lever: Array,
    noise: Array,
    scale: float,
) -> tuple[Array, Array, Array]:
    """`leg_velocity` for a batch, moved to the IMU.

    `joints` (m, 48): q, dq, tau; `imu` (n, 6) with stamps ascending (the gyro is interpolated); `bias` (3,) of the
    gyro; `lever` (3,) IMU in base_link [m]; `scale`: driven per rolled distance. Returns velocity (m, 3) [m/s], sigma
    (m, 3), height (m,) [m]."""
    m, n = len(joint_stamp), len(imu_stamp)
    out, sigma, height = np.zeros((m, 3)), np.empty((m, 3)), np.empty(m)
    contact = np.empty(4, np.bool_)
    gyro = np.zeros(3)
    i = 0
    for row in range(m):
        t = joint_stamp[row]
        while i < n and imu_stamp[i] < t:
            i += 1
        for k in range(3):
            if n == 0:
                gyro[k] = 0.0
            elif i == 0:
                gyro[k] = imu[0, k] - bias[k]
            elif i == n:
                gyro[k] = imu[n - 1, k] - bias[k]
            else:
                share = (t - imu_stamp[i - 1]) / (imu_stamp[i] - imu_stamp[i - 1])
                gyro[k] = imu[i - 1, k] + share * (imu[i, k] - imu[i - 1, k]) - bias[k]
        j = joints[row]
        height[row] = leg_velocity(
            limbs, j[:16], j[16:32], j[32:], gyro, noise, out[row], sigma[row], contact
        )
        out[row, 0] *= scale
        out[row, 0] += gyro[1] * lever[2] - gyro[2] * lever[1]
        out[row, 1] += gyro[2] * lever[0] - gyro[0] * lever[2]
        out[row, 2] += gyro[0] * lever[1] - gyro[1] * lever[0]
    return out, sigma, height


def ways_of_wheels(limbs: Limbs, joints: Array, gyro: Array, seconds: float) -> Array:
    """(4,) way ahead [m] that each wheel rolled in `seconds`, from joint samples (m, 48) and the mean turn rate
    `gyro` (3,) without bias. A wheel that never touched has the mean of the others; NaN if none did."""
    each, height = np.empty((len(joints), 4, 3)), np.empty(4)
    for row, out in zip(joints, each, strict=True):
        wheel_velocities(limbs, row[:16], row[16:32], row[32:], gyro, out, height)
    ahead, touched = each[:, :, 0], np.isfinite(each[:, :, 0])
    if not touched.any():
        return np.full(4, np.nan)
    total, count = np.where(touched, ahead, 0.0).sum(axis=0), touched.sum(axis=0)
    mean = total.sum() / count.sum()
    return np.where(count > 0, total / np.maximum(count, 1), mean) * seconds
