"""Boxes against the thin surface over a height grid, and what makes a pose valid."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def touches(height, x0, y0, res, centre, rotation, half):
    """Whether an oriented box meets the surface: a vertex of the grid lies in it, or an edge between two cells passes
    through it.

    height (rows, cols) [m], not finite = hole; x0, y0 [m] middle of cell [0, 0]; rotation (3, 3) world <- box. A box
    wholly below the
    surface does not touch it.
    """
    rows, cols = height.shape
    span = _span(rotation, half)
    c0 = max(0, math.floor((centre[0] - span[0] - x0) / res))
    c1 = min(cols - 1, math.ceil((centre[0] + span[0] - x0) / res))
    r0 = max(0, math.floor((centre[1] - span[1] - y0) / res))
    r1 = min(rows - 1, math.ceil((centre[1] + span[1] - y0) / res))
    low, high = centre[2] - span[2], centre[2] + span[2]
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            z = height[r, c]
            if not np.isfinite(z):
                continue
            x, y = x0 + c * res, y0 + r * res
            if low <= z <= high and _cut(x, y, z, 0.0, 0.0, 0.0, centre, rotation, half):
                return True
            for dr, dc in ((0, 1), (1, 0)):
                i, j = r + dr, c + dc
                if i >= rows or j >= cols or not np.isfinite(height[i, j]):
                    continue
                if max(z, height[i, j]) < low or min(z, height[i, j]) > high:
                    continue
                if _cut(x, y, z, dc * res, dr * res, height[i, j] - z, centre, rotation, half):
                    return True
    return False


@njit(cache=True)
def _span(rotation, half):
    """(3,) half lengths of the box's bounding box."""
    out = np.zeros(3)
    for i in range(3):
        for j in range(3):
            out[i] += abs(rotation[i, j]) * half[j]
    return out


@njit(cache=True)
def _cut(x, y, z, dx, dy, dz, centre, rotation, half):
    """Whether the segment from x, y, z by dx, dy, dz meets the box (slabs)."""
    enter, leave = 0.0, 1.0
    for k in range(3):
        at = (
            rotation[0, k] * (x - centre[0])
            + rotation[1, k] * (y - centre[1])
            + rotation[2, k] * (z - centre[2])
        )
        by = rotation[0, k] * dx + rotation[1, k] * dy + rotation[2, k] * dz
        if abs(by) < 1e-12:
            if abs(at) > half[k]:
                return False
            continue
        a, b = (-half[k] - at) / by, (half[k] - at) / by
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        if enter > leave:
            return False
    return True


@njit(cache=True)
def rotation_of(q):
    """(3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = q
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@njit(cache=True)
def valid(height, masked, x0, y0, res, boxes, pose):
    """Whether every foot box of the pose reaches the masked surface and the torso does not touch the whole one.

    pose (7,): x, y, z [m], quaternion w, x, y, z of the feet's plane. A foot off the map is not valid, a torso off it
    is.
    """
    rows, cols = height.shape
    rotation = rotation_of(pose[3:])
    centre = np.empty(3)
    for k in range(boxes.shape[0]):
        for i in range(3):
            centre[i] = pose[i]
            for j in range(3):
                centre[i] += rotation[i, j] * boxes[k, j]
        half = boxes[k, 3:]
        if k == 0:
            if touches(height, x0, y0, res, centre, rotation, half):
                return False
        else:
            c, r = (centre[0] - x0) / res, (centre[1] - y0) / res
            if not (-0.5 <= c <= cols - 0.5 and -0.5 <= r <= rows - 0.5):
                return False
            if not touches(masked, x0, y0, res, centre, rotation, half):
                return False
    return True


@njit(cache=True)
def all_valid(height, masked, x0, y0, res, boxes, poses):
    """(n,) `valid` of each pose (n, 7)."""
    out = np.empty(poses.shape[0], np.bool_)
    for i in range(poses.shape[0]):
        out[i] = valid(height, masked, x0, y0, res, boxes, poses[i])
    return out


@njit(cache=True)
def half_angle(p, q):
    """Half the angle [rad] between the headings of two quaternions."""
    return math.acos(min(1.0, abs(p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3])))


@njit(cache=True)
def way_is_valid(height, masked, x0, y0, res, boxes, a, b, step, turn):
    """Whether the poses between a and b are valid, at most `step` [m] and `turn` [rad of half angle] apart; the ends
    are not tested."""
    angle = half_angle(a[3:], b[3:])
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    count = math.ceil(max(math.sqrt(dx * dx + dy * dy + dz * dz) / step, angle / turn))
    sign = 1.0 if a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] >= 0.0 else -1.0
    pose = np.empty(7)
    for n in range(1, count):
        t = n / count
        if angle > 1e-9:
            u, v = math.sin((1.0 - t) * angle) / math.sin(angle), sign * math.sin(t * angle) / math.sin(angle)
        else:
            u, v = 1.0 - t, sign * t
        for k in range(3):
            pose[k] = (1.0 - t) * a[k] + t * b[k]
        for k in range(3, 7):
            pose[k] = u * a[k] + v * b[k]
        if not valid(height, masked, x0, y0, res, boxes, pose):
            return False
    return True
