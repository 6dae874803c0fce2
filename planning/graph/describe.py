"""What the corrected graph knows about a node beside its place: frontier, headings that fit, edges in a turn, sight of
the robot."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.kernels import select
from hal.raster import cell_of
from planning.graph.edge_price import EVEN_TAN
from planning.graph.faces import FACE_NOISE
from planning.graph.flags import FACE, HIGH, LOW, STEP_BASE, UNSEEN
from planning.graph.nodes import step_distance2
from planning.graph.prices import angle_at, size_at

FRONTIER_RAYS = 16
HEADING_COUNT = 36
"""Headings of the footprint over half a turn, 5 deg apart: the poses of a sweep."""
HEADING_STEP = math.pi / HEADING_COUNT
COS = np.array([math.cos(h * math.pi / HEADING_COUNT) for h in range(HEADING_COUNT)])
SIN = np.array([math.sin(h * math.pi / HEADING_COUNT) for h in range(HEADING_COUNT)])
ALL_HEADINGS = np.uint64((1 << HEADING_COUNT) - 1)
WHEEL_RING = (-0.06, 0.15)
"""So far beyond `GraphParams.axle` from its middle the wheels of a robot that turns on the spot meet the ground
[m]."""
LONE_FACES = 0.01
"""[m^2] of ground with higher faces is noise of the map."""
UNKNOWN_RUN = 0.20
"""Unseen ground this long on a ray, after at most half a body and one ring of free ground, is a frontier [m]."""


@njit(cache=True)
def open_frontier(flags, x0, y0, res, x, y, ring):
    """True if free ground ends in unseen ground within `ring` of x, y, in two neighbouring directions of sixteen."""
    rows, cols = flags.shape
    n = math.ceil((ring + UNKNOWN_RUN) / res)
    need = math.ceil(UNKNOWN_RUN / res)
    last = False
    first = False
    for a in range(FRONTIER_RAYS + 1):
        if a == FRONTIER_RAYS:
            return last and first
        dx = math.cos(2.0 * math.pi * a / FRONTIER_RAYS) * res
        dy = math.sin(2.0 * math.pi * a / FRONTIER_RAYS) * res
        run = 0
        for s in range(1, n + 1):
            px = x + s * dx
            py = y + s * dy
            c = cell_of(px, x0, res)
            r = cell_of(py, y0, res)
            if r < 0 or c < 0 or r >= rows or c >= cols:
                run = need
                break
            if flags[r, c] & FACE:
                break
            if flags[r, c] & UNSEEN:
                run += 1
                if run >= need:
                    break
            else:
                run = 0
        is_open = run >= need
        if is_open and last:
            return True
        if a == 0:
            first = is_open
        last = is_open
    return False


@njit(cache=True)
def free_headings(flags, x0, y0, res, x, y, length, width):
    """Bit h is set where the footprint at heading h * 5 deg (the same turned by 180 deg) is on no step."""
    rows, cols = flags.shape
    radius = 0.5 * math.hypot(length, width)
    if step_distance2(flags, x0, y0, res, x, y, radius)[0] >= radius * radius:
        return ALL_HEADINGS
    high = np.uint64(0)
    low = np.uint64(0)
    for r in range(
        max(0, math.ceil((y - radius - y0) / res)), min(rows, math.floor((y + radius - y0) / res) + 1)
    ):
        dy = y0 + r * res - y
        for c in range(
            max(0, math.ceil((x - radius - x0) / res)), min(cols, math.floor((x + radius - x0) / res) + 1)
        ):
            flag = flags[r, c]
            if not flag & FACE:
                continue
            dx = x0 + c * res - x
            for h in range(HEADING_COUNT):
                cs, sn = COS[h], SIN[h]
                if abs(dx * cs + dy * sn) <= 0.5 * length and abs(dy * cs - dx * sn) <= 0.5 * width:
                    bit = np.uint64(1) << np.uint64(h)
                    if flag & HIGH:
                        high |= bit
                    if flag & LOW:
                        low |= bit
    return ALL_HEADINGS & ~(high & low)


@njit(cache=True)
def turn_is_free(headings, yaw_in, turn):
    """True if a turn in place by `turn` [rad, signed] from `yaw_in` meets no blocked heading of `headings` (uint64).

    Both ends are left out: they are headings of edges, whose corridors were tested to the full width.
    """
    if headings & ALL_HEADINGS == ALL_HEADINGS:
        return True
    low = min(yaw_in, yaw_in + turn)
    high = max(yaw_in, yaw_in + turn)
    for k in range(math.floor(low / HEADING_STEP) + 1, math.ceil(high / HEADING_STEP)):
        if not headings >> np.uint64(k % HEADING_COUNT) & np.uint64(1):
            return False
    return True


@njit(cache=True)
def turn_ground(height, trusted, faces, x0, y0, res, x, y, axle, climbed):
    """Height [m] of the face that the wheels meet in a turn on the spot at x, y [m], and the slope [m/m] of the ground
    there.

    The highest face of the wheels' ring counts that is no lone one (`LONE_FACES`). What is higher than `climbed` [m] is
    a wall, beside which a turn has room or not, and so is what smears of it. The slope is that of the ground without
    its faces, the mean of four quarters: on a crest they look four ways.
    """
    rows, cols = height.shape
    n = max(1, round(0.5 * STEP_BASE / res))
    near, far = (axle + WHEEL_RING[0]) / res, (axle + WHEEL_RING[1]) / res
    reach = math.ceil(far)
    r_mid = cell_of(y, y0, res)
    c_mid = cell_of(x, x0, res)
    inner, outer = near**2, far**2
    least, wall = 1000.0 * FACE_NOISE, 1000.0 * climbed
    sizes = np.empty((2 * reach + 1) ** 2, np.int64)
    rise = np.zeros((4, 2))
    known = np.zeros((4, 2), np.int64)
    found = np.int64(0)
    for r in range(max(0, r_mid - reach), min(rows, r_mid + reach + 1)):
        for c in range(max(0, c_mid - reach), min(cols, c_mid + reach + 1)):
            if not inner <= (r - r_mid) ** 2 + (c - c_mid) ** 2 <= outer:
                continue
            size = max(abs(faces[r, c, 0]), abs(faces[r, c, 1]))
            if size >= least:
                beside = 0
                for i in range(max(0, r - n), min(rows, r + n + 1)):
                    for j in range(max(0, c - n), min(cols, c + n + 1)):
                        beside = max(beside, abs(faces[i, j, 0]), abs(faces[i, j, 1]))
                if beside <= wall:
                    sizes[found] = size
                    found += 1
                continue
            quarter = 2 * (r > r_mid) + (c > c_mid)
            for axis in range(2):
                dr, dc = (0, n) if axis == 0 else (n, 0)
                if (
                    dr <= r < rows - dr
                    and dc <= c < cols - dc
                    and trusted[r - dr, c - dc]
                    and trusted[r + dr, c + dc]
                ):
                    rise[quarter, axis] += height[r + dr, c + dc] - height[r - dr, c - dc]
                    known[quarter, axis] += 1
    lone = round(LONE_FACES / (res * res))
    edge = 0.001 * select(sizes, found, found - 1 - lone) if found > lone else 0.0
    steep, told = 0.0, 0
    for quarter in range(4):
        if known[quarter].min() > 0:
            there = rise[quarter] / known[quarter]
            steep += math.hypot(there[0], there[1]) / (2 * n * res)
            told += 1
    return edge, steep / max(told, 1)


@njit(cache=True)
def turn_price(height, trusted, faces, x0, y0, res, x, y, prices, climbed):
    """[m/rad] of a bend and of a turn on the spot at x, y [m]."""
    edge, slope = turn_ground(height, trusted, faces, x0, y0, res, x, y, prices.axle, climbed)
    if slope < EVEN_TAN:
        slope = 0.0
    if edge == 0.0 and slope == 0.0:
        return 0.0, 0.0
    i, j = size_at(edge), angle_at(math.atan(slope))
    return prices.turn[0, i, j], prices.turn[1, i, j]


@njit(cache=True)
def in_sight(flags, x0, y0, res, xa, ya, points, reach):
    """(n,) bool: which points (n, 2) lie within `reach` and the straight line, three cells wide, is on no step."""
    rows, cols = flags.shape
    seen = np.zeros(len(points), np.bool_)
    for v in range(len(points)):
        xb = points[v, 0]
        yb = points[v, 1]
        d = math.hypot(xb - xa, yb - ya)
        if d > reach:
            continue
        n = max(1, math.ceil(2.0 * d / res))
        sides = 0
        for s in range(n + 1):
            c_mid = cell_of(xa + (xb - xa) * s / n, x0, res)
            r_mid = cell_of(ya + (yb - ya) * s / n, y0, res)
            for r in range(max(0, r_mid - 1), min(rows, r_mid + 2)):
                for c in range(max(0, c_mid - 1), min(cols, c_mid + 2)):
                    sides |= flags[r, c] & FACE
            if sides == FACE:
                break
        seen[v] = sides != FACE
    return seen


@njit(cache=True)
def describe_nodes(
    height, trusted, flags, faces, x0, y0, res, chosen, where, todo, near, ring, length, width,
    frontier, headings, price, prices, climbed,
):  # fmt: skip
    """Set `frontier` (ny, nx) of the lattice cells in `todo`, `headings` and `price` (ny, nx, 2) of those that are in
    `near` as well; climbed: as in `turn_ground`."""
    for j in range(todo.shape[0]):
        for i in range(todo.shape[1]):
            if not todo[j, i]:
                continue
            frontier[j, i] = False
            if chosen[j, i] >= 0:
                x = where[j, i, 0]
                y = where[j, i, 1]
                frontier[j, i] = open_frontier(flags, x0, y0, res, x, y, ring)
                if not near[j, i]:
                    continue
                headings[j, i] = free_headings(flags, x0, y0, res, x, y, length, width)
                price[j, i, 0], price[j, i, 1] = turn_price(
                    height, trusted, faces, x0, y0, res, x, y, prices, climbed
                )
