"""The path as the tracker sees it: evenly resampled, with heading, curvature and a speed profile that can be braked.

Everything that can be computed once per path is computed here, so that a control step only interpolates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.rotation import wrap
from planning.braking import FOLD_ANGLE, bend_speed, brake

PATH_STEP = 0.05
"""Spacing of the resampled path [m]."""
LONGEST_PATH = 10_000.0
"""[m]: a longer path is an error of somebody's."""


class PathError(ValueError):
    """The path cannot be tracked; the message names the field and what was expected."""


@dataclass(frozen=True, slots=True)
class TrackPath:
    """A path in the `map` frame, sampled every `step` metres. Plain lists: scalar access is what a control step
    does."""

    x: list[float]
    y: list[float]
    heading: list[float]
    """Direction of travel [rad], unwrapped."""
    curvature: list[float]
    """[1/m], positive to the left, mean over one step either side."""
    speed: list[float]
    """[m/s] the robot may have here and still brake for everything that follows."""
    least: list[float]
    """[m/s] the robot must have here not to stall, where `speed` allows it."""
    step: float
    """Spacing of the samples [m]."""
    length: float
    """[m]."""
    reverse: bool = False
    """Driven with the rear of the body ahead."""

    @property
    def goal(self) -> tuple[float, float]:
        """x, y of the last point [m]."""
        return self.x[-1], self.y[-1]

    def at(self, values: list[float], s: float) -> float:
        """`values` interpolated at arc length `s` [m], clamped to the ends."""
        u = s / self.step
        i = int(u)
        if u <= 0.0:
            return values[0]
        if i >= len(values) - 1:
            return values[-1]
        f = u - i
        return values[i] * (1.0 - f) + values[i + 1] * f

    def cross(self, s: float, x: float, y: float) -> float:
        """Signed distance of x, y from the path at arc length s [m], left positive."""
        dx, dy = x - self.at(self.x, s), y - self.at(self.y, s)
        heading = self.at(self.heading, s)
        return math.cos(heading) * dy - math.sin(heading) * dx

    def project(self, x: float, y: float, s_from: float, s_to: float) -> float:
        """Arc length of the point of [s_from, s_to] nearest to x, y. The earliest wins a tie."""
        xs, ys, step, last = self.x, self.y, self.step, len(self.x) - 1
        if last == 0:
            return 0.0
        best_s, best_d = s_from, math.inf
        for i in range(min(int(s_from / step), last - 1), min(int(s_to / step) + 1, last)):
            dx, dy = xs[i + 1] - xs[i], ys[i + 1] - ys[i]
            squared = dx * dx + dy * dy
            f = ((x - xs[i]) * dx + (y - ys[i]) * dy) / squared if squared > 0.0 else 0.0
            # Plain comparisons: `min` and `max` take a third of the time, and this runs a thousand times a second.
            s = (i + (0.0 if f < 0.0 else 1.0 if f > 1.0 else f)) * step
            s = s_from if s < s_from else s
            s = s_to if s > s_to else s
            f = s / step - i
            d = (x - xs[i] - f * dx) ** 2 + (y - ys[i] - f * dy) ** 2
            if d < best_d - 1e-12:
                best_s, best_d = s, d
        return best_s


def track_paths(
    points: ArrayLike,
    yaw: ArrayLike | None,
    speed: ArrayLike | float,
    least: ArrayLike | float,
    **limits: float,
) -> list[TrackPath]:
    """`track_path` of each stretch in one direction, in their order: backward where the body's heading is against the
    travel. A stretch ends at a sharp corner too."""
    whole = track_path(points, yaw, speed, least, **limits)
    if yaw is None or whole.length == 0.0:
        return [whole]
    xy, facing = np.asarray(points, np.float64)[:, :2], np.array(yaw, np.float64)
    rows = [np.broadcast_to(np.asarray(v, np.float64), len(xy)) for v in (speed, least)]
    keep = np.flatnonzero(np.append(np.hypot(*np.diff(xy, axis=0).T) > 1e-6, True))
    chord = np.diff(xy[keep], axis=0)
    course = np.arctan2(chord[:, 1], chord[:, 0])
    back = np.cos(facing[keep][:-1] - course) < 0.0
    cut = (back[1:] != back[:-1]) | (np.abs(wrap(np.diff(course))) > FOLD_ANGLE)
    ends = [0, *(np.flatnonzero(cut) + 1).tolist(), len(back)]
    out = []
    for first, last in pairwise(ends):
        part = keep[first : last + 1]
        along = facing[part]
        along[-1] = along[-2] if last < len(back) else along[-1]  # there the next stretch has its own heading
        speeds, leasts = (row[part] for row in rows)
        piece = track_path(xy[part], along, speeds, leasts, **limits)
        out.append(replace(piece, reverse=bool(back[first])))
    return out


def track_path(
    points: ArrayLike,
    yaw: ArrayLike | None,
    speed: ArrayLike | float,
    least: ArrayLike | float = 0.0,
    *,
    min_speed: float,
    max_speed: float,
    max_decel: float,
    lateral_accel: float,
    max_yaw_rate: float,
) -> TrackPath:
    """Check and resample a path.

    points: (n, 2) or (n, 3) x, y[, z] in `map` [m], n >= 1. yaw: (n,) heading of the path or of the body along it [rad]
    (a body that drives backwards may carry its own heading: the direction of travel decides), or None to take it from
    the points. speed: (n,) or scalar upper bound [m/s]; least: (n,) or scalar, the least that passes. Raises PathError.
    """
    xy = _finite("points", points)
    if xy.ndim != 2 or xy.shape[0] < 1 or xy.shape[1] not in (2, 3):
        raise PathError(f"points must have shape (n, 2) or (n, 3) with n >= 1, got {xy.shape}")
    n = xy.shape[0]
    limit = _finite("speed", speed)
    if limit.ndim == 0:
        limit = np.full(n, float(limit))
    if limit.shape != (n,):
        raise PathError(f"speed must be a number or have shape ({n},), got {limit.shape}")
    if (limit < 0.0).any():
        raise PathError("speed must not be negative; to drive backward give the heading of the body as yaw")
    floor = np.broadcast_to(_finite("least", least), n) if np.ndim(least) == 0 else _finite("least", least)
    if floor.shape != (n,):
        raise PathError(f"least must be a number or have shape ({n},), got {floor.shape}")
    given = None if yaw is None else _finite("yaw", yaw)
    if given is not None and given.shape != (n,):
        raise PathError(f"yaw must have shape ({n},), got {given.shape}")

    keep = np.concatenate([[True], np.hypot(*np.diff(xy[:, :2], axis=0).T) > 1e-6])
    keep[0] = True
    xy, limit, floor = xy[keep, :2], limit[keep], floor[keep]
    given = None if given is None else given[keep]
    if len(xy) == 1:
        heading = 0.0 if given is None else float(given[0])
        return TrackPath([xy[0, 0]], [xy[0, 1]], [heading], [0.0], [min_speed], [0.0], PATH_STEP, 0.0)

    chord = np.diff(xy, axis=0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(chord[:, 0], chord[:, 1]))])
    length = float(arc[-1])
    if not length <= LONGEST_PATH:
        raise PathError(f"a path of {length:.3g} m is longer than {LONGEST_PATH:.0f} m")
    count = max(2, math.ceil(length / PATH_STEP) + 1)
    step = length / (count - 1)
    s = np.arange(count) * step
    x, y = np.interp(s, arc, xy[:, 0]), np.interp(s, arc, xy[:, 1])
    if given is None:
        # Backward and forward chords averaged: the tangent at a sample, exact on arcs. The end chords are turned by
        # half a step for the same reason, unless there is a corner in it.
        tangent = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
        bend = 0.5 * np.diff(tangent, append=tangent[-1:], prepend=tangent[:1])
        bend[[0, -1]] = bend[[1, -2]] if count > 2 else 0.0
        ends = np.where(np.abs(bend[[0, -1]]) < 0.2, bend[[0, -1]], 0.0)
        middle = 0.5 * (tangent[:-1] + tangent[1:])
        heading_at = np.concatenate([tangent[:1] - ends[0], middle, tangent[-1:] + ends[1]])
    else:
        heading_at = np.interp(s, arc, np.unwrap(_along_travel(given, chord)))
    before, after = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
    curvature = (heading_at[after] - heading_at[before]) / ((after - before) * step)

    allowed = np.minimum(np.interp(s, arc, limit), max_speed)
    allowed = np.minimum(allowed, bend_speed(curvature, lateral_accel, max_yaw_rate))
    allowed = np.maximum(allowed, min_speed)
    brake(allowed, np.full(count - 1, step), max_decel)
    needed = np.minimum(np.interp(s, arc, floor), allowed)
    speeds = allowed.tolist(), needed.tolist()
    return TrackPath(x.tolist(), y.tolist(), heading_at.tolist(), curvature.tolist(), *speeds, step, length)


def _finite(name: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PathError(f"{name} must be numbers: {error}") from error
    if not np.isfinite(array).all():
        raise PathError(f"{name} must be finite")
    return array


def _along_travel(yaw: NDArray[np.float64], chord: NDArray[np.float64]) -> NDArray[np.float64]:
    """Yaw turned by pi where it points against the direction of travel. Raises PathError where it does not follow
    it."""
    travel = np.arctan2(chord[:, 1], chord[:, 0])
    travel = np.append(travel, travel[-1])
    against = np.cos(yaw - travel) < 0.0
    folded = np.where(against, yaw + np.pi, yaw)
    error = np.abs(wrap(folded - travel))
    if np.median(error) > np.radians(30.0):
        raise PathError(
            f"yaw does not follow the points (median difference {np.degrees(np.median(error)):.0f} deg); "
            "pass yaw=None to take the heading from the points"
        )
    return folded
