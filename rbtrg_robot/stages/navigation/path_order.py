"""The newest order to the tracker, and whether it follows it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hal.rotation import wrap
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.wire.messages import header

REPEAT_AFTER = NS // 2
"""Who works on something else than it was told, a tracker or a navigator, is told again after this long [ns]."""
LONGEST_LOOK = 2.5 * NS
"""[ns] after which the robot plans without the look: the trunk did not come level, or the tracker is silent."""
OUT_SPEED = 0.3
"""[m/s], or what the robot needs to come over faces: it may have been one that held it."""
HEADING_TOLERANCE = math.radians(10.0)
"""A goal whose heading is farther off is not reached."""


def heading_off(wanted: float | None, yaw: float) -> str:
    """In words how far a robot at its goal that looks along `yaw` [rad] is off the heading `wanted` [rad]; empty within
    `HEADING_TOLERANCE`, or without one."""
    off = 0.0 if wanted is None else abs(wrap(wanted - yaw))
    if off <= HEADING_TOLERANCE:
        return ""
    return f"at the goal, but {math.degrees(off):.0f} deg off its heading: the robot could not turn there"


class PathOrder:
    """Makes rbtrg_msgs/PathCommand in frame `map`. Times in ns."""

    def __init__(self, step_speed: float = 0.0) -> None:
        """`step_speed`: see `Capabilities.step_vx` [m/s]."""
        self._step_speed = step_speed
        self._path: msg.PathCommand | None = None
        self._sent = self._begun = 0

    def route(self, now: int, plan: msg.Plan, creep: float = 0.0) -> msg.PathCommand:
        """Drive the path of a Plan; one onto ground that nobody saw no faster than `creep` [m/s]."""
        fields = {name: getattr(plan, name) for name in ("x", "y", "z", "yaw", "speed", "least_speed")}
        final = plan.has_goal_yaw and plan.reaches_goal
        path_id = f"{plan.goal_id}/{plan.sequence}"
        fields |= {"has_goal_yaw": final, "goal_yaw": plan.goal_yaw, "creep": creep if plan.creep else 0.0}
        return self._send(now, id=path_id, **fields)

    def straight(self, now: int, goal_id: str, pose: Pose2, reach: float) -> msg.PathCommand:
        """Drive straight along the heading, backward where `reach` [m] is negative."""
        s = np.linspace(0.0, reach, max(2, round(abs(reach) / 0.05) + 1))
        x, y, yaw = pose
        return self._send(
            now,
            id=f"{goal_id}/straight-{now}",
            x=x + s * math.cos(yaw),
            y=y + s * math.sin(yaw),
            z=0.0 * s,
            yaw=np.full(len(s), yaw),
            speed=np.full(len(s), max(OUT_SPEED, self._step_speed)),
            least_speed=np.full(len(s), self._step_speed),
        )

    def stand(self, now: int) -> msg.PathCommand:
        """Drive nothing."""
        return self._send(now, id="")

    def look(self, now: int, goal_id: str, pitch: float) -> msg.PathCommand:
        """Tilt the trunk nose-down to `pitch` [rad], and level again."""
        return self._send(now, id=f"{goal_id}/look-{now}", look=pitch)

    def looking(self, now: int, tracker: msg.TrackerState | None) -> bool:
        """Whether the newest order is a look that is not over."""
        if self._path is None or self._path.look == 0.0 or now - self._begun > LONGEST_LOOK:
            return False
        return not (tracker is not None and self.obeyed(tracker) and tracker.phase == "done")

    def _send(self, now: int, **fields: Any) -> msg.PathCommand:
        self._path = msg.PathCommand(header=header(now, "map"), **fields)
        self._sent = self._begun = now
        return self._path

    def obeyed(self, tracker: msg.TrackerState | None) -> bool:
        """Whether a TrackerState speaks of the newest order."""
        return self._path is not None and tracker is not None and tracker.path_id == self._path.id

    def repeat(self, now: int, tracker: msg.TrackerState | None) -> msg.PathCommand | None:
        """The order again where it is due: a tracker that restarted has no path, one that missed a halt still has
        one."""
        if self._path is None or tracker is None or self.obeyed(tracker) or now - self._sent <= REPEAT_AFTER:
            return None
        self._sent = now
        return self._path
