"""The door for local controllers of others, named as `package.module:function`.

A controller is a function `(path: Followed, robot: Robot) -> (forward [m/s], turn [rad/s])`, asked 50 times a second;
None: the path is driven to its end. A class is made anew for each path, and may so remember things. What it answers is
kept to the limits of the tracker, and slewed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.named import NamedError, named
from hal.rotation import wrap
from planning.errors import PlanningError
from planning.tracking.path import track_paths
from planning.tracking.types import OURS, TrackerConfig, TrackOutput, TrackPhase

GROUP = "rbtrg.trackers"
SEARCH_AHEAD = 1.5
"""[m] ahead of the nearest point so far, the next one is looked for: a path may cross itself."""


@dataclass(slots=True, eq=False)
class Followed:
    """The path, in `map`."""

    points: NDArray[np.float64]
    """(n, 2) x, y [m], a point every 0.02 m."""
    yaw: NDArray[np.float64]
    """(n,) of the body [rad]: against the travel where it is to be driven backward."""
    speed: NDArray[np.float64]
    """(n,) limits [m/s]."""
    goal_yaw: float | None
    """Of the body at the end [rad]; None: any."""
    nearest: int = 0
    """The point that the robot has come to."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Where it is and how it moves."""

    now: int
    """[ns]"""
    x: float
    y: float
    yaw: float
    """base_link in `map` [m], [rad]."""
    v: float
    wz: float
    """Forward [m/s], to the left [rad/s], as measured."""
    slope: float
    """Of the ground [rad]."""


class OwnTracker:
    """A controller of others in the place of `PathTracker`."""

    def __init__(self, method: str, params: TrackerConfig) -> None:
        """Raises PlanningError for a name that cannot be imported."""
        self.params = params
        self._method = method
        try:
            self._named = named(method, "tracker", GROUP, (OURS,))
        except NamedError as error:
            raise PlanningError(str(error)) from error
        self._vx = self._wz = 0.0
        self._now: int | None = None
        self.clear()

    def clear(self) -> None:
        """Forget the path; the next steps brake to zero."""
        self._path: Followed | None = None
        self._along = np.zeros(0)
        self._done = False
        self._fault = ""
        self._drive: Any = None

    @property
    def has_path(self) -> bool:
        """Whether there is a path to drive, or one that was driven to its end."""
        return self._path is not None

    def pause(self) -> None:
        """The robot is being held still: start from zero velocity when it goes on."""
        self._vx = self._wz = 0.0

    def set_path(
        self,
        points: ArrayLike,
        yaw: ArrayLike,
        speed: ArrayLike,
        goal_yaw: float | None = None,
        path_id: int = 0,
        least: ArrayLike | float = 0.0,
        most: float = math.inf,
    ) -> None:
        """As `PathTracker.set_path`; `least` is for controllers that know it, and left out. Raises PathError."""
        del path_id
        track_paths(points, yaw, speed, least, **self.params.profile())  # refuses what is no path
        self.clear()
        xy = np.asarray(points, np.float64)[:, :2]
        allowed = np.minimum(np.asarray(speed, np.float64), min(most, self.params.max_speed))
        self._path = Followed(xy, np.asarray(yaw, np.float64), allowed, goal_yaw)
        self._along = np.concatenate([[0.0], np.hypot(*np.diff(xy, axis=0).T).cumsum()])
        try:
            self._drive = self._named() if isinstance(self._named, type) else self._named
        except Exception as error:  # noqa: BLE001  a fault of others holds the robot, and is told
            self._fault = f"tracker {self._method} failed: {type(error).__name__}: {error}"

    def step(
        self, now: int, x: float, y: float, yaw: float, v: float, wz: float, slope: float = 0.0
    ) -> TrackOutput:
        """As `PathTracker.step`. What the controller raises, or answers that is none, holds the robot."""
        dt = 0.0 if self._now is None else min(max((now - self._now) * 1e-9, 0.0), 0.1)
        self._now = now
        path = self._path
        wrong = self._fault or (
            "" if all(map(math.isfinite, (x, y, yaw, v, wz, slope))) else "pose or velocity is not finite"
        )
        if path is not None and wrong:
            self.pause()
            return TrackOutput(phase=TrackPhase.FOLLOWING, fault=wrong)
        if path is None or self._done:
            self._slew(0.0, 0.0, dt)
            return TrackOutput(self._vx, self._wz, TrackPhase.DONE if self._done else TrackPhase.IDLE)
        near = self._nearest(path, x, y)
        path.nearest = near
        off = np.array([x, y]) - path.points[near]
        after = path.points[min(near + 1, len(path.points) - 1)] - path.points[max(near - 1, 0)]
        course = math.atan2(after[1], after[0])
        told: dict[str, Any] = {
            "distance_left": float(self._along[-1] - self._along[near]),
            "cross_track": float(math.cos(course) * off[1] - math.sin(course) * off[0]),
            "heading_error": float(wrap(path.yaw[near] - yaw)),
            "progress": float(self._along[near]),
            "goal_distance": float(np.hypot(*(path.points[-1] - (x, y)))),
        }
        if np.hypot(*off) > self.params.max_cross_track:
            self.pause()
            return TrackOutput(
                phase=TrackPhase.FOLLOWING, fault=f"{np.hypot(*off):.1f} m off the path", **told
            )
        self._ask(path, Robot(now, x, y, yaw, v, wz, slope), dt, float(path.speed[near]))
        if self._fault:
            self.pause()
            return TrackOutput(phase=TrackPhase.FOLLOWING, fault=self._fault, **told)
        return TrackOutput(
            self._vx, self._wz, TrackPhase.DONE if self._done else TrackPhase.FOLLOWING, **told
        )

    def _nearest(self, path: Followed, x: float, y: float) -> int:
        near = path.nearest
        until = int(np.searchsorted(self._along, self._along[near] + SEARCH_AHEAD, side="right"))
        return near + int(np.hypot(*(path.points[near:until] - (x, y)).T).argmin())

    def _ask(self, path: Followed, robot: Robot, dt: float, most: float) -> None:
        try:
            answer = self._drive(path, robot)
            if answer is None:
                self._done = True
                self._slew(0.0, 0.0, dt)
                return
            vx, wz = (float(value) for value in answer)
            if not (math.isfinite(vx) and math.isfinite(wz)):
                raise ValueError(f"{vx}, {wz} is no velocity")
        except Exception as error:  # noqa: BLE001  a fault of others holds the robot, and is told
            self._fault = f"tracker {self._method} failed: {type(error).__name__}: {error}"
            return
        turn = self.params.max_yaw_rate
        self._slew(min(max(vx, -most), most), min(max(wz, -turn), turn), dt)

    def _slew(self, vx: float, wz: float, dt: float) -> None:
        p = self.params
        braking = abs(vx) < abs(self._vx) or vx * self._vx < 0.0
        step = (p.max_decel if braking else p.max_accel) * dt
        self._vx += min(max(vx - self._vx, -step), step)
        turn = p.max_yaw_accel * dt
        self._wz += min(max(wz - self._wz, -turn), turn)
