"""The tracker drives the navigator's path at 50 Hz, and stands whenever what it relies on is old."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hal.safety.monitors import TRACKER_STALE
from hal.types import NS
from planning.tracking.door import OwnTracker
from planning.tracking.tracker import PathError, PathTracker, TrackerConfig, TrackOutput, TrackPhase
from planning.tracking.types import OURS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stage_config import FreshnessConfig
from rbtrg_robot.stages.looking import Look
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import BASE, up_tilt, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import header, stamp_of

LOOKING = "looking"
"""Phase beside those of `TrackPhase`."""
STEEPEST_LOOK = 0.5 * math.pi
"""A look down by more is a broken message [rad]."""


class TrackerStage:
    """A path or a look in, velocity commands and tilts of the trunk out.
    In: the navigator's path, the control pose, the ages of odometry, map and goal. Out: velocity commands
    at 50 Hz and its state. It decides the velocity along the path, and zero when an input is old. It never
    changes the path and never recovers by itself.
    """

    inputs = (t.PATH_COMMAND, t.POSE, t.ODOM, t.ODOM_HEALTH, t.MAP_STATUS, t.GOAL_STATUS, t.TF_STATIC)
    outputs = (t.CMD_VEL, t.TRUNK, t.TRACKER_STATE)

    def __init__(self, params: TrackerConfig, freshness: FreshnessConfig) -> None:
        self._tracker = PathTracker(params) if params.method == OURS else OwnTracker(params.method, params)
        self._frame = MapFrame()
        self._limits: dict[Topic, float] = {
            t.POSE: freshness.pose,
            t.ODOM: freshness.scan,
            t.MAP_STATUS: freshness.map,
            t.GOAL_STATUS: freshness.goal,
        }
        self._stamps: dict[Topic, int] = {}
        """Newest stamp of each topic [ns]: what a message tells of counts, not when it came."""
        self._lost = ""
        self._path_id = ""
        self._path_fault = ""
        self._look: Look | None = None
        self._zero_since = 0
        """No velocity has been commanded since then [ns]."""
        self._pose: msg.Odometry | None = None
        self._now = 0
        self._ticks = 0

    def warm_up(self) -> None:
        """Drive a made-up path once."""
        scratch = PathTracker(self._tracker.params)
        line = np.column_stack([np.linspace(0, 1, 51), np.zeros(51), np.zeros(51)])
        scratch.set_path(line, np.zeros(51), np.full(51, 0.5), 0.0)
        for step in range(5):
            scratch.step(step * 20_000_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        if topic in self._limits:
            self._stamps[topic] = stamp_of(message)
        if t.POSE.carried(message, topic):
            self._pose = message
        elif t.PATH_COMMAND.carried(message, topic):
            self._take_path(message)
        elif t.ODOM_HEALTH.carried(message, topic):
            self._lost = message.reason or "lost" if message.health == "lost" else ""
        elif t.TF_STATIC.carried(message, topic) and self._frame.take(message):
            self._tracker.clear()  # it lay elsewhere
        return []

    def _take_path(self, message: msg.PathCommand) -> None:
        if message.id == self._path_id and message.id:
            return  # a repeat
        self._path_id = message.id
        self._path_fault = ""
        self._look = None
        if len(message.x) == 0:
            self._tracker.clear()
            if 0.0 < message.look <= STEEPEST_LOOK:
                self._look = Look(message.look)
            elif message.look != 0.0:
                self._path_fault = f"path refused: nobody looks down by {message.look:g} rad"
            return
        points = np.column_stack([message.x, message.y, message.z])
        goal_yaw = message.goal_yaw if message.has_goal_yaw else None
        try:
            least = message.least_speed if len(message.least_speed) else 0.0
            most = math.inf if message.creep == 0.0 else message.creep
            self._tracker.set_path(points, message.yaw, message.speed, goal_yaw, least=least, most=most)
        except PathError as error:
            self._tracker.clear()
            self._path_fault = f"path refused: {error}"

    def tick(self, now: int) -> Outputs:
        """One control step."""
        if now < self._now:
            self._stamps.clear()
        self._now = now
        self._ticks += 1
        hold = self._hold() if self._tracker.has_path or self._path_fault or self._look else ""
        if self._pose is None or hold:
            step = TrackOutput()
            self._tracker.pause()
        else:
            pose, twist = self._pose.pose.pose, self._pose.twist.twist
            x, y, yaw = self._frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
            step = self._tracker.step(
                now, x, y, yaw, twist.linear.x, twist.angular.z, up_tilt(pose.orientation)
            )
        command = msg.TwistStamped(header=header(now, BASE))
        command.twist.linear.x = float(step.vx)
        command.twist.angular.z = float(step.wz)
        if step.vx != 0.0 or step.wz != 0.0:
            self._zero_since = now
        outputs: Outputs = [(t.CMD_VEL, command)]
        if self._look is not None and not hold and (pitch := self._look.step(now, self._zero_since)) > 0.0:
            outputs.append((t.TRUNK, msg.TrunkCommand(header=header(now, BASE), pitch=pitch)))
        if self._ticks % 5 == 0:
            outputs.append((t.TRACKER_STATE, self._state(now, step, hold)))
        return outputs

    def _hold(self) -> str:
        """Why the robot must stand although it has a path."""
        if self._path_fault:
            return self._path_fault
        if not self._frame.known:
            return f"no {t.TF_STATIC.name} yet"
        if self._lost:
            return f"localization lost: {self._lost}"
        for topic, limit in self._limits.items():
            if topic not in self._stamps:
                return f"no {topic.name} yet"
            age = (self._now - self._stamps[topic]) / NS
            if TRACKER_STALE.outside(age, low=-limit, high=limit):
                if age < 0.0:
                    return f"{topic.name} is stamped {-age:.2f} s ahead of the clock"
                return TRACKER_STALE.tell(topic=topic.name, age=f"{age:.2f}", limit=limit)
        return ""

    def _state(self, now: int, step: TrackOutput, hold: str) -> msg.TrackerState:
        phase = step.phase.value
        if self._look is not None:
            phase = TrackPhase.DONE.value if self._look.over else LOOKING
        return msg.TrackerState(
            header=header(now, "map"),
            path_id=self._path_id,
            phase="stopped" if hold else phase,
            hold=hold or step.fault,
            slow=step.slow,
            distance_left=float(step.distance_left),
            cross_track=float(step.cross_track),
            heading_error=float(step.heading_error),
        )


def build(config: StackConfig) -> TrackerStage:
    """From the stack's configuration."""
    return TrackerStage(config.tracker_config(), config.freshness)
