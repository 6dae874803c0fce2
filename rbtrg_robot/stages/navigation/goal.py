"""A goal as the navigator holds it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from hal.rotation import wrap
from hal.safety.geofence import NO_FENCE, Fence
from rbtrg_robot import msg
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.stages.navigation.reasons import Reason
from rbtrg_robot.wire.convert import BASE, MAP, ODOM, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import header, stamp_of


class GoalState(StrEnum):
    """Lifecycle: accepted -> planning -> moving <-> recovering, paused -> one of the terminal states."""

    IDLE = "idle"
    ACCEPTED = "accepted"
    PLANNING = "planning"
    MOVING = "moving"
    RECOVERING = "recovering"
    PAUSED = "paused"
    REACHED = "reached"
    REJECTED = "rejected"
    ABORTED = "aborted"
    CANCELLED = "cancelled"
    PREEMPTED = "preempted"

    @property
    def active(self) -> bool:
        """Still being worked on."""
        return self in ACTIVE

    @property
    def terminal(self) -> bool:
        """Ended."""
        return self is not GoalState.IDLE and self not in ACTIVE


ACTIVE = (
    GoalState.ACCEPTED,
    GoalState.PLANNING,
    GoalState.MOVING,
    GoalState.RECOVERING,
    GoalState.PAUSED,
)


KNOWN_IDS = 1000
"""Goals, and requests, whose ids are remembered: a late repeat of an old one must not set the robot going."""
CHANCE_CHANGED = 0.05
"""A chance that differs by less is much the same."""
UNSEEN_TOLD = 0.2
"""Less of a way over unseen ground [m] is not told."""


@dataclass(frozen=True, slots=True)
class GoalArea:
    """What goals must lie in, and out of."""

    fence: Fence = NO_FENCE
    room: float = 0.0
    """That the robot needs to the fence [m]."""

    @classmethod
    def of(cls, config: StackConfig, fence: Fence | None = None) -> GoalArea:
        """Those of a stack's configuration, or of a fence for its robot."""
        return cls(
            config.fence() if fence is None else fence,
            math.hypot(config.gate.fence_margin, config.facts.body.width / 2),
        )

    def beside(self, drawn: Fence) -> GoalArea:
        """With those that were drawn."""
        return GoalArea(self.fence.and_all_of(drawn), self.room)


def over_unseen(plan: msg.Plan) -> str:
    """How much of a way leads over ground that nobody saw or that is assumed, in plain words; empty for less than
    `UNSEEN_TOLD`. At most: each transition counts with the unseen share of its worst pose."""
    if len(plan.transition_length) != len(plan.transition_unknown):
        return ""
    metres = float(plan.transition_length @ plan.transition_unknown)
    return (
        f"up to {metres:.1f} m of the way lead over ground that nobody saw" if metres >= UNSEEN_TOLD else ""
    )


def arrival(p_fail: float, worst: str) -> str:
    """The chance of a route in words; empty where it is not known."""
    if math.isnan(p_fail):
        return ""
    share = "more than 99" if p_fail < 0.01 else f"{100 * (1.0 - p_fail):.0f}"
    return f"{share} % to arrive" + (f"; worst: {worst}" if worst else "")


def chance_change(before: tuple[float, str], now: tuple[float, str]) -> str:
    """Why a chance is another than before, each as probability of failure and its worst place; empty for less than
    `CHANCE_CHANGED`."""
    if not abs(now[0] - before[0]) >= CHANCE_CHANGED:
        return ""
    was, is_ = (f"{100 * (1.0 - p):.0f} % (worst: {worst or 'nothing'})" for p, worst in (before, now))
    return f"the chance to arrive was {was}, it is {is_}"


@dataclass(slots=True)
class Goal:
    """One goal in frame `map`, once `move_to_map` was called."""

    id: str
    x: float
    y: float
    yaw: float | None
    accepted: int
    """Source clock [ns]."""
    timeout: float = 0.0
    """[s]; 0 = never."""
    owner: str = ""
    """Who asked for it."""
    state: GoalState = GoalState.ACCEPTED
    reason: Reason = Reason.NONE
    detail: str = ""
    replans: int = 0
    recoveries: int = 0
    begun: bool = False
    """There was a route."""
    frontier: bool = False
    risk: float = 0.0
    accept_risk: bool = False
    """It is driven however likely it fails."""
    no_return: bool = False
    """Nobody takes the robot home while it may be needed."""
    p_fail: float = math.nan
    """Probability that the route fails, NaN: not known."""
    worst: str = ""
    """Where that is most likely."""
    first: tuple[float, str] = (math.nan, "")
    """Both of its first route."""

    @classmethod
    def from_request(cls, message: msg.GoalRequest, now: int) -> Goal:
        """From rbtrg_msgs/GoalRequest. One without an id is known by its stamp: otherwise the next would be taken for a
        repeat of it."""
        yaw = message.yaw if message.has_yaw else None
        known = message.id or f"request-{stamp_of(message) or now}"
        goal = cls(known, message.x, message.y, yaw, now, message.timeout, message.owner)
        goal.accept_risk, goal.no_return = message.accept_risk, message.no_return
        return goal

    @classmethod
    def from_pose(cls, message: msg.PoseStamped, now: int) -> Goal:
        """From geometry_msgs/PoseStamped, as RViz sends it."""
        p, q = message.pose.position, message.pose.orientation
        return cls(f"rviz-{stamp_of(message) or now}", p.x, p.y, yaw_of(q), now, owner="/goal_pose")

    @classmethod
    def from_status(cls, message: msg.GoalStatus, now: int) -> Goal:
        """As a navigator that is gone told it last."""
        yaw = message.yaw if message.has_yaw else None
        return cls(
            message.id, message.x, message.y, yaw, now, owner=message.owner, no_return=message.no_return
        )

    def foreign(self, owner: str) -> str:
        """Who did what its own owner should know of; empty where he did it himself."""
        return "" if owner == self.owner else f"by {owner or 'somebody without a name'}"

    def move_to_map(self, frame_id: str, frame: MapFrame, pose: Pose2 | None) -> tuple[Reason, str] | None:
        """Take the place as one in `frame_id` and turn it into one in `map`; why that cannot be, or None.

        `frame`: where `odom` lies in `map`; `pose` of base_link in `map`, both of now.
        """
        if frame_id == MAP:
            return None
        if frame_id not in (ODOM, BASE):
            return Reason.INVALID, f"frame {frame_id!r} is none of {MAP}, {ODOM}, {BASE}"
        if frame_id == ODOM:
            offset = (frame.x, frame.y, frame.yaw) if frame.known else None
        else:
            offset = pose
        if offset is None:
            return Reason.INVALID, f"where {frame_id} lies in {MAP} is not known yet"
        x0, y0, turn = offset
        c, s = math.cos(turn), math.sin(turn)
        self.x, self.y = x0 + c * self.x - s * self.y, y0 + s * self.x + c * self.y
        if self.yaw is not None:
            self.yaw = wrap(self.yaw + turn)
        return None

    @property
    def finite(self) -> bool:
        """Whether its numbers are."""
        return all(math.isfinite(v) for v in (self.x, self.y, self.yaw or 0.0, self.timeout))

    def misplaced(self, area: GoalArea) -> tuple[Reason, str] | None:
        """Why the robot cannot go there; None where it can."""
        if not self.finite:
            return Reason.INVALID, "it has numbers that are not finite"
        breach, by = area.fence.breach(self.x, self.y)
        if by is None or breach <= -area.room:
            return None
        reason = Reason.KEPT_OUT if by.keep_out else Reason.OUTSIDE
        if breach > 0.0:
            return reason, f"by {breach:.1f} m" + (f", {by.name}" if by.name else "")
        return reason, f"only {-breach:.2f} m to {by.words}; the body needs {area.room:.2f} m"

    def end(self, state: GoalState, reason: Reason, detail: str = "") -> None:
        """Enter a terminal state."""
        self.state, self.reason, self.detail = state, reason, detail

    def place(self, pose: Pose2 | None) -> str:
        """Where the robot was when it gave up, for the detail."""
        if pose is None:
            return ""
        left = math.dist(pose[:2], (self.x, self.y))
        return f"; the robot is at x {pose[0]:.2f} y {pose[1]:.2f}, {left:.2f} m from the goal"

    def status(self, now: int, distance_left: float) -> msg.GoalStatus:
        """rbtrg_msgs/GoalStatus in frame `map`; `now` [ns], `distance_left` along the path [m]."""
        return msg.GoalStatus(
            header=header(now, "map"),
            id=self.id,
            owner=self.owner,
            state=self.state.value,
            reason=self.reason.value,
            detail=self.detail,
            x=self.x,
            y=self.y,
            yaw=self.yaw or 0.0,
            has_yaw=self.yaw is not None,
            no_return=self.no_return,
            distance_left=distance_left if self.state is GoalState.MOVING else 0.0,
            replans=self.replans,
            recoveries=self.recoveries,
            risk=self.risk,
            frontier=self.frontier,
            p_fail=self.p_fail,
            worst=self.worst,
            chance_change=chance_change(self.first, (self.p_fail, self.worst)),
        )


def status_of(goal: Goal | None, now: int, distance_left: float) -> msg.GoalStatus:
    """What is told of the newest goal, or that there was none."""
    if goal is None:
        return msg.GoalStatus(header=header(now, "map"), state=GoalState.IDLE.value, p_fail=math.nan)
    return goal.status(now, distance_left)


def goal_request(
    stamp: int, goal_id: str, x: float, y: float, yaw: float | None = None, **fields: Any
) -> msg.GoalRequest:
    """rbtrg_msgs/GoalRequest for a place [m] and heading [rad] in frame `map`; `stamp` [ns]."""
    return msg.GoalRequest(
        header=header(stamp, "map"),
        id=goal_id,
        x=x,
        y=y,
        yaw=yaw or 0.0,
        has_yaw=yaw is not None,
        **fields,
    )
