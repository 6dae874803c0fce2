"""The step `dock`: to a place before the dock, and from there straight to the pose in which the robot is docked.

The pose stands in the mission, or a program that reads a fiducial tells it on `/dock/pose`. Where one tells it, that
counts: the robot goes the last stretch only while the pose is fresh.
"""

from __future__ import annotations

import math

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.mission.attempt import LONGEST_WAIT, RUNNING, GoalStep, Outcome, Verdict
from rbtrg_robot.stages.navigation.progress import Pose2

DOCK_AHEAD = 0.8
"""[m] before the dock the robot stops, looks along it, and waits for a fresh pose: more than a body length."""
FRESH_POSE = NS
"""[ns] A pose older than this tells nothing."""
SEEN_WITHIN = 5.0
"""[s] before the dock for a fresh pose of it."""
FARTHEST_OFF = 1.0
"""[m] A pose that lies farther from the one of the mission is of another dock."""


class Docking(GoalStep):
    """One try of the step, as `Exploration` is; begins when it is made."""

    def __init__(self, step: msg.MissionStep, now: int) -> None:
        """`now` [ns]; the pose of `step` counts where it has a heading."""
        self._given: Pose2 | None = (step.x, step.y, step.yaw) if step.has_yaw else None
        self._told: tuple[int, Pose2] | None = None
        """When [ns] somebody told the pose last, and the pose."""
        self._since = now
        """When it began to wait for what it waits for [ns]."""
        self._before = False
        """It stands before the dock."""
        self._now = now

    def see(self, told: tuple[int, Pose2] | None) -> None:
        """The newest pose that somebody told: its stamp [ns], x, y [m], yaw [rad] in `map`."""
        if told is None or (self._given and math.dist(told[1][:2], self._given[:2]) > FARTHEST_OFF):
            return
        self._told = told

    @property
    def _pose(self) -> Pose2 | None:
        return self._told[1] if self._told is not None else self._given

    @property
    def _fresh(self) -> bool:
        return self._told is not None and 0 <= self._now - self._told[0] <= FRESH_POSE

    @property
    def target(self) -> Pose2 | None:
        """x, y [m], yaw [rad] to drive to now; None while nobody tells it."""
        pose = self._pose if self._given is not None or self._before or self._fresh else None
        if pose is None or self._before:
            return pose
        x, y, yaw = pose
        return x - DOCK_AHEAD * math.cos(yaw), y - DOCK_AHEAD * math.sin(yaw), yaw

    @property
    def wants_goal(self) -> bool:
        """There is no goal to the target yet."""
        if self._drive is not None or self.target is None:
            return False
        return not self._before or self._told is None or self._fresh

    def memory(self, now: int) -> str:
        """An interrupted try begins anew."""
        del now
        return ""

    def verdict(
        self,
        now: int,
        goal: msg.GoalStatus | None,
        robot: msg.RobotState | None,
        back: float = math.nan,
        low: str = "",
    ) -> Verdict:
        """From the newest words of navigator and robot. A low battery is a reason to dock."""
        del back, low
        self._now = now
        if self._drive is not None:
            drive = self._drive.verdict(now, goal, robot)
            if drive.outcome is Outcome.DONE and not self._before:
                self._before, self._drive, self._since = True, None, now
                return RUNNING
            return Verdict(Outcome.DONE, self.progress) if drive.outcome is Outcome.DONE else drive
        waited = (now - self._since) / NS
        if self._before and not self.wants_goal and waited > SEEN_WITHIN:
            return Verdict(
                Outcome.FAILED, "the dock is not seen from before it: `/dock/pose` is silent or old"
            )
        if self.target is None and waited > LONGEST_WAIT:
            return Verdict(
                Outcome.FAILED,
                "nobody tells where the dock is: publish `/dock/pose`, or give x, y and yaw_deg",
            )
        return RUNNING

    @property
    def progress(self) -> str:
        """How far it is, in words."""
        pose = self._pose
        if pose is None:
            return "waits for the pose of the dock"
        x, y, yaw = pose
        told = "as seen" if self._told is not None else "as the mission has it"
        where = "at the dock" if self._before else "on the way to before the dock"
        return f"{where}, {x:.2f} {y:.2f}, {math.degrees(yaw):.0f} deg, {told}"
