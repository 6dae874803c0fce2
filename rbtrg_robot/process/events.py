"""What happens to the stack, the robot, its goal and its map: every change once, for the terminal of `up` and for
/events."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from hal.safety.gate_types import RefusalReason, StopCause
from hal.safety.monitors import STRANGER, raised
from hal.types import NS, ModeRequest, Phase
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.navigation.goal import CHANCE_CHANGED, arrival
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import header, stamp_of

MOST_SAID = 100
"""Different words about strangers: they choose their names."""
QUIET_TIME = 10 * NS
"""[ns] without refusals of a reason until the next one is told."""
CHARGE_MARGIN = 0.1
"""Charge above the one at which the robot stops [0..1], from which on it is called low."""
GRADES = ("info", "warning", "error")
INFO, WARNING, ERROR = msg.Event.INFO, msg.Event.WARNING, msg.Event.ERROR
FAILED = ("aborted", "rejected", "failed")
"""States of goals and missions that somebody did not want."""
KEPT_EVENTS = 200
"""Events that are told to whoever comes late."""
LONGEST_TEXT = 1000
"""Letters of a text: others choose some of them."""
Place = tuple[float, float]
"""x, y [m] in `map`."""


def plain(event: msg.Event) -> dict[str, Any]:
    """An event as JSON tells it: `stamp` and `logged` in s of the source's and the recorder's clock, `place` x, y [m]
    in `map` or None."""
    return {
        "number": event.number,
        "stamp": stamp_of(event) / NS,
        "logged": event.logged / NS,
        "kind": event.kind,
        "severity": GRADES[min(event.severity, ERROR)],
        "text": event.text,
        "who": event.who,
        "place": [round(event.x, 3), round(event.y, 3)]
        if event.has_place and math.isfinite(event.x + event.y)
        else None,
    }


class Events:
    """Takes messages, makes events of what is new in them."""

    HEARS: tuple[Topic, ...] = (
        *(t.ROBOT_STATE, t.GOAL_STATUS, t.MISSION_STATE, t.MAP_STATUS, t.HEARTBEAT, t.ODOM_HEALTH),
        *(t.ODOM, t.TF_STATIC, t.TOUCHED, t.ROBOT_COMMAND, t.GOAL_REQUEST, t.MISSION_REQUEST),
    )

    def __init__(
        self,
        say: Callable[[str], None],
        least_battery: float = -1.0,
        clock: Callable[[], int] = lambda: 0,
        recorder: Callable[[], int] = lambda: 0,
    ) -> None:
        """`say` gets the text of each event at once. `least_battery`: charge at which the robot stops [0..1], negative:
        at none. `clock`: the source's, `recorder`: the recorder's [ns]."""
        self._say = say
        self._least_battery = least_battery
        self._clock, self._recorder = clock, recorder
        self._due: list[msg.Event] = []
        self._kept: deque[dict[str, Any]] = deque(maxlen=KEPT_EVENTS)
        self._number = 0
        self._said: dict[Topic, str] = {}
        self._state = msg.RobotState(battery=1.0)
        self._map = msg.MapStatus()
        self._lost = self._low = self._returns = False
        self._strangers: set[str] = set()
        self._chance = math.nan
        """Probability of failure when a change of it was last told; NaN: none was."""
        self._refused: dict[str, tuple[int, int]] = {}
        """Of each reason: how many, and when the newest came [ns]."""
        self._asked: dict[str, str] = {}
        """Who asked for what last, by the request."""
        self._frame = MapFrame()
        self._odom: msg.Odometry | None = None

    def happened(
        self, kind: str, text: str, severity: int = INFO, who: str = "", at: Place | None = None
    ) -> None:
        """An event; `at` is where the robot is unless given."""
        self._say(text)
        self._number += 1
        place = at or self._place()
        self._due.append(
            msg.Event(
                header=header(self._clock(), MAP),
                logged=self._recorder(),
                number=self._number,
                severity=severity,
                kind=kind,
                text=text[:LONGEST_TEXT],
                who=who[:LONGEST_TEXT],
                has_place=place is not None,
                x=place[0] if place else 0.0,
                y=place[1] if place else 0.0,
            )
        )

    def due(self) -> list[msg.Event]:
        """Those that were not handed out yet."""
        due, self._due = self._due, []
        self._kept.extend(map(plain, due))
        return due

    def newest(self) -> list[dict[str, Any]]:
        """Those that were handed out, as `plain` tells them; any thread may ask."""
        return list(self._kept.copy())

    def _place(self) -> Place | None:
        if self._odom is None or not self._frame.known:
            return None
        here = self._odom.pose.pose.position
        x, y, _ = self._frame.pose2(here.x, here.y, 0.0)
        return (x, y) if math.isfinite(x) and math.isfinite(y) else None

    def take(self, topic: Topic, message: Any) -> None:
        """One message of any topic."""
        if t.GOAL_STATUS.carried(message, topic):
            self._goal(message)
        elif t.MISSION_STATE.carried(message, topic):
            self._mission(message)
        elif t.ROBOT_STATE.carried(message, topic):
            self._robot(message)
        elif t.MAP_STATUS.carried(message, topic):
            self._mapped(message)
        elif t.HEARTBEAT.carried(message, topic):
            self.strangers(message.detail)
        elif t.ODOM_HEALTH.carried(message, topic):
            self._odometry(message)
        elif t.ODOM.carried(message, topic):
            self._odom = message
        elif t.TF_STATIC.carried(message, topic):
            self._frame.take(message)
        elif t.TOUCHED.carried(message, topic):
            at = message.pose.position
            self.happened("touch", "touched something that no LiDAR sees", WARNING, at=(at.x, at.y))
        elif t.ROBOT_COMMAND.carried(message, topic):
            if message.mode == ModeRequest.RESUME:
                self._asked["resume"] = message.cause
        elif t.GOAL_REQUEST.carried(message, topic):
            if message.action == msg.GoalRequest.CANCEL:
                self._asked["cancel"] = message.owner
        elif t.MISSION_REQUEST.carried(message, topic):
            self._asked["mission"] = message.owner

    def strangers(self, detail: str) -> None:
        """Who publishes what belongs to this stack, once; every process that hears it tells so."""
        for words in detail.split("; "):
            if (
                STRANGER in raised(words)
                and words not in self._strangers
                and len(self._strangers) < MOST_SAID
            ):
                self._strangers.add(words)
                self.happened("stranger", words, WARNING)

    def _goal(self, status: msg.GoalStatus) -> None:
        if status.state in ("accepted", "idle"):
            return
        detail = f" ({status.detail})" if status.detail else ""
        why = f": {status.reason}{detail}" if status.reason else ""
        text = f"goal {status.id[:8]} {status.state}{why}" if status.id else ""
        if self._new(t.GOAL_STATUS, text):
            moving = status.state == "moving"
            chance = arrival(status.p_fail, status.worst) if moving else ""
            who = self._asked.get("cancel", "") if status.state == "cancelled" else status.owner
            at = (status.x, status.y) if moving else None
            self.happened("goal", ", ".join(filter(None, (text, chance))), _grade(status.state), who, at)

        if not status.chance_change:
            self._chance = math.nan
        elif (
            not abs(status.p_fail - self._chance) < CHANCE_CHANGED
        ):  # every plan differs a little from the one before
            self._chance = status.p_fail
            self.happened("chance", status.chance_change, INFO, status.owner)

    def _mission(self, state: msg.MissionState) -> None:
        if state.warning and not self._returns:
            self.happened("battery", state.warning, WARNING)
        self._returns = bool(state.warning)
        why = state.question or state.reason
        text = f"mission {state.name} {state.phase}" + (f": {why}" if why else "") if state.order_id else ""
        if self._new(t.MISSION_STATE, text):
            who = state.owner if state.phase == "running" else self._asked.get("mission", "")
            self.happened("mission", text, WARNING if state.question else _grade(state.phase), who)

    def _robot(self, state: msg.RobotState) -> None:
        before, self._state = self._state, state
        if state.estop and not before.estop:
            who = state.estop_cause.removeprefix(f"{StopCause.OPERATOR}: ")
            by = who if who != state.estop_cause else ""
            self.happened("stop", f"e-stop: {state.estop_cause}", ERROR, by)
        elif before.estop and not state.estop:
            self.happened("release", "e-stop released", who=self._asked.get("resume", ""))
        if (state.phase == Phase.DISCONNECTED) != (before.phase == Phase.DISCONNECTED):
            away = state.phase == Phase.DISCONNECTED
            text = f"robot {state.phase}: {state.cause}" if away else "robot is back"
            self.happened("contact", text, WARNING if away else INFO)
        if state.phase == Phase.FAULT != before.phase:
            self.happened("fault", f"robot fault: {state.cause}", ERROR)
        if bool(state.taken) != bool(before.taken):
            text = state.taken.partition(";")[0] or "the stack has the motion again"
            self.happened("hands", text, who="" if state.taken else self._asked.get("resume", ""))
        low = state.battery < self._least_battery + CHARGE_MARGIN
        if low and not self._low:
            limit = f"; the robot stops at {100 * self._least_battery:.0f} %"
            self.happened("battery", f"battery at {100 * state.battery:.0f} %{limit}", WARNING)
        self._low = low
        self._refusals(state)

    def _refusals(self, state: msg.RobotState) -> None:
        """What a stop refuses is no news."""
        now = stamp_of(state)
        for reason, count in zip(state.refused_reason, state.refused_count.tolist(), strict=True):
            had, newest = self._refused.get(reason, (0, -QUIET_TIME))
            if count > had and reason != RefusalReason.LATCHED:
                if now - newest >= QUIET_TIME:
                    self.happened("refusal", f"command refused, {reason}", WARNING)
                newest = now
            self._refused[reason] = count, newest

    def _mapped(self, status: msg.MapStatus) -> None:
        before, self._map = self._map, status
        if status.detail and status.detail != before.detail:
            self.happened("map", f"map: {status.detail}")
        if status.location_detail and status.location_detail != before.location_detail:
            self.happened("place", f"map: {status.location_detail}")
        if status.warning != before.warning:
            self.happened(
                "map", f"map: {status.warning or 'well again'}", WARNING if status.warning else INFO
            )

    def _odometry(self, health: msg.OdometryHealth) -> None:
        lost = health.health == "lost"
        if lost != self._lost:
            self._lost = lost
            text = f"odometry lost: {health.reason}" if lost else "odometry knows the place again"
            self.happened("odometry", text, ERROR if lost else INFO)
        if (health.calibration or t.ODOM_HEALTH in self._said) and self._new(
            t.ODOM_HEALTH, health.calibration or "clocks, mounts and parts are well again"
        ):
            text = self._said[t.ODOM_HEALTH]
            self.happened("odometry", f"odometry: {text}", WARNING if health.calibration else INFO)

    def _new(self, topic: Topic, text: str) -> bool:
        """Whether this was not the last that was said of a topic."""
        before, self._said[topic] = self._said.get(topic), text
        return bool(text) and text != before


def _grade(state: str) -> int:
    return WARNING if state in FAILED else INFO
