"""State of processes and topics from heartbeats, and the `status` made of it."""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

from hal.safety.monitors import raised
from hal.types import LidarName
from rbtrg_robot import topics as t
from rbtrg_robot.msg import Heartbeat
from rbtrg_robot.processes import BY_NAME, Process
from rbtrg_robot.stages.navigation.goal import arrival
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import stamp_of

RATE_SHARE = 0.8
"""A topic is well at this share of its nominal rate."""
BUSY_AFTER = 1.0
"""[s] without a heartbeat, of two a second."""
RATE_WINDOW = 2.0
"""Rates are measured over about this long [s]."""
SIMULATED_RATE_FLOOR = 0.5
"""A slow simulator slows every topic; its real-time factor is reported beside."""


@dataclass(slots=True)
class TopicHealth:
    """Counts of one publisher's topic."""

    history: list[tuple[float, int]] = field(default_factory=list)
    newest: int = 0

    def add(self, wall: float, count: int, newest: int) -> None:
        """From a heartbeat; `wall` in s, monotonic."""
        if self.history and count < self.history[-1][1]:
            self.history.clear()  # the publisher restarted
        if self.history and self.history[-1][1] == 0:
            self.history.clear()  # it has only just begun: silence before that is no low rate
        self.history.append((wall, count))
        while len(self.history) > 2 and wall - self.history[1][0] > RATE_WINDOW:
            self.history.pop(0)
        self.newest = newest

    @property
    def rate(self) -> float:
        """[Hz of the wall clock]."""
        if len(self.history) < 2:
            return 0.0
        (t0, n0), (t1, n1) = self.history[0], self.history[-1]
        return (n1 - n0) / (t1 - t0) if t1 > t0 else 0.0


class Health:
    """Everything heard from the bus. Fed by the supervisor's loop, read by `status`."""

    WATCHED = (
        t.HEARTBEAT,
        t.ROBOT_STATE,
        t.GOAL_STATUS,
        t.ODOM,
        t.ODOM_HEALTH,
        t.TRACKER_STATE,
        t.MAP_STATUS,
        t.TF_STATIC,
        t.DIAGNOSTICS,
        t.MISSION_STATE,
    )

    def __init__(
        self,
        simulated: bool,
        clock: SourceClock | None = None,
        lidars: Collection[LidarName] = tuple(t.SWEEPS),
    ) -> None:
        """`clock`: of a stack on hardware; `lidars`: those the robot carries."""
        self._simulated = simulated
        self._absent: set[Topic] = set() if simulated else {t.CLOCK, t.TRUTH}
        """Nobody publishes them."""
        self._absent |= {topics[x] for topics in (t.SWEEPS, t.CLOUDS) for x in topics if x not in lidars}
        self._clock = clock or SourceClock()
        self._frame = MapFrame()
        self.newest: dict[Topic, Any] = {}
        self.beats: dict[str, tuple[float, Heartbeat]] = {}
        self._ready: dict[str, float] = {}
        """When each process said first that it is ready [s, monotonic]."""
        self.topics: dict[str, TopicHealth] = {}

    def take(self, topic: Topic, message: Any) -> None:
        """One message of WATCHED. Heartbeats of strangers count for nothing."""
        if t.HEARTBEAT.carried(message, topic):
            if message.process not in BY_NAME:
                return
            wall = time.monotonic()
            self.beats[message.process] = (wall, message)
            if message.state == "ready":
                self._ready.setdefault(message.process, wall)
            for name, count, newest in zip(message.topic, message.published, message.newest, strict=True):
                if name in t.BY_NAME:
                    self.topics.setdefault(name, TopicHealth()).add(wall, int(count), int(newest))
        elif t.TF_STATIC.carried(message, topic):
            self._frame.take(message)
        elif t.DIAGNOSTICS.carried(message, topic):
            for entry in message.status:  # those of the supervisor come back here too
                if entry.name == t.BACKEND_FIGURES:
                    self.newest[topic] = entry
        else:
            self.newest[topic] = message

    def forget(self, process: str) -> None:
        """It died: its last heartbeat says nothing any more."""
        self.beats.pop(process, None)
        self._ready.pop(process, None)

    def is_ready(self, process: str) -> bool:
        """Its newest heartbeat says so."""
        beat = self.beats.get(process)
        return beat is not None and beat[1].state == "ready"

    def beat_age(self, process: str) -> float | None:
        """Seconds since the last heartbeat; None before the first."""
        beat = self.beats.get(process)
        return None if beat is None else time.monotonic() - beat[0]

    def busy(self, process: str) -> bool:
        """It is at work on something long: no heartbeat for a second, after others."""
        age = self.beat_age(process)
        return age is not None and age > BUSY_AFTER

    @property
    def source_now(self) -> int:
        """Source clock [ns] as far as it is known here."""
        if not self._simulated:
            return self._clock()
        state = self.newest.get(t.ROBOT_STATE)
        return 0 if state is None else stamp_of(state)

    @property
    def realtime_factor(self) -> float:
        """Source seconds per wall second."""
        state = self.newest.get(t.ROBOT_STATE)
        return float(state.realtime_factor) if state is not None else math.nan

    def _begins(self, topic: Topic) -> bool:
        """Nothing can be said of its rate yet: its process is not ready, or the robot's, which makes a simulator's
        time, or not for long enough."""
        makers = {topic.owner, "robot" if self._simulated else ""} & BY_NAME.keys()
        since = max((self._ready.get(process, math.inf) for process in makers), default=-math.inf)
        return time.monotonic() - since < RATE_WINDOW

    def topic_row(self, topic: Topic) -> dict[str, Any]:
        """Rate, age and verdict of one topic: `ok` is None where it begins."""
        seen = self.topics.get(topic.name)
        rate = seen.rate if seen else 0.0
        age = (self.source_now - seen.newest) / 1e9 if seen and seen.newest else None
        ok: bool | None
        if topic.rate == 0 or topic in self._absent:
            ok = True
        else:
            share = RATE_SHARE
            if self._simulated and self.realtime_factor < 1.0:
                share *= max(self.realtime_factor, SIMULATED_RATE_FLOOR)
            ok = rate >= share * topic.rate or (None if self._begins(topic) else False)
        if topic is t.HEARTBEAT:
            rate, age, ok = 2.0 * len(self.beats), None, True
        return {"topic": topic.name, "rate": round(rate, 1), "nominal": topic.rate, "age": age, "ok": ok}

    def unhealthy_topics(self, expected: tuple[Topic, ...]) -> list[str]:
        """Names of the topics among `expected` that are not well."""
        return [topic.name for topic in expected if not self.topic_row(topic)["ok"]]

    def robot_row(self) -> dict[str, Any]:
        """The robot and its goal in one flat record."""
        row: dict[str, Any] = {"realtime_factor": None}
        state = self.newest.get(t.ROBOT_STATE)
        if state is not None:
            row |= {
                "mode": state.phase,
                "cause": state.cause,
                "estop": bool(state.estop),
                "estop_cause": state.estop_cause,
                "hold": state.hold,
                "battery": state.battery,
                "realtime_factor": round(state.realtime_factor, 3),
                "refused": {
                    k: int(v) for k, v in zip(state.refused_reason, state.refused_count, strict=True)
                },
            }
        odom = self.newest.get(t.ODOM)
        if odom is not None:
            pose, twist = odom.pose.pose, odom.twist.twist
            x, y, yaw = self._frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
            row |= {
                "x": x,
                "y": y,
                "z": pose.position.z + self._frame.z,
                "yaw": yaw,
                "speed": twist.linear.x,
                "yaw_rate": twist.angular.z,
                "pose_age": round((self.source_now - stamp_of(odom)) / 1e9, 2),
            }
        health = self.newest.get(t.ODOM_HEALTH)
        if health is not None:
            row |= {
                "localization": health.health,
                "localization_reason": health.reason,
                "calibration": health.calibration,
                "lidars": {
                    name: {"time_offset": offset, "sigma": sigma, "applied": applied}
                    for name, offset, sigma, applied in zip(
                        health.lidar,
                        *(
                            a.tolist()
                            for a in (health.time_offset, health.time_offset_sigma, health.time_applied)
                        ),
                        strict=True,
                    )
                },
            }
        elevation = self.newest.get(t.MAP_STATUS)
        if elevation is not None:
            row |= {"map_warning": elevation.warning, "location": elevation.location_detail}
        goal = self.newest.get(t.GOAL_STATUS)
        if goal is not None:
            row["goal"] = {
                "id": goal.id,
                "state": goal.state,
                "reason": goal.reason,
                "detail": goal.detail,
                "x": goal.x,
                "y": goal.y,
                "distance_left": goal.distance_left,
                "replans": goal.replans,
                "recoveries": goal.recoveries,
                "p_fail": None if math.isnan(goal.p_fail) else goal.p_fail,
                "chance": goal.chance_change or arrival(goal.p_fail, goal.worst),
            }
        mission = self.newest.get(t.MISSION_STATE)
        if mission is not None and mission.warning:
            row["warning"] = mission.warning
        if mission is not None and mission.order_id:
            row["mission"] = {
                "name": mission.name,
                "phase": mission.phase,
                "reason": mission.reason,
                "step": mission.step,
                "steps": len(mission.action_id),
                "question": mission.question,
            }
        backend = self.newest.get(t.DIAGNOSTICS)
        if backend is not None:
            row["backend"] = {pair.key: pair.value for pair in backend.values}
        tracker = self.newest.get(t.TRACKER_STATE)
        if tracker is not None:
            row |= {"tracker": tracker.phase, "tracker_hold": tracker.hold, "tracker_slow": tracker.slow}
        row["advice"] = _advice(row, [beat.detail for _, beat in self.beats.values()])
        return row


_CAUSES = (
    "cause",
    "estop_cause",
    "hold",
    "localization_reason",
    "calibration",
    "map_warning",
    "tracker_hold",
)


def _advice(row: dict[str, Any], details: list[str]) -> dict[str, str]:
    """What to do about each raised monitor, by its name, from the words in a record of `robot_row` and of the
    processes."""
    told = [*details, *(str(row.get(key, "")) for key in _CAUSES)]
    told.append(row.get("goal", {}).get("detail", ""))
    return {monitor.name: monitor.remedy for monitor in raised("\n".join(told))}


def expected_topics(
    rows: list[Process], *, simulated: bool, lidars: Collection[LidarName] = ("main", "head")
) -> tuple[Topic, ...]:
    """Topics with a nominal rate that these processes publish. `lidars`: those the robot carries.

    A real robot may lack the LiDAR in its head, whatever the configuration says: nobody waits for it, and `status`
    names its silence.
    """
    names = {row.name for row in rows}
    unreal: set[Topic] = set() if simulated else {t.CLOCK, t.TRUTH}
    for name in t.SWEEPS:
        if name not in lidars or (name != "main" and not simulated):
            unreal |= {t.SWEEPS[name], t.CLOUDS[name]}
    return tuple(x for x in t.TOPICS if x.owner in names and x.rate and x not in unreal)
