"""Kernels of the inertial filter: prediction, velocity update, and a run over a batch of samples. State: see
`mapping.odometry.inertial`."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.rotation import rotation, turn
from hal.types import GRAVITY, Array

MAX_STEP = 0.05
"""An inertial gap longer than this [s] is bridged at constant velocity with a large uncertainty."""
SILENCE_TIME = 500_000_000
"""A stretch [ns] without inertial and wheel samples in which the body is taken to have come to rest:"""
COASTED_WAY, UNSURE_SPEED, COASTED_TURN = 0.2, 0.5, 0.2
"""how far it may have gone [m], how fast it may be after all [m/s], and turned about its z axis [rad], one standard
deviation."""


@njit(cache=True)
def propagate(x: Array, p: Array, u: Array, dt: float, noise: Array) -> None:
    """Advance mean and covariance in place by `dt` [s] with input u (6,) gyro, specific force, constant over the step.

    `noise` (4,): densities gyro, accel, gyro bias, accel bias. Steps beyond MAX_STEP keep the velocity.
    """
    gap = dt > MAX_STEP
    q = x[6:10]
    rot = rotation(q)
    wx, wy, wz = u[0] - x[10], u[1] - x[11], u[2] - x[12]
    fx, fy, fz = u[3] - x[13], u[4] - x[14], u[5] - x[15]
    if gap:  # nothing measured: no acceleration
        fx, fy, fz = GRAVITY * rot[2, 0], GRAVITY * rot[2, 1], GRAVITY * rot[2, 2]
    # Specific force turned into the middle of the step.
    hx, hy, hz = 0.5 * dt * wx, 0.5 * dt * wy, 0.5 * dt * wz
    mx, my, mz = fx + hy * fz - hz * fy, fy + hz * fx - hx * fz, fz + hx * fy - hy * fx
    for i in range(3):
        a = rot[i, 0] * mx + rot[i, 1] * my + rot[i, 2] * mz
        if i == 2:
            a -= GRAVITY
        x[i] += x[3 + i] * dt + 0.5 * a * dt * dt
        x[3 + i] += a * dt
    turn(q, wx * dt, wy * dt, wz * dt)

    f = np.eye(15)
    for i in range(3):
        f[i, 3 + i] = dt
        f[6 + i, 9 + i] = -dt
        f[3 + i, 6] = -(rot[i, 1] * fz - rot[i, 2] * fy) * dt
        f[3 + i, 7] = -(rot[i, 2] * fx - rot[i, 0] * fz) * dt
        f[3 + i, 8] = -(rot[i, 0] * fy - rot[i, 1] * fx) * dt
        for j in range(3):
            f[3 + i, 12 + j] = -rot[i, j] * dt
    f[6, 7], f[6, 8] = wz * dt, -wy * dt
    f[7, 6], f[7, 8] = -wz * dt, wx * dt
    f[8, 6], f[8, 7] = wy * dt, -wx * dt
    fp = np.zeros((15, 15))
    for i in range(15):
        for k in range(15):
            if f[i, k] != 0.0:
                for j in range(15):
                    fp[i, j] += f[i, k] * p[k, j]
    for i in range(15):
        for j in range(i + 1):
            s = 0.0
            for k in range(15):
                s += fp[i, k] * f[j, k]
            p[i, j] = s
            p[j, i] = s
    gyro, accel = noise[0] ** 2 * dt, noise[1] ** 2 * dt
    if gap:
        gyro, accel = gyro + (0.5 * dt) ** 2, accel + (1.0 * dt) ** 2
    for i in range(3):
        p[i, i] += 0.25 * accel * dt * dt
        p[3 + i, 3 + i] += accel
        p[6 + i, 6 + i] += gyro
        p[9 + i, 9 + i] += noise[2] ** 2 * dt
        p[12 + i, 12 + i] += noise[3] ** 2 * dt


@njit(cache=True)
def correct(x: Array, dx: Array) -> None:
    """Apply the error state dx (15,) to x (16,) in place."""
    for i in range(6):
        x[i] += dx[i]
    turn(x[6:10], dx[6], dx[7], dx[8])
    for i in range(6):
        x[10 + i] += dx[9 + i]


@njit(cache=True)
def update_velocity(x: Array, p: Array, velocity: Array, sigma: Array, gate: float) -> int:
    """Three scalar updates with a velocity of the IMU point in base_link axes [m/s].

    A component more than `gate` standard deviations off (slip, a spinning wheel) is left out. Returns how many were
    used."""
    used = 0
    h = np.zeros(15)
    ph = np.empty(15)
    dx = np.empty(15)
    for i in range(3):
        rot = rotation(x[6:10])
        b0 = rot[0, 0] * x[3] + rot[1, 0] * x[4] + rot[2, 0] * x[5]
        b1 = rot[0, 1] * x[3] + rot[1, 1] * x[4] + rot[2, 1] * x[5]
        b2 = rot[0, 2] * x[3] + rot[1, 2] * x[4] + rot[2, 2] * x[5]
        for j in range(3):
            h[3 + j] = rot[j, i]
        if i == 0:
            predicted = b0
            h[6], h[7], h[8] = 0.0, -b2, b1
        elif i == 1:
            predicted = b1
            h[6], h[7], h[8] = b2, 0.0, -b0
        else:
            predicted = b2
            h[6], h[7], h[8] = -b1, b0, 0.0
        s = sigma[i] * sigma[i]
        for j in range(15):
            acc = 0.0
            for k in range(3, 9):
                acc += p[j, k] * h[k]
            ph[j] = acc
        for k in range(3, 9):
            s += h[k] * ph[k]
        r = velocity[i] - predicted
        if not (r * r <= gate * gate * s):
            continue
        used += 1
        for j in range(15):
            dx[j] = ph[j] * r / s
        for j in range(15):
            for k in range(15):
                p[j, k] -= ph[j] * ph[k] / s
        correct(x, dx)
    return used


@njit(cache=True)
def settle(x: Array, p: Array) -> None:
    """Time has passed unseen: the body rests about where it was."""
    x[3:6] = 0.0
    for k in range(3):
        p[k, k] += COASTED_WAY**2
        p[3 + k, 3 + k] += UNSURE_SPEED**2
    p[8, 8] += COASTED_TURN**2


@njit(cache=True)
def _keep(track: Array, row: int, x: Array) -> None:
    for k in range(track.shape[1]):
        track[row, k] = x[k]


@njit(cache=True)
def run(
    x: Array,
    p: Array,
    u: Array,
    start: int,
    end: int,
    imu_stamp: NDArray[np.int64],
    imu: Array,
    wheel_stamp: NDArray[np.int64],
    wheel: Array,
    wheel_sigma: Array,
    noise: Array,
    gate: float,
    track_stamp: NDArray[np.int64],
    track: Array,
) -> int:
    """Advance x, p and the input u (6,) from `start` to `end` [ns] over the samples in between, in stamp order.

    `imu_stamp` (n,) int64 ascending > start, the last one may lie beyond `end` (it is interpolated); `imu` (n, 6);
    `wheel_stamp` (m,), `wheel` (m, 3), `wheel_sigma` (m, 3): velocities, each applied at the first step end at or
    after its stamp. Poses x[:10] after every step go to `track_stamp` (k,), `track` (k, 10). Returns rows written to
    the track.

    Over more than `SILENCE_TIME` without any sample nothing is integrated: a body that nobody hears is not commanded
    and comes to rest, so the pose stays, with room for what it coasted."""
    now = start
    w = 0
    rows = 0
    mid = np.empty(6)
    n = len(imu_stamp)
    track_stamp[rows] = now
    _keep(track, rows, x)
    rows += 1
    i = 0
    while now < end:
        if i < n:
            stop = min(imu_stamp[i], end)
            share = (stop - now) / (imu_stamp[i] - now)
        else:  # no sample beyond: hold the input
            stop = end
            share = 0.0
        heard = now
        for j in range(w, len(wheel_stamp)):
            if wheel_stamp[j] < stop:
                heard = max(heard, wheel_stamp[j])
        if stop - heard > SILENCE_TIME:
            for k in range(6):
                u[k] = imu[i, k] if i < n else (x[10 + k] if k < 3 else u[k])
            settle(x, p)
        else:
            dt = (stop - now) * 1e-9
            for k in range(6):
                after = u[k] + share * (imu[i, k] - u[k]) if i < n else u[k]
                mid[k] = 0.5 * (u[k] + after)
                u[k] = after
            propagate(x, p, mid, dt, noise)
        now = stop
        if i < n and imu_stamp[i] <= now:
            i += 1
        while w < len(wheel_stamp) and wheel_stamp[w] <= now:
            update_velocity(x, p, wheel[w], wheel_sigma[w], gate)
            w += 1
        if rows < len(track_stamp):
            track_stamp[rows] = now
            _keep(track, rows, x)
            rows += 1
        else:  # never more rows than samples; the last one is the end
            track_stamp[rows - 1] = now
            _keep(track, rows - 1, x)
    return rows


@njit(cache=True)
def output(x: Array, p: Array, u: Array, lever: Array, offset: Array, out: Array, covariance: Array) -> None:
    """State of base_link from the state of the IMU at `lever` (3,) in base_link.

    `offset` (6,): position in `odom` [m] and small rotation in base_link [rad] to add. `out` (13,): position,
    orientation x y z w, linear and angular velocity in base_link; `covariance` (6, 6): position in `odom`, rotation
    about the axes of `odom`."""
    q = x[6:10].copy()
    turn(q, offset[3], offset[4], offset[5])
    rot = rotation(q)
    arm = np.empty(3)
    for i in range(3):
        arm[i] = rot[i, 0] * lever[0] + rot[i, 1] * lever[1] + rot[i, 2] * lever[2]
        out[i] = x[i] + offset[i] - arm[i]
        out[10 + i] = u[i] - x[10 + i]
    sign = -1.0 if q[3] < 0.0 else 1.0
    for i in range(4):
        out[3 + i] = sign * q[i]
    w0, w1, w2 = out[10], out[11], out[12]
    for i in range(3):
        out[7 + i] = rot[0, i] * x[3] + rot[1, i] * x[4] + rot[2, i] * x[5]
    out[7] -= w1 * lever[2] - w2 * lever[1]
    out[8] -= w2 * lever[0] - w0 * lever[2]
    out[9] -= w0 * lever[1] - w1 * lever[0]
    # d position = d p + [arm]x d theta_odom, d theta_odom = R d theta.
    t = np.zeros((6, 6))
    for j in range(3):
        r0, r1, r2 = rot[0, j], rot[1, j], rot[2, j]
        t[j, j] = 1.0
        t[3, 3 + j], t[4, 3 + j], t[5, 3 + j] = r0, r1, r2
        t[0, 3 + j] = arm[1] * r2 - arm[2] * r1
        t[1, 3 + j] = arm[2] * r0 - arm[0] * r2
        t[2, 3 + j] = arm[0] * r1 - arm[1] * r0
    half = np.zeros((6, 6))
    for i in range(6):
        for k in range(6):
            if t[i, k] != 0.0:
                for j in range(6):
                    half[i, j] += t[i, k] * p[k + (3 if k > 2 else 0), j + (3 if j > 2 else 0)]
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(6):
                total += half[i, k] * t[j, k]
            covariance[i, j] = total
            covariance[j, i] = total
