"""Orders to the robot itself: stop, resume, postures."""

from __future__ import annotations

import time
from typing import Any

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.latch import confirms, new_name
from rbtrg_robot.orders.limits import (
    ANSWER_LIMIT,
    REPEAT_PERIOD,
    SETTLE_TIME,
    STOP_PATIENCE,
    USE_HARDWARE,
    WORRY_AFTER,
)
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.orders.who import me
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import header

POSTURES = {
    "stand": ("ready", "moving", "stopped"),
    "sit": ("sitting",),
    "damp": ("damped",),
    "recover": ("ready", "moving", "stopped"),
}
"""What may be asked for, and the phases that mean it is done."""


def command(mode: str, latch: int = 0, cause: str = "") -> msg.RobotCommand:
    """rbtrg_msgs/RobotCommand of now. `cause`: who asks; empty: who runs this process."""
    return msg.RobotCommand(header=header(time.time_ns(), ""), mode=mode, cause=cause or me(), latch=latch)


class Stop(Order):
    """The emergency stop, sent until the robot says that it latched at this one: a state of before is no answer."""

    hears = (t.ROBOT_STATE,)
    sends = (t.ROBOT_STOP,)

    def __init__(self, cause: str = "operator") -> None:
        super().__init__(REPEAT_PERIOD, STOP_PATIENCE)
        self._cause = cause
        self._name = new_name()

    def worried(self, now: float) -> bool:
        """It was sent for longer than WORRY_AFTER without an answer; `now` in s of `tick`."""
        return self.outcome is None and now - self.began > WORRY_AFTER

    def message(self) -> tuple[Topic, msg.Message]:
        """The stop."""
        return t.ROBOT_STOP, command("stop", self._name, self._cause)

    def take(self, topic: Topic, message: Any) -> None:
        """A RobotState."""
        if message.estop and confirms(message.latch, self._name):
            self.outcome = Outcome(True, f"stopped: {message.estop_cause}")

    def silence(self) -> Outcome:
        """Nobody confirms."""
        return Outcome(False, f"the robot does not confirm `stop`; {USE_HARDWARE}")


class Resume(Order):
    """Release what is latched in the first state that is heard, and nothing that comes later."""

    hears = (t.ROBOT_STATE,)
    sends = (t.ROBOT_COMMAND,)

    def __init__(self, owner: str = "") -> None:
        """`owner`: as in `command`."""
        super().__init__(REPEAT_PERIOD, ANSWER_LIMIT)
        self._owner = owner
        self._latch: int | None = None

    def message(self) -> tuple[Topic, msg.Message] | None:
        """Resume, once it is known of what."""
        return None if self._latch is None else (t.ROBOT_COMMAND, command("resume", self._latch, self._owner))

    def take(self, topic: Topic, message: Any) -> None:
        """A RobotState."""
        if message.latch == 0:
            self.outcome = Outcome(True, "resumed" if self._latch else "nothing to resume")
        elif self._latch is None:
            self._latch = message.latch
        elif message.latch != self._latch:  # a stop that came after this order stays
            why = message.estop_cause or message.taken
            self.outcome = Outcome(False, f"stopped again: {why}; `rbtrg-robot resume` once more")

    def silence(self) -> Outcome:
        """Nobody answers."""
        return Outcome(False, "the robot does not confirm `resume`")


class Posture(Order):
    """Stand, sit, damp or recover, until the robot has done it or says why not."""

    hears = (t.ROBOT_STATE,)
    sends = (t.ROBOT_COMMAND,)

    def __init__(self, what: str, limit: float) -> None:
        """`what`: of POSTURES; `limit` [s]."""
        super().__init__(REPEAT_PERIOD, limit)
        self._what = what
        self._limit_said = limit
        self._now = 0.0
        self.said = ""
        """Phase and cause as last heard."""

    def message(self) -> tuple[Topic, msg.Message]:
        """The order."""
        return t.ROBOT_COMMAND, command(self._what)

    def tick(self, now: float) -> list[tuple[Topic, msg.Message]]:
        """What is due."""
        self._now = now
        return super().tick(now)

    def take(self, topic: Topic, message: Any) -> None:
        """A RobotState."""
        self.said = f"{message.phase}: {message.cause}"
        waited = self._now - self.began
        if not waited >= SETTLE_TIME:
            return
        if f"{self._what} refused" in message.cause:
            self.outcome = Outcome(False, message.cause)
        elif message.cause.startswith("dry run"):  # the robot does not do it, and says so
            self.outcome = Outcome(True, "")
        elif message.phase in POSTURES[self._what]:
            latched = f"it stands; `rbtrg-robot resume` lets it drive ({message.estop_cause})"
            self.outcome = Outcome(True, latched if message.phase == "stopped" else "")
        elif message.phase == "fault" and waited > 4 * SETTLE_TIME:
            self.outcome = Outcome(False, "")

    def silence(self) -> Outcome:
        """It did not happen."""
        said = self.said or "the robot does not answer"
        return Outcome(False, f"no `{self._what}` within {self._limit_said:.0f} s ({said})")
