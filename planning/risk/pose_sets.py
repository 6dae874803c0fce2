"""Pose sets: the poses along an edge and in a turn, their moments and what they weigh (paper eq. 3 and 4)."""

from __future__ import annotations

import numpy as np
from numba import njit

from hal.rotation import wrap
from planning.risk.cost import Weights
from planning.risk.footprint import MOST_POSES, Scratch, features_of, scratch
from planning.risk.terrain import Sampler


@njit(cache=True)
def turn_angle(yaw_in: float, yaw_out: float) -> float:
    """Shortest signed rotation [rad] from one heading to another, in (-pi, pi]; a half turn goes by +pi, whatever the
    rounding."""
    d = wrap(yaw_out - yaw_in)
    return d + 2.0 * np.pi if d < -np.pi + 1e-9 else d


@njit(cache=True)
def aggregate(w: Weights, values: np.ndarray, out: np.ndarray) -> None:
    """Mean `out[0]` and tail mean `out[1]` (4,) of the scaled, clipped features of one pose set (eq. 3).

    `out[2]` is the largest value of each feature as it is, neither scaled nor clipped. `values` (n, 4) is overwritten.
    The tail is the ceil(n / 10) largest values of each feature.
    """
    n = len(values)
    k = max(1, (n + 9) // 10)
    for m in range(4):
        scale = 1.0 / w.scale[m]
        clip = w.clip if m < 3 else np.inf
        peak = 0.0
        total = 0.0
        for i in range(n):
            peak = max(peak, values[i, m])
            values[i, m] = min(clip, values[i, m] * scale)
            total += values[i, m]
        out[2, m] = peak
        out[0, m] = total / n
        tail = 0.0
        for _ in range(k):
            best = 0
            for i in range(1, n):
                if values[i, m] > values[best, m]:
                    best = i
            tail += values[best, m]
            values[best, m] = -1.0
        out[1, m] = tail / k


@njit(cache=True)
def moments_of_parts(w: Weights, values: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """(k, 3, 4) `aggregate` of rows `parts[k, 0]` to before `parts[k, 1]` of `values`, NaN where there are none."""
    out = np.full((len(parts), 3, 4), np.nan)
    for k in range(len(parts)):
        if parts[k, 1] > parts[k, 0]:
            aggregate(w, values[parts[k, 0] : parts[k, 1]].copy(), out[k])
    return out


@njit(cache=True)
def weigh(w: Weights, moments: np.ndarray) -> tuple[float, float]:
    """B and U of one pose set from its moments."""
    body = 0.0
    for m in range(3):
        body += w.mean * moments[0, m] + w.tail * moments[1, m]
    return body, w.mean * moments[0, 3] + w.tail * moments[1, 3]


@njit(cache=True)
def evaluate_poses(
    sampler: Sampler,
    work: Scratch,
    w: Weights,
    x: float,
    y: float,
    yaw: float,
    dx: float,
    dy: float,
    dyaw: float,
    out: np.ndarray,
) -> tuple[float, float]:
    """B and U of the poses from (x, y, yaw) to (x + dx, y + dy, yaw + dyaw) [m, rad], both ends in: a straight edge or
    a turn in place, in steps of `edge_step` and `sweep_step` at most. Their moments come into `out`, see
    `aggregate`."""
    steps = max(np.hypot(dx, dy) / w.edge_step, abs(dyaw) / w.sweep_step)
    n = int(np.ceil(steps - 1e-9)) + 1
    poses, values = work.poses, work.values[:n]
    if n > MOST_POSES:
        poses, values = np.empty((n, 3)), np.empty((n, 4))
    part = 1.0 / (n - 1) if n > 1 else 0.0
    for i in range(n):
        t = i * part
        poses[i, 0] = x + t * dx
        poses[i, 1] = y + t * dy
        poses[i, 2] = yaw + t * dyaw
    features_of(sampler, work, poses, values)
    aggregate(w, values, out)
    return weigh(w, out)


@njit(cache=True)
def route_moments(
    sampler: Sampler,
    w: Weights,
    xy: np.ndarray,
    flip: np.ndarray,
    back: np.ndarray,
    start_yaw: float,
    goal_yaw: float,
    first: int,
    last: int,
    out: np.ndarray,
) -> None:
    """Moments of every pose set of transitions first..last - 1 of a route through points xy (n, 2).

    `out` is (n - 1, 3, 3, 4): transition, set (edge, sweep before it, terminal sweep), moment, feature; NaN where a
    set does not exist. `flip` marks edges that are evaluated from their far end, as the search does, `back` edges
    that are driven backward.
    """
    work = scratch(sampler)
    for t in range(first, last):
        out[t] = np.nan
        x, y = xy[t, 0], xy[t, 1]
        dx, dy = xy[t + 1, 0] - x, xy[t + 1, 1] - y
        yaw = np.arctan2(dy, dx) + (np.pi if back[t] else 0.0)
        far = 1.0 if flip[t] else 0.0
        ex, ey = (1.0 - 2.0 * far) * dx, (1.0 - 2.0 * far) * dy
        evaluate_poses(
            sampler, work, w, x + far * dx, y + far * dy, np.arctan2(ey, ex), ex, ey, 0.0, out[t, 0]
        )
        yaw_in = start_yaw
        if t > 0:
            yaw_in = np.arctan2(y - xy[t - 1, 1], x - xy[t - 1, 0]) + (np.pi if back[t - 1] else 0.0)
        if not np.isnan(yaw_in):
            evaluate_poses(sampler, work, w, x, y, yaw_in, 0.0, 0.0, turn_angle(yaw_in, yaw), out[t, 1])
        if t == xy.shape[0] - 2 and not np.isnan(goal_yaw):
            turn = turn_angle(yaw, goal_yaw)
            evaluate_poses(sampler, work, w, x + dx, y + dy, yaw, 0.0, 0.0, turn, out[t, 2])
