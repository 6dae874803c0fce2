"""Beam kernels: where a moving sensor shoots, and what it reports of the true ranges."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.types import POINT_QUANTUM, TIME_QUANTUM


@njit(cache=True, nogil=True, error_model="numpy")
def moving_rays(
    beams: NDArray[np.float32],
    time: NDArray[np.int64],
    begin: int,
    end: int,
    p0: NDArray[np.float64],
    q0: NDArray[np.float64],
    p1: NDArray[np.float64],
    q1: NDArray[np.float64],
    mount: NDArray[np.float64],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
) -> None:
    """World origin and direction of beams (n, 3; `base_link` axes) fired at `time` (n,) [ns] between two base poses
    at `begin` and `end`.

    Quaternions are w, x, y, z; `mount` (3,) is the sensor's position in `base_link`. Between the poses position is
    linear and attitude a normalised linear blend, right to 1e-5 rad for steps up to 0.1 rad."""
    sign = 1.0 if q0[0] * q1[0] + q0[1] * q1[1] + q0[2] * q1[2] + q0[3] * q1[3] >= 0.0 else -1.0
    span = float(end - begin)
    for i in range(beams.shape[0]):
        a = (time[i] - begin) / span
        w = (1.0 - a) * q0[0] + a * sign * q1[0]
        x = (1.0 - a) * q0[1] + a * sign * q1[1]
        y = (1.0 - a) * q0[2] + a * sign * q1[2]
        z = (1.0 - a) * q0[3] + a * sign * q1[3]
        s = 2.0 / (w * w + x * x + y * y + z * z)
        r00 = 1.0 - s * (y * y + z * z)
        r01 = s * (x * y - w * z)
        r02 = s * (x * z + w * y)
        r10 = s * (x * y + w * z)
        r11 = 1.0 - s * (x * x + z * z)
        r12 = s * (y * z - w * x)
        r20 = s * (x * z - w * y)
        r21 = s * (y * z + w * x)
        r22 = 1.0 - s * (x * x + y * y)
        mx, my, mz = mount[0], mount[1], mount[2]
        bx, by, bz = beams[i, 0], beams[i, 1], beams[i, 2]
        origins[i, 0] = (1.0 - a) * p0[0] + a * p1[0] + r00 * mx + r01 * my + r02 * mz
        origins[i, 1] = (1.0 - a) * p0[1] + a * p1[1] + r10 * mx + r11 * my + r12 * mz
        origins[i, 2] = (1.0 - a) * p0[2] + a * p1[2] + r20 * mx + r21 * my + r22 * mz
        directions[i, 0] = r00 * bx + r01 * by + r02 * bz
        directions[i, 1] = r10 * bx + r11 * by + r12 * bz
        directions[i, 2] = r20 * bx + r21 * by + r22 * bz


@njit(cache=True, nogil=True, error_model="numpy")
def turn_beams(
    nominal: NDArray[np.float32],
    error: NDArray[np.float32],
    sigma: float,
    rotation: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Unit beams (n, 3) off by `sigma` [rad] per axis, turned by `rotation` (3, 3), into `out` (n, 3).

    `error` (n, 3): uniform draws from [0, 1), which cost a quarter of normal ones. The part of an error along its
    beam has no effect after normalising."""
    width = sigma * np.sqrt(12.0)
    for i in range(nominal.shape[0]):
        x = nominal[i, 0] + width * (error[i, 0] - 0.5)
        y = nominal[i, 1] + width * (error[i, 1] - 0.5)
        z = nominal[i, 2] + width * (error[i, 2] - 0.5)
        s = 1.0 / np.sqrt(x * x + y * y + z * z)
        for a in range(3):
            out[i, a] = s * (rotation[a, 0] * x + rotation[a, 1] * y + rotation[a, 2] * z)


@njit(cache=True, nogil=True, error_model="numpy")
def measure(
    ranges: NDArray[np.float32],
    cosine: NDArray[np.float32],
    seen: NDArray[np.bool_],
    nominal: NDArray[np.float32],
    time: NDArray[np.int64],
    ring: NDArray[np.uint16],
    stride: int,
    draw: NDArray[np.float32],
    noise: NDArray[np.float32],
    limits: NDArray[np.float64],
    points: NDArray[np.void],
) -> int:
    """Turn true ranges (n,) into what the sensor reports, into `points` (n,) of POINT_DTYPE.

    `draw` (3, n) uniform and `noise` (n,) standard normal. `limits`: least and greatest range [m], range sigma [m],
    dropout share, cosine where returns fade, mixed share, least and greatest depth edge that mixes [m]. Coordinates
    and times are rounded to POINT_QUANTUM and TIME_QUANTUM. Returns the number of points."""
    low, high, sigma, dropout, fade, mixed, edge_low, edge_high = limits
    n = ranges.shape[0]
    m = 0
    for i in range(n):
        if not seen[i] or not np.isfinite(ranges[i]):
            continue
        if draw[1, i] < dropout or cosine[i] < draw[2, i] * fade:
            continue
        r = float(ranges[i])
        if draw[0, i] < mixed and i + stride < n:
            # One pulse on both sides of a depth edge returns from in between.
            gap = ranges[i + stride] - r
            if edge_low < abs(gap) < edge_high:
                r += gap * draw[0, i] / mixed
        r += sigma * noise[i]
        if r < low or r > high:
            continue
        point = points[m]
        point.x = np.rint(nominal[i, 0] * r / POINT_QUANTUM) * POINT_QUANTUM
        point.y = np.rint(nominal[i, 1] * r / POINT_QUANTUM) * POINT_QUANTUM
        point.z = np.rint(nominal[i, 2] * r / POINT_QUANTUM) * POINT_QUANTUM
        point.intensity = np.rint(100.0 * cosine[i])
        point.ring = ring[i]
        point.time = np.rint(time[i] * (1e-9 / TIME_QUANTUM)) * TIME_QUANTUM
        m += 1
    return m


@njit(cache=True, nogil=True, error_model="numpy")
def unblocked(
    boxes: NDArray[np.float64],
    origin: NDArray[np.float64],
    rotation: NDArray[np.float64],
    nominal: NDArray[np.float32],
    out: NDArray[np.bool_],
) -> None:
    """Which beams (n, 3), turned by `rotation` (3, 3), leave `origin` (3,) without meeting a box, into `out` (n,).

    Rows of `boxes` as for `cast_boxes`. A box that holds the origin blocks nothing.
    """
    m = boxes.shape[0]
    start, reach = np.empty((m, 3)), np.empty((m, 4))
    for k in range(m):
        for a in range(3):
            start[k, a] = 0.0
            for w in range(3):
                start[k, a] += boxes[k, 6 + 3 * w + a] * (origin[w] - boxes[k, w])
            reach[k, a] = boxes[k, a] - origin[a]
        square = boxes[k, 3] ** 2 + boxes[k, 4] ** 2 + boxes[k, 5] ** 2
        reach[k, 3] = reach[k, 0] ** 2 + reach[k, 1] ** 2 + reach[k, 2] ** 2 - square
    for i in range(nominal.shape[0]):
        x, y, z = nominal[i, 0], nominal[i, 1], nominal[i, 2]
        dx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
        dy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        dz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        out[i] = True
        for k in range(m):
            # most beams miss the sphere around the box
            towards = reach[k, 0] * dx + reach[k, 1] * dy + reach[k, 2] * dz
            if reach[k, 3] > 0.0 and (towards < 0.0 or towards * towards < reach[k, 3]):
                continue
            near, far = -np.inf, np.inf
            for a in range(3):
                d = boxes[k, 6 + a] * dx + boxes[k, 9 + a] * dy + boxes[k, 12 + a] * dz
                d = d if abs(d) > 1e-12 else 1e-12
                p = (-boxes[k, 3 + a] - start[k, a]) / d
                q = (boxes[k, 3 + a] - start[k, a]) / d
                near, far = max(near, min(p, q)), min(far, max(p, q))
            if 0.0 < near <= far:
                out[i] = False
                break
