"""A path the robot can follow and what it may ask of the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from planning.braking import FOLD_ANGLE, brake

Array = NDArray[np.float64]


WATCH_REACH = 20
"""Poses that are watched, 1 m, among which the robot is looked for: a path may come back to where it was."""


class PathLimits(BaseModel):
    """Limits of a path."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    max_speed: float = Field(default=0.8, gt=0.0, description="fastest [m/s]")
    min_speed: float = Field(default=0.1, gt=0.0, description="slowest while moving [m/s]")
    max_accel: float = Field(default=0.8, gt=0.0, description="speeding up and braking [m/s^2]")
    lateral_accel: float = Field(default=0.6, gt=0.0, description="in curves [m/s^2]")
    max_yaw_rate: float = Field(default=0.8, gt=0.0, description="in curves [rad/s]")
    max_slope: float = Field(default=0.436, gt=0.0, description="steepest ground; half speed there [rad]")
    max_step: float = Field(default=0.10, gt=0.0, description="highest vertical face under the body [m]")
    step_speed: float = Field(
        default=0.0, ge=0.0, description="slowest speed at which faces are climbed [m/s]; 0 = any does"
    )
    spacing: float = Field(default=0.02, gt=0.0, description="distance between samples [m]")
    corridor: float = Field(default=0.08, gt=0.0, description="farthest the path leaves the route [m]")


@dataclass(frozen=True, slots=True)
class Path:
    """A path in the `map` frame."""

    points: Array = field(repr=False)
    """(n, 3) x, y, z of the ground [m]."""
    yaw: Array = field(repr=False)
    """(n,) heading of the body [rad]: against the direction of travel where it is driven backward."""
    speed: Array = field(repr=False)
    """(n,) [m/s] upper bound; 0 at the end and where forward changes to backward."""
    least: Array = field(repr=False)
    """(n,) [m/s] slowest speed at which the ground there is passed, never above `speed`; 0: any."""
    s: Array = field(repr=False)
    """(n,) planar distance along the path [m]."""
    route: Array = field(repr=False)
    """(m, 2) the polyline it follows: start, nodes, goal [m]."""
    back: NDArray[np.bool_] = field(repr=False)
    """(m - 1,) whether each leg of the polyline is driven backward."""
    initial_turn: float | None
    """Turn in place before driving off [rad], positive left; None when the start yaw is not known."""
    goal_yaw: float | None
    """Heading wanted at the end [rad]; the last `yaw` is that on the way."""
    worst: tuple[float, float, float]
    """Largest d_fb [m], a_lr [deg], p_int [m] on the path when it was made."""
    watched: Array = field(repr=False)
    """(k, 3) x, y [m], yaw [rad] every 5 cm: where faces are looked for."""
    faces: Array = field(repr=False)
    """(k,) highest vertical face under the body at each of these when the path was made [m]."""
    limits: PathLimits = field(repr=False)

    @property
    def length(self) -> float:
        """[m]"""
        return float(self.s[-1])

    def until(self, last: int) -> Path:
        """The path up to point `last`, where it comes to rest."""
        last = max(last, 0)
        x, y = self.points[last, :2].tolist()
        speed = self.speed[: last + 1].copy()
        speed[last] = 0.0
        brake(speed, np.diff(self.s[: last + 1]), self.limits.max_accel)
        # Corners of the route lie beside the path, poses that are watched on it.
        corners = _passed(self.route, self.points[:, :2], last)
        watched = max(1, _passed(self.watched[:, :2], self.points[:, :2], last))
        return replace(
            self,
            points=self.points[: last + 1],
            yaw=self.yaw[: last + 1],
            speed=speed,
            least=np.minimum(self.least[: last + 1], speed),
            s=self.s[: last + 1],
            route=np.vstack([self.route[:corners], (x, y)]),
            back=self.back[: max(corners, 1)],
            goal_yaw=None,
            watched=self.watched[:watched],
            faces=self.faces[:watched],
        )

    def slowed(self, where: NDArray[np.bool_], limit: float) -> Path:
        """The path, driven at `limit` [m/s] at most at the points `where` (n,), unless the ground there is passed at
        more alone."""
        if not where.any():
            return self
        speed = np.where(where, np.minimum(self.speed, np.maximum(limit, self.least)), self.speed)
        ds = np.diff(self.s)
        brake(speed, ds, self.limits.max_accel)
        brake(speed[::-1], ds[::-1], self.limits.max_accel)
        return replace(self, speed=speed, least=np.minimum(self.least, speed))

    def beyond(self, x: float, y: float) -> Path:
        """The path as one who watches it needs it from now on: without what a robot at x, y [m] has passed."""
        near = self.watched[:WATCH_REACH, :2]
        k = int(np.argmin(np.hypot(near[:, 0] - x, near[:, 1] - y)))
        if k == 0:
            return self
        corners = min(_passed(self.route, self.watched[:, :2], k), len(self.route) - 1)
        return replace(
            self,
            route=self.route[corners:],
            back=self.back[corners:],
            watched=self.watched[k:],
            faces=self.faces[k:],
        )

    def ahead(self, x: float, y: float) -> tuple[Array, NDArray[np.bool_]] | None:
        """What is left of `route` and `back` for a robot at x, y [m]; None where it is farther than the corridor off
        the route. A corner where it turns round is passed from near on: it turned back to drive the last centimetres to
        it, with each new plan."""
        if len(self.route) < 2:
            return None
        a, leg = self.route[:-1], np.diff(self.route, axis=0)
        rel = np.array([x, y]) - a
        t = np.clip((rel * leg).sum(1) / (leg * leg).sum(1), 0.0, 1.0)
        off = np.hypot(*(rel - t[:, None] * leg).T)
        k = int(np.argmin(off))
        near = 2.0 * self.limits.corridor
        if k + 2 < len(self.route) and np.hypot(*(rel[k] - leg[k])) <= near and _folded(leg[k], leg[k + 1]):
            k += int(self.back[k] == self.back[k + 1])
        return (self.route[k + 1 :], self.back[k:]) if off.min() <= near else None


def _folded(leg: Array, after: Array) -> bool:
    """Whether the way turns round between two legs, (2,) [m] each."""
    return float(leg @ after) < math.cos(FOLD_ANGLE) * float(np.hypot(*leg) * np.hypot(*after))


def _passed(places: Array, points: Array, last: int) -> int:
    """How many of `places` (n, 2), which follow the line `points` (m, 2), come before its point `last`."""
    at, n = 0, 0
    for place in places:
        at += int(np.argmin(np.hypot(*(points[at:] - place).T)))
        if at > last:
            break
        n += 1
    return n
