"""Hybrid A* on the assessed terrain, after Kurzer: continuous poses, one per bin of cell and heading. Lengths in
cells."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit

from tools.baselines.t_hybrid.reeds_shepp import reeds_shepp
from tools.baselines.t_hybrid.terrain import NO_RECORD, TRAVERSABLE

HEADING_COUNT = 72
STEP_LENGTH = 0.7068582
"""Length of every primitive."""
ARC_X, ARC_Y, ARC_TURN = 0.705224, 0.0415893, 0.1178097
"""The arc's end [cells, cells, rad]."""
ARC_RADIUS = 6.0
"""Of the arcs."""
RISK_WEIGHT = 4.0
"""Cost per cell and risk."""
TURN_FACTOR, REVERSE_FACTOR, SWITCH_FACTOR = 1.05, 2.0, 2.0
"""Factors of cost for another primitive, for driving backward, for changing the direction."""
TIE_MARGIN = 0.01
NO_ROUTE, FOUND, EXHAUSTED = 0, 1, 2


@njit(cache=True)
def risk_at(flag, rough, normal, x, y, heading, max_pitch, max_roll, shift):
    """Risk of a pose; infinite where the terrain refuses it."""
    rows, cols = flag.shape
    c, r = math.floor(x + shift), math.floor(y + shift)
    for dc, dr in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        i, j = r + dr, c + dc
        if 0 <= i < rows and 0 <= j < cols and flag[i, j] != NO_RECORD:
            if flag[i, j] != TRAVERSABLE:
                return np.inf
            nx, ny, nz = normal[i, j]
            # Forward axis in the plane: the left axis of the level heading, crossed with the normal.
            fx, fy = math.cos(heading) * nz, math.sin(heading) * nz
            fz = -(math.sin(heading) * ny + math.cos(heading) * nx)
            size = math.sqrt(fx * fx + fy * fy + fz * fz)
            fx, fy, fz = fx / size, fy / size, fz / size
            left = nx * fy - ny * fx
            pitch = abs(math.asin(min(1.0, max(-1.0, fz)))) / max_pitch
            roll = abs(math.atan2(left, nz)) / max_roll
            uneven = 0.5 * rough[i, j]
            if pitch >= 1.0 or roll >= 1.0 or uneven >= 1.0:
                return np.inf
            return 0.4 * pitch + 0.4 * roll + 0.3 * uneven
    return np.inf


@njit(cache=True)
def collides(occupied, x, y, heading, half_length, half_width):
    """Whether the middle of an occupied cell lies under the footprint."""
    rows, cols = occupied.shape
    reach = math.hypot(half_length, half_width)
    c, s = math.cos(heading), math.sin(heading)
    for i in range(max(0, int(y - reach)), min(rows, int(y + reach) + 1)):
        for j in range(max(0, int(x - reach)), min(cols, int(x + reach) + 1)):
            if occupied[i, j]:
                dx, dy = j + 0.5 - x, i + 0.5 - y
                if abs(c * dx + s * dy) <= half_length and abs(c * dy - s * dx) <= half_width:
                    return True
    return False


@njit(cache=True)
def distances(occupied, x, y):
    """(rows, cols) shortest way over free cells to the cell of x, y, eight neighbours; infinite where there is none."""
    rows, cols = occupied.shape
    out = np.full((rows, cols), np.inf)
    r, c = int(y), int(x)
    out[r, c] = 0.0
    queue = [(0.0, r, c)]
    while len(queue) > 0:
        d, i, j = heapq.heappop(queue)
        if d > out[i, j]:
            continue
        for di in range(-1, 2):
            for dj in range(-1, 2):
                a, b = i + di, j + dj
                if 0 <= a < rows and 0 <= b < cols and not occupied[a, b]:
                    new = d + math.sqrt(di * di + dj * dj)
                    if new < out[a, b]:
                        out[a, b] = new
                        heapq.heappush(queue, (new, a, b))
    return out


@njit(cache=True)
def _index(x, y, heading, rows, cols):
    t = math.floor(heading / (2.0 * math.pi / HEADING_COUNT)) % HEADING_COUNT
    return (t * rows + math.floor(y)) * cols + math.floor(x)


@njit(cache=True)
def search(
    flag,
    rough,
    normal,
    occupied,
    starts,
    goal,
    half_length,
    half_width,
    max_pitch,
    max_roll,
    floor,
    budget,
    quirks,
):
    """-> outcome, poses (n, 3) x, y [cells], heading, cost, pops.

    `starts` (k, 3): poses to begin at; `goal` (3,): reached within a cell of x, y at any heading, its heading guides.
    """
    rows, cols = flag.shape
    n = HEADING_COUNT * rows * cols
    g = np.full(n, np.inf)
    f = np.full(n, np.inf)
    pose = np.zeros((n, 3))
    parent = np.full(n, -1, np.int64)
    primitive = np.full(n, -1, np.int8)
    state = np.zeros(n, np.int8)
    shift = -0.5 if quirks else 0.0
    sign = -1.0 if quirks else 1.0
    way = distances(occupied, goal[0], goal[1])
    queue = [(0.0, 0)]
    queue.pop()
    for k in range(starts.shape[0]):
        x, y, h = starts[k]
        if collides(occupied, x, y, h, half_length, half_width):
            continue
        if not np.isfinite(risk_at(flag, rough, normal, x, y, h, max_pitch, max_roll, shift)):
            continue
        i = _index(x, y, h, rows, cols)
        g[i] = 0.0
        f[i] = _to_go(way, x, y, h, goal)
        pose[i] = starts[k]
        state[i] = 1
        heapq.heappush(queue, (f[i], i))
    pops = 0
    while len(queue) > 0:
        if pops >= budget:
            return EXHAUSTED, np.zeros((0, 3)), np.inf, pops
        pops += 1
        _, i = heapq.heappop(queue)
        if state[i] != 1:
            continue
        state[i] = 2
        x, y, h = pose[i]
        if abs(x - goal[0]) <= 1.0 and abs(y - goal[1]) <= 1.0:
            return _back(i, pose, parent, g, pops)
        for m in range(6):
            back = m >= 3
            turn = 0.0 if m % 3 == 0 else (1.0 if m % 3 == 1 else -1.0)
            dx = STEP_LENGTH if turn == 0.0 else ARC_X
            dy = turn * ARC_Y * sign
            dh = turn * ARC_TURN
            if back:
                # The reversal of an arc: the mirror image across the axle.
                dx, dh = -dx, -dh
            nx = x + dx * math.cos(h) - dy * math.sin(h)
            ny = y + dx * math.sin(h) + dy * math.cos(h)
            nh = (h + dh) % (2.0 * math.pi)
            if not (0.0 <= nx < cols and 0.0 <= ny < rows):
                continue
            k = _index(nx, ny, nh, rows, cols)
            if state[k] == 2 and k != i:
                continue
            if collides(occupied, nx, ny, nh, half_length, half_width):
                continue
            risk = risk_at(flag, rough, normal, nx, ny, nh, max_pitch, max_roll, shift)
            if not np.isfinite(risk):
                continue
            cost = STEP_LENGTH * RISK_WEIGHT * max(risk, floor)
            before = primitive[i]
            if before >= 0 and before != m:
                cost *= TURN_FACTOR
            if back:
                cost *= REVERSE_FACTOR
            if before >= 0 and (before >= 3) != back:
                cost *= SWITCH_FACTOR
            new = g[i] + cost
            if state[k] == 1 and new >= g[k] and k != i:
                continue
            total = new + _to_go(way, nx, ny, nh, goal)
            if not np.isfinite(total):
                continue
            if k == i:
                # A step that stays in its bin takes its parent's place, unless it is clearly worse.
                if total > f[i] + TIE_MARGIN:
                    continue
                parent[k] = parent[i]
            else:
                parent[k] = i
            g[k], f[k] = new, total
            pose[k, 0], pose[k, 1], pose[k, 2] = nx, ny, nh
            primitive[k] = m
            state[k] = 1
            heapq.heappush(queue, (total, k))
            if k == i:
                break
    return NO_ROUTE, np.zeros((0, 3)), np.inf, pops


@njit(cache=True)
def _to_go(way, x, y, h, goal):
    """The larger of the way of a car on empty ground and the way over free cells, less what lies within a cell."""
    dx, dy = goal[0] - x, goal[1] - y
    c, s = math.cos(h), math.sin(h)
    car = ARC_RADIUS * reeds_shepp(
        (c * dx + s * dy) / ARC_RADIUS, (c * dy - s * dx) / ARC_RADIUS, goal[2] - h
    )
    return max(car, way[int(y), int(x)] - math.sqrt(2.0))


@njit(cache=True)
def _back(i, pose, parent, g, pops):
    """The poses from the start to bin i."""
    n = 0
    k = i
    while k >= 0 and n <= parent.size:
        n += 1
        k = parent[k]
    out = np.empty((n, 3))
    k = i
    for m in range(n - 1, -1, -1):
        out[m] = pose[k]
        k = parent[k]
    return FOUND, out, g[i], pops
