"""Path tracking for a base that turns in place and cannot strafe.

One control step: predict the pose through the drive's lag, find the place on the path (progress never goes back, so
a path may cross itself), steer with curvature feed-forward plus line-of-sight guidance (aim = path heading
+ atan(-cross_track / lookahead)), and drive as fast as the path's profile, the slope, the heading error and the way
to the goal allow. What the base is slower than commanded is learnt and made up for. Where the aim is more than
`turn_threshold` off, the base stops and turns in place first. At the end it stops on the goal and turns to the
requested yaw; a miss is corrected a few times by driving straight to the goal, then accepted and reported.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import ArrayLike

from hal.rotation import wrap
from planning.tracking.learnt import Learnt
from planning.tracking.path import PathError, TrackPath, track_path, track_paths
from planning.tracking.slow import slowed_by
from planning.tracking.stall import TURN_PATIENCE, Stall
from planning.tracking.types import TrackerConfig, TrackOutput, TrackPhase

__all__ = ["PathError", "PathTracker", "TrackOutput", "TrackPhase", "TrackerConfig"]

_SLIDE_BACK = 0.4
"""How far behind the progress [m] the robot may be after sliding back and still steer by the place where it is."""
_START_WINDOW = 1.5
"""How far ahead on a new path the nearest point is looked for [m]: the robot drove on while it was planned. Later it is
as far as the robot may be off: beyond a crossing path could capture it."""
_SETTLE_TIME = 1.5
"""Longest wait for standstill at the goal [s]."""
_TURN_TIME = 15.0
"""Longest time spent on the heading at the goal, corrections of the place included [s]."""
_TURN_LEAST = 0.05
"""A turn on the spot that brings less [rad] in `TURN_PATIENCE` goes on driving back and forth."""
_CREEP_YAW_ACCEL = 0.5
"""[rad/s^2] at most on a path that is crept: at 2.5 the forces of a bend that begins felt like an edge, on level ground
in 18 of 18 simulated drives, at 1.0 and less in none."""


class PathTracker:
    """Holds one path at a time. `set_path`, then `step` at a steady rate (50 Hz); `clear` forgets the path."""

    def __init__(self, params: TrackerConfig | None = None) -> None:
        self.params = params or TrackerConfig()
        self._vx = self._wz = 0.0
        self._now: int | None = None
        self._stall = Stall(self.params)
        self.clear()

    def clear(self) -> None:
        """Forget the path; the next steps brake to zero."""
        self._path: TrackPath | None = None
        self._rest: list[TrackPath] = []
        self._driven = 0.0
        self._goal_yaw: float | None = None
        self._path_id = 0
        self._most = math.inf
        self._reverse = False
        self._phase = TrackPhase.IDLE
        self._s = 0.0
        self._started = False
        self._learnt = Learnt()
        self._tries = 0
        self._missed = False
        self._settle_since: int | None = None
        self._correcting: TrackPath | None = None
        self._turn_began: int | None = None
        self._turn_gained = 0
        self._turn_left = math.inf
        self._rock = 0.0
        self._stopping = False

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
        yaw: ArrayLike | None,
        speed: ArrayLike | float,
        goal_yaw: float | None = None,
        path_id: int = 0,
        least: ArrayLike | float = 0.0,
        most: float = math.inf,
    ) -> None:
        """Follow a new path from the next step on, without stopping where it continues the old one.

        points: (n, 3) or (n, 2) in `map` [m]; yaw: (n,) of the body [rad], against the travel where it drives backward,
        or None; speed, least: (n,) or scalar [m/s], see `track_path`; goal_yaw [rad] of the body at the end, or None;
        most [m/s]: no faster on this path, though a face holds the base or it slips, and with soft bends: it feels its
        way. Raises PathError and keeps the old path.
        """
        p = self.params
        if not most > 0.0:
            raise PathError(f"most must be a positive speed, got {most:g}")
        if goal_yaw is not None and not math.isfinite(goal_yaw):
            raise PathError("goal_yaw must be finite or None")
        path, *rest = track_paths(points, yaw, speed, least, **self.params.profile())
        learnt = self._learnt if path.reverse == self._reverse else Learnt()
        if self._phase is not TrackPhase.FOLLOWING:
            learnt.drift = 0.0
        self.clear()
        self._path, self._rest, self._reverse = path, rest, path.reverse
        self._goal_yaw, self._path_id, self._most = goal_yaw, path_id, most
        self._learnt = learnt
        self._phase = TrackPhase.FOLLOWING
        self._tries = p.goal_retries

    def step(
        self, now: int, x: float, y: float, yaw: float, v: float, wz: float, slope: float = 0.0
    ) -> TrackOutput:
        """Command for this instant.

        now [ns]; x, y [m], yaw [rad]: base_link in `map`; v forward [m/s], wz [rad/s]: measured; slope: inclination
        of the ground [rad]. Never raises: input that is not finite gives zero velocity and `fault`.
        """
        dt = 0.0 if self._now is None else (now - self._now) * 1e-9
        self._now = now
        dt = min(max(dt, 0.0), 0.1)
        if not all(map(math.isfinite, (x, y, yaw, v, wz, slope))):
            self._vx = self._wz = 0.0
            return TrackOutput(
                phase=self._phase, path_id=self._path_id, fault="pose or velocity is not finite"
            )
        path = self._path
        if path is None or self._phase in (TrackPhase.IDLE, TrackPhase.DONE):
            return self._finish(x, y, yaw, dt)
        if self._phase is TrackPhase.FINAL_TURN:
            return self._final(path, now, x, y, yaw, v, wz, dt)
        return self._follow(path, now, x, y, yaw, v, wz, slope, dt)

    # -- driving ---------------------------------------------------------------------------------------------------

    def _follow(
        self,
        path: TrackPath,
        now: int,
        x: float,
        y: float,
        yaw: float,
        v: float,
        wz: float,
        slope: float,
        dt: float,
    ) -> TrackOutput:
        p = self.params
        line = self._correcting or path
        sign = -1.0 if self._reverse else 1.0
        course = yaw if not self._reverse else yaw + math.pi  # direction in which the base travels
        ahead = self._s + (p.max_cross_track if self._started else _START_WINDOW)
        # A base that drifts while it turns at a corner would come back before it there, and turn back.
        back = 0.0 if self._phase is TrackPhase.ALIGNING else _SLIDE_BACK
        s = line.project(x, y, max(self._s - back, 0.0), min(ahead, line.length))
        self._s = max(s, self._s)
        self._started = True
        left = line.length - s
        after = sum(piece.length for piece in self._rest)
        error = wrap(line.at(line.heading, s) - course)
        cross = line.cross(s, x, y)
        goal_x, goal_y = path.goal
        report: dict[str, Any] = {
            "distance_left": left + after,
            "cross_track": cross,
            "heading_error": error,
            "progress": self._driven + (self._s if self._correcting is None else path.length),
            "goal_distance": math.hypot(goal_x - x, goal_y - y),
            "path_id": self._path_id,
        }
        away = math.hypot(x - line.at(line.x, s), y - line.at(line.y, s))
        if away > p.max_cross_track:
            self._vx = self._wz = 0.0
            return TrackOutput(phase=self._phase, fault=f"{away:.1f} m off the path", **report)

        if self._stall.against(v, self._vx, dt):
            self._slew(0.0, 0.0, dt)
            return TrackOutput(self._vx, self._wz, self._phase, slow="it rolls the other way", **report)

        # Pose when a command of now takes effect.
        travel = sign * v * p.lag
        course_p = course + wz * p.lag
        mid = course + 0.5 * wz * p.lag
        x_p, y_p = x + travel * math.cos(mid), y + travel * math.sin(mid)
        s_p = line.project(x_p, y_p, s, min(s + p.max_cross_track, line.length))
        cross_p = line.cross(s_p, x_p, y_p)
        along_p = left - travel * math.cos(error)
        if along_p <= 0.005 and self._rest:
            self._turn_round(path)
            self._slew(0.0, 0.0, dt)
            return TrackOutput(self._vx, self._wz, self._phase, **report)
        if along_p <= 0.005:
            self._phase = TrackPhase.FINAL_TURN
            self._settle_since = now
            return self._final(path, now, x, y, yaw, v, wz, dt)

        # Whether to stop and turn is told by where the base is: at a sharp corner the prediction's heading jumps with
        # every bit of speed, and a base that stops for that never comes to the corner.
        back_to = math.atan2(-cross_p, p.lookahead) - self._learnt.drift
        off = wrap(line.at(line.heading, s) + back_to - course_p)
        # From rest, turning first costs little and saves the swing out of the corridor that a bend would need.
        at_rest = self._vx == 0.0 and abs(v) < 0.05
        hindered = self._stall.turn(now, abs(off), aligning=self._phase is TrackPhase.ALIGNING)
        if abs(off) > (0.5 if at_rest and not hindered else 1.0) * p.turn_threshold:
            self._phase = TrackPhase.ALIGNING
        elif self._phase is TrackPhase.ALIGNING and (hindered or abs(off) < p.turn_release):
            self._phase = TrackPhase.FOLLOWING
        if self._phase is TrackPhase.ALIGNING:
            self._slew(0.0, self._turn_rate(off) if abs(v) < 0.25 else 0.0, dt)
            return TrackOutput(self._vx, self._wz, self._phase, **report)

        off = wrap(line.at(line.heading, s_p) + back_to - course_p)
        # The mean of here and of where the command acts: the profile bounds both.
        profile = min(line.at(line.speed, s), line.at(line.speed, s_p))
        stop = math.sqrt(2.0 * p.max_decel * max(along_p, 0.0))
        tilted, free = self._slope_factor(slope), 0.3 * p.turn_threshold
        turned = min(1.0, max(0.15, (p.turn_threshold - abs(off)) / (p.turn_threshold - free)))
        least = max(p.min_speed, min(profile, stop, line.at(line.least, s)))
        speed = max(min(profile, stop) * tilted * turned, least)
        if self._stall.held(v, self._vx, dt):
            speed = max(speed, min(p.step_speed, stop))
        report["slow"] = slowed_by(line, s, p, (profile, stop, tilted * p.max_speed, turned * p.max_speed))
        rate = line.at(line.curvature, s_p) * abs(self._vx) + p.heading_gain * off
        if abs(v) > 0.1 and abs(cross) < 0.3 and abs(off) < free:
            self._learnt.learn_drift(p.drift_gain * cross_p / p.lookahead * dt)
        if abs(rate) > p.max_yaw_rate:  # keep the bend's shape: slow down rather than cut or widen it
            speed = max(least, speed * p.max_yaw_rate / abs(rate))
        speed = min(speed, self._most)
        wanted = sign * min(self._learnt.command(speed), self._most)
        self._learnt.learn_slip(speed, sign * v, sign * self._vx, dt)
        self._slew(wanted, rate, dt)
        return TrackOutput(self._vx, self._wz, self._phase, **report)

    def _final(
        self, path: TrackPath, now: int, x: float, y: float, yaw: float, v: float, wz: float, dt: float
    ) -> TrackOutput:
        """At the end: rest, correct the position if it is out of tolerance, turn to the goal yaw."""
        p = self.params
        goal_x, goal_y = path.goal
        distance = math.hypot(goal_x - x, goal_y - y)
        turn = 0.0 if self._goal_yaw is None else wrap(self._goal_yaw - yaw)
        predicted = 0.0 if self._goal_yaw is None else wrap(self._goal_yaw - yaw - wz * p.lag)
        resting = abs(v) < 0.05 and self._vx == 0.0
        waited = self._settle_since is not None and now - self._settle_since > _SETTLE_TIME * 1e9
        report: dict[str, Any] = {
            "distance_left": distance,
            "heading_error": turn,
            "progress": self._driven + path.length,
            "goal_distance": distance,
            "path_id": self._path_id,
        }
        turning = self._settle_since is None
        if not (resting or waited or turning):
            self._slew(0.0, 0.0, dt)
            return TrackOutput(self._vx, self._wz, self._phase, **report)
        # The first stop must be inside the tolerance. The turn then wanders, and is kept near the goal while it goes
        # on: a correction on the way would turn it away from the heading again.
        if not turning and distance > 0.9 * p.goal_tolerance and self._tries > 0:
            self._tries -= 1
            self._correct(x, y, yaw, goal_x, goal_y)
            self._slew(0.0, 0.0, dt)
            return TrackOutput(0.0, self._wz, self._phase, **report)
        self._settle_since = None
        if self._turn_began is None:
            self._turn_began = now
        given_up = now - self._turn_began > _TURN_TIME * 1e9
        # A stop is carried through, and judged with hysteresis: at the edge of the tolerance it would start for ever.
        near = abs(predicted) <= (p.yaw_tolerance if abs(wz) < 0.1 else 0.6 * p.yaw_tolerance)
        if abs(turn) <= p.yaw_tolerance and near:
            self._stopping = True
        elif abs(turn) > 1.8 * p.yaw_tolerance:
            self._stopping = False
        if given_up or self._stopping:
            self._slew(0.0, 0.0, dt)
            if self._vx == self._wz == 0.0 and (abs(wz) < 0.1 or given_up):
                self._phase = TrackPhase.DONE
                self._missed = distance > 2.0 * p.goal_tolerance
                return self._finish(x, y, yaw, dt)
        else:
            ahead = math.cos(yaw) * (x - goal_x) + math.sin(yaw) * (y - goal_y)
            self._slew(self._rocking(now, abs(turn), ahead), self._turn_rate(predicted), dt)
        return TrackOutput(self._vx, self._wz, self._phase, **report)

    def _rocking(self, now: int, left: float, ahead: float) -> float:
        """Speed [m/s] while `left` [rad] remain to turn, `ahead` [m] of the goal: 0 while it turns near the goal.

        It keeps within the tolerance: what wandered off is driven back. A wheel that an edge or a slope holds comes
        free when it rolls: first backward, where the robot came from.
        """
        near = 0.8 * self.params.goal_tolerance
        if left < self._turn_left - _TURN_LEAST or self._turn_left == math.inf:
            self._turn_left, self._turn_gained = left, now
        if self._rock == 0.0 and now - self._turn_gained > TURN_PATIENCE * 1e9:
            self._rock = -self.params.min_speed
        if self._rock * ahead > near * abs(self._rock):
            self._rock = -self._rock
        if self._rock == 0.0 and abs(ahead) > near:
            return -math.copysign(self.params.min_speed, ahead)
        return self._rock

    def _turn_round(self, path: TrackPath) -> None:
        """At the end of a stretch in one direction: drive the next one."""
        self._driven += path.length
        self._path = self._rest.pop(0)
        self._reverse = self._path.reverse
        self._s = 0.0
        self._learnt = Learnt()
        self._phase = TrackPhase.FOLLOWING

    def _correct(self, x: float, y: float, yaw: float, goal_x: float, goal_y: float) -> None:
        """Drive straight to the goal, whichever end of the robot is nearer to pointing at it."""
        bearing = math.atan2(goal_y - y, goal_x - x)
        self._reverse = abs(wrap(bearing - yaw)) > math.pi / 2.0
        self._correcting = track_path(
            [(x, y), (goal_x, goal_y)], None, self.params.min_speed, **self.params.profile()
        )
        self._s, self._started = 0.0, False
        self._learnt = Learnt()
        # Aligning, not following: short of the goal there is no room to bend towards it.
        self._phase = TrackPhase.ALIGNING

    def _finish(self, x: float, y: float, yaw: float, dt: float) -> TrackOutput:
        self._slew(0.0, 0.0, dt)
        if self._path is None:
            return TrackOutput(self._vx, self._wz, self._phase)
        goal_x, goal_y = self._path.goal
        distance = math.hypot(goal_x - x, goal_y - y)
        return TrackOutput(
            self._vx,
            self._wz,
            self._phase,
            heading_error=0.0 if self._goal_yaw is None else wrap(self._goal_yaw - yaw),
            progress=self._driven + self._path.length,
            goal_distance=distance,
            path_id=self._path_id,
            missed=self._missed,
        )

    @property
    def _yaw_accel(self) -> float:
        most = self.params.max_yaw_accel
        return most if self._most == math.inf else min(most, _CREEP_YAW_ACCEL)

    def _turn_rate(self, error: float) -> float:
        """Yaw rate that turns by `error` in place and can still brake; never slower than the drive follows."""
        p = self.params
        rate = min(p.max_yaw_rate, math.sqrt(self._yaw_accel * abs(error)))
        return math.copysign(max(rate, p.min_yaw_rate), error)

    def _slope_factor(self, slope: float) -> float:
        p = self.params
        share = (abs(slope) - p.slope_free) / max(p.slope_slow - p.slope_free, 1e-6)
        return 1.0 - (1.0 - p.slope_factor) * min(1.0, max(0.0, share))

    def _slew(self, speed: float, rate: float, dt: float) -> None:
        """Move the command towards speed [m/s] and rate [rad/s] within the accelerations."""
        p = self.params
        slowing = abs(speed) < abs(self._vx) or speed * self._vx < 0.0
        # Braking may be harder than planned: tracking errors cost distance.
        change = (2.0 * p.max_decel if slowing else p.max_accel) * dt
        self._vx += max(-change, min(change, speed - self._vx))
        rate = max(-p.max_yaw_rate, min(p.max_yaw_rate, rate))
        most = self._yaw_accel * dt
        self._wz += max(-most, min(most, rate - self._wz))
