"""One try of one step: what is ordered meanwhile, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hal.contract import UP
from hal.types import NS
from hal.types import Phase as RobotPhase
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.mission.order import Kind
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.stages.navigation.reasons import Reason, words
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.wire.messages import header, stamp_of

LONGEST_SILENCE = 10.0
"""[s] without a word of the navigator about the goal."""
LONGEST_WAIT = 30.0
"""[s] for getting up or lying down, for a photo, for somebody to tell where the dock is."""
POSTURE_REPEAT = NS // 5
SETTLE_TIME = NS
"""After this long [ns] the robot's state is an answer to the order and not of before."""
PHOTO_REPEAT = 2 * NS
"""[ns] from one request to the next: a camera that nobody looked at loads with the first."""
POSTURES = {Kind.STAND: UP, Kind.SIT: (RobotPhase.SITTING,)}
"""Phases of the robot in which the step is done."""
OF_THE_STEP = frozenset(
    {
        Reason.INVALID,
        Reason.OUTSIDE,
        Reason.KEPT_OUT,
        Reason.IN_OBSTACLE,
        Reason.START_OFF_GRAPH,
        Reason.NO_ROUTE,
        Reason.TOO_RISKY,
        Reason.STUCK,
        Reason.TIMEOUT,
        Reason.PROCESS_LOST,
    }
)
"""A goal that ended for one of these reasons failed; `on_failure` says what follows. For any other reason (an
emergency stop, a fault, another goal) no next step would do better: the mission pauses."""


class Outcome(StrEnum):
    """How a try stands."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    NEEDS_OPERATOR = "needs operator"


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a try stands, in words too."""

    outcome: Outcome
    detail: str = ""


RUNNING = Verdict(Outcome.RUNNING)
DONE = Verdict(Outcome.DONE)


class Attempt:
    """Begins when it is made."""

    def __init__(self, step: msg.MissionStep, now: int, goal_id: str = "") -> None:
        """`now` in ns; `goal_id` of the goal of a `goto` or `home`."""
        self._step = step
        self._kind = Kind(step.kind)
        self._began = now
        self._goal_id = goal_id
        self._heard = now
        self._ordered = now - PHOTO_REPEAT
        self.photo = 0
        """Stamp of the newest photo [ns]."""
        self.answer = ""
        """What the operator answered."""

    def orders(self, now: int) -> Outputs:
        """What to tell the robot and its camera."""
        if self._kind is Kind.PHOTO and now - self._ordered >= PHOTO_REPEAT:
            self._ordered = now
            return [(t.PHOTO_REQUEST, msg.String(data=self._step.id))]
        if self._kind not in POSTURES or now - self._ordered < POSTURE_REPEAT:
            return []
        self._ordered = now
        order = msg.RobotCommand(header=header(now, ""), mode=self._kind.value, cause="mission")
        return [(t.ROBOT_COMMAND, order)]

    def verdict(self, now: int, goal: msg.GoalStatus | None, robot: msg.RobotState | None) -> Verdict:
        """From the newest words of navigator and robot; `now` in ns."""
        age = (now - self._began) / NS
        if self._kind in (Kind.GOTO, Kind.HOME):
            return self._of_goal(now, goal)
        if self._kind is Kind.ASK:
            return self._of_answer(age)
        if self._kind in POSTURES:
            return self._of_posture(age, robot)
        if self._kind is Kind.PHOTO and self.photo <= self._began:
            late = f"no photo within {LONGEST_WAIT:.0f} s: the camera gives no picture"
            return Verdict(Outcome.FAILED, late) if age > LONGEST_WAIT else RUNNING
        return DONE if age >= self._step.duration else RUNNING

    def _of_goal(self, now: int, goal: msg.GoalStatus | None) -> Verdict:
        ours = goal is not None and goal.id == self._goal_id
        if goal is not None and ours:
            self._heard = max(self._heard, stamp_of(goal))
        if goal is None or not ours or (state := GoalState(goal.state)).active:
            if (now - self._heard) / NS > LONGEST_SILENCE:
                silent = "the navigator does not answer; see `rbtrg-robot status`"
                return Verdict(Outcome.NEEDS_OPERATOR, silent)
            return RUNNING
        if state is GoalState.REACHED:
            return DONE
        why = words(goal.reason, goal.detail)
        known = Reason.of(goal.reason) in OF_THE_STEP
        return Verdict(Outcome.FAILED if known else Outcome.NEEDS_OPERATOR, why)

    def _of_answer(self, age: float) -> Verdict:
        if self.answer:
            good = self.answer == self._step.choices[0]
            return Verdict(Outcome.DONE if good else Outcome.FAILED, f"answered {self.answer!r}")
        late = 0 < self._step.timeout < age
        return Verdict(Outcome.FAILED, f"no answer within {self._step.timeout:g} s") if late else RUNNING

    def _of_posture(self, age: float, robot: msg.RobotState | None) -> Verdict:
        settled = robot is not None and stamp_of(robot) - self._began > SETTLE_TIME
        if robot is not None and settled:
            if robot.phase in POSTURES[self._kind]:
                return DONE
            if f"{self._kind} refused" in robot.cause:
                return Verdict(Outcome.FAILED, robot.cause)
        if age > LONGEST_WAIT:
            stands = f"the robot is {robot.phase}" if robot else "the robot is silent"
            return Verdict(Outcome.FAILED, f"no `{self._kind}` within {LONGEST_WAIT:.0f} s: {stands}")
        return RUNNING


class GoalStep:
    """What steps share that send one goal after the other, and ask the planner nothing."""

    _drive: Attempt | None = None
    """The goal that is driven to."""
    answer = ""

    def drives(self, goal_id: str, now: int) -> None:
        """The goal to `target` was sent as `goal_id`."""
        self._drive = Attempt(msg.MissionStep(kind=Kind.GOTO.value), now, goal_id)

    def orders(self, now: int, pose: Pose2 | None = None) -> Outputs:
        """Nothing is asked."""
        del now, pose
        return []

    def take(self, views: msg.Viewpoints, now: int) -> None:
        """It concerns explorations."""

    def way_home(self, driven: float) -> float:
        """[m], along what was driven."""
        return driven
