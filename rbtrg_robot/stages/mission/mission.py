"""One mission: its order, how far it is, and the messages that hold all of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from rbtrg_robot import msg
from rbtrg_robot.stages.mission.cursor import Cursor
from rbtrg_robot.stages.mission.order import Kind
from rbtrg_robot.wire.messages import array, header

OURS = "mission/"
"""Ids of goals that a mission sends begin with it."""


class Phase(StrEnum):
    """Lifecycle: running <-> holding, paused -> one of the terminal phases."""

    IDLE = "idle"
    RUNNING = "running"
    HOLDING = "holding"
    """No operator is in contact; it goes on by itself when one is."""
    PAUSED = "paused"
    """It goes on only when told to."""
    FINISHED = "finished"
    FAILED = "failed"
    STOPPED = "stopped"

    @property
    def active(self) -> bool:
        """Not ended."""
        return self in (Phase.RUNNING, Phase.HOLDING, Phase.PAUSED)


class Status(StrEnum):
    """VDA 5050 actionStatus."""

    WAITING = "WAITING"
    INITIALIZING = "INITIALIZING"
    RUNNING = "RUNNING"
    PAUSED = "PAUSED"
    FINISHED = "FINISHED"
    FAILED = "FAILED"


@dataclass(slots=True)
class Mission:
    """All that must survive a restart."""

    order: msg.MissionOrder
    cursor: Cursor
    status: list[Status]
    result: list[str]
    phase: Phase = Phase.RUNNING
    reason: str = ""
    returning: bool = False
    failure: str = ""
    """Why it returns."""
    tries: int = 0
    goal_id: str = ""
    """The goal that is under way; empty where none is."""
    goals: int = 0
    asking: bool = False
    memory: str = ""
    """What the present step must remember over an interruption, as JSON."""
    home: msg.MissionStep = field(default_factory=msg.MissionStep)

    @classmethod
    def begin(cls, order: msg.MissionOrder) -> Mission:
        """A new one."""
        count = len(order.steps)
        cursor = Cursor(count, order.loops, order.start)
        return cls(order, cursor, [Status.WAITING] * count, [""] * count, home=_home(order))

    @classmethod
    def restore(cls, order: msg.MissionOrder, state: msg.MissionState) -> Mission | None:
        """From the last words of a process that is gone; None where they do not belong together."""
        here = state.order_id and state.order_id == order.order_id
        fits = len(state.action_id) == len(order.steps) and len(state.loop_rounds) == len(order.loops)
        known = state.phase in Phase._value2member_map_ and 1 <= state.step <= len(order.steps)
        if not (here and fits and known and set(state.action_status) <= set(Status)):
            return None
        return cls(
            order,
            Cursor(len(order.steps), order.loops, state.step, state.loop_rounds.tolist()),
            [Status(s) for s in state.action_status],
            list(state.result_description),
            Phase(state.phase),
            state.reason,
            state.returning,
            state.failure,
            state.tries,
            state.goal_id,
            state.goals,
            memory=state.memory,
            home=_home(order),
        )

    @property
    def step(self) -> msg.MissionStep:
        """What is to be done now."""
        return self.home if self.returning else self.order.steps[self.cursor.at - 1]

    @property
    def ends_at(self) -> tuple[float, float, float] | None:
        """x, y [m], heading [rad] of home where a step from now on leads there; None where the mission ends
        elsewhere."""
        ahead = self.order.steps[self.cursor.at - 1 :]
        home = self.order.home_x, self.order.home_y, self.order.home_yaw
        return home if any(step.kind == Kind.HOME for step in ahead) else None

    def mark(self, status: Status, result: str = "") -> None:
        """Of the present step; the way home is none."""
        if not self.returning:
            self.status[self.cursor.at - 1] = status
            self.result[self.cursor.at - 1] = result

    def advance(self) -> bool:
        """To the next step; False at the end."""
        ahead = self.cursor.advance()
        self.tries, self.memory = 0, ""
        if ahead is None:
            return False
        for k in range(ahead[0] - 1, ahead[1]):
            self.status[k], self.result[k] = Status.WAITING, ""
        return True

    def end(self, phase: Phase, reason: str) -> None:
        """Enter a terminal phase."""
        self.phase, self.reason = phase, reason

    def name_goal(self) -> str:
        """Id for the goal of the present step: the one that is under way, or a new one."""
        if not self.goal_id:
            self.goals += 1
            self.goal_id = f"{OURS}{self.order.order_id}/{self.goals}"
        return self.goal_id

    def update(self, order: msg.MissionOrder) -> None:
        """The order's newer version; what was begun is the same in both."""
        begun = self.cursor.at
        extra = len(order.steps) - begun
        rounds = self.cursor.rounds[: len(order.loops)]
        self.order = order
        self.cursor = Cursor(
            len(order.steps), order.loops, begun, rounds + [0] * (len(order.loops) - len(rounds))
        )
        self.status = self.status[:begun] + [Status.WAITING] * extra
        self.result = self.result[:begun] + [""] * extra

    def state(self, now: int) -> msg.MissionState:
        """rbtrg_msgs/MissionState; `now` in ns."""
        step = self.step
        return msg.MissionState(
            header=header(now, self.order.frame),
            order_id=self.order.order_id,
            order_update_id=self.order.order_update_id,
            name=self.order.name,
            owner=self.order.owner,
            phase=self.phase.value,
            reason=self.reason,
            returning=self.returning,
            failure=self.failure,
            memory=self.memory,
            step=self.cursor.at,
            tries=self.tries,
            loop_rounds=array(self.cursor.rounds, "uint32"),
            goal_id=self.goal_id,
            goals=self.goals,
            question=step.text if self.asking else "",
            choices=list(step.choices) if self.asking else [],
            action_id=[s.id for s in self.order.steps],
            action_type=[s.kind for s in self.order.steps],
            action_status=[s.value for s in self.status],
            result_description=list(self.result),
        )


def _home(order: msg.MissionOrder) -> msg.MissionStep:
    return msg.MissionStep(
        id="home",
        kind=Kind.GOTO.value,
        x=order.home_x,
        y=order.home_y,
        yaw=order.home_yaw,
        has_yaw=True,
        on_failure="stop",
    )
