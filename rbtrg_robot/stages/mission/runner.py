"""Does the steps of a mission one after the other, and what follows when one fails or the operator is gone."""

from __future__ import annotations

from dataclasses import dataclass, field

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.mission.attempt import Attempt, Outcome, Verdict
from rbtrg_robot.stages.mission.cover import Coverage
from rbtrg_robot.stages.mission.dock import Docking
from rbtrg_robot.stages.mission.explore import Exploration
from rbtrg_robot.stages.mission.goal_order import GoalOrder, active
from rbtrg_robot.stages.mission.mission import OURS, Mission, Phase, Status
from rbtrg_robot.stages.mission.order import Blocking, Kind, OnCommsLoss, OnFailure
from rbtrg_robot.stages.mission.reserve import Reserve
from rbtrg_robot.stages.mission.way_home import Place, WayHome
from rbtrg_robot.stages.navigation.goal import goal_request
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.stages.navigation.reasons import Reason, absence, hindrance, words
from rbtrg_robot.stages.stage import Outputs

Roaming = Exploration | Coverage | Docking
"""Steps that send goal after goal."""
RETRY_PAUSE = 2 * NS
"""From a failed try to the next one [ns]."""
RETURN_TRIES = 3
"""More, of the way home."""
TRAIL_STRIDE = 4.0
"""[m] from one goal to the next on the way home along the trail."""


@dataclass(slots=True)
class World:
    """What the mission knows of the others."""

    now: int = 0
    """[ns]"""
    contact: int | None = None
    """When an operator was last heard [ns]; None: count from the next tick."""
    goal: msg.GoalStatus | None = None
    robot: msg.RobotState | None = None
    pose: Pose2 | None = None
    reserve: Reserve = field(default_factory=lambda: Reserve(0.0))
    """Fed with every pose; what driving cost so far in this run."""
    way: WayHome = field(default_factory=WayHome)
    """Likewise: the way home along what was driven."""
    displaced: str = ""
    """Id of somebody's goal that a mission took the place of."""
    photo: int = 0
    """Stamp of the newest photo [ns]."""
    dock: tuple[int, Pose2] | None = None
    """Stamp [ns] and pose in `map` of the dock that was told last."""
    views: msg.Viewpoints | None = None
    """The planner's newest answer to a robot that explores."""

    @property
    def theirs(self) -> bool:
        """A goal of somebody else is under way."""
        return self.goal is not None and active(self.goal) and not self.goal.id.startswith(OURS)

    def others(self) -> str:
        """Who stopped the robot, drives it or sent it elsewhere, in words; empty where nobody does."""
        if self.robot is not None and self.robot.estop:
            return words(Reason.ESTOP, f"{self.robot.estop_cause}; `rbtrg-robot resume` releases it")
        if self.robot is not None and self.robot.taken:
            return words(Reason.TAKEN, self.robot.taken)
        if self.goal is not None and self.theirs and self.goal.id != self.displaced:
            return f"another goal of {self.goal.owner or 'somebody without a name'} is under way"
        return ""

    def hindrance(self) -> str:
        """Why no mission can begin or go on now, and what to do; empty where one can."""
        hinder = hindrance(self.robot)
        if hinder is not None and hinder[0] is not Reason.LYING:  # it may have a step `stand`
            return words(*hinder)
        away = absence(self.robot, None)
        return words(*away) if away is not None else self.others()


class Runner:
    """One mission at a time. Whatever interrupts a step, the step begins anew when the mission goes on."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.mission: Mission | None = None
        self._attempt: Attempt | Roaming | None = None
        self._told = 0
        self._goals = GoalOrder()
        self._retry_at = 0
        self._until_contact = False
        """The robot comes home, until an operator is in contact."""
        self._places: list[Place] = []
        """Where it comes by on that way."""
        self.changed = False
        """The state must be told."""

    def tick(self) -> Outputs:
        """Go on; what to tell navigator and robot."""
        mission, out = self.mission, Outputs()
        if mission and mission.phase is Phase.HOLDING:
            low = self._low(mission)
            if low or not self._out_of_contact(mission):
                mission.phase, mission.reason, self.changed = Phase.RUNNING, "", True
            if low:
                self._give_up(mission, low)
        if mission and mission.phase is Phase.RUNNING:
            out = self._run(mission)
        return out + self.goals()

    def goals(self) -> Outputs:
        """What to tell the navigator."""
        if self.mission and self.mission.goal_id and self._attempt is None:
            return []  # the goal of before a restart is taken up by the next tick
        return self._goals.orders(self._world.now, self._world.goal, self._world.displaced)

    def clock_reset(self) -> None:
        """Times of before mean nothing."""
        self._attempt, self._retry_at, self._world.contact = None, 0, None

    def _run(self, mission: Mission) -> Outputs:
        now = self._world.now
        watched = mission.step.kind in (
            Kind.HOME,
            Kind.EXPLORE,
            Kind.COVER,
            Kind.DOCK,
        )  # it leads home or to a charger, or sees to it itself
        if not watched and (low := self._low(mission)):
            self._give_up(mission, low)
            return []
        if not mission.returning and self._out_of_contact(mission):
            gone = f"no operator in contact for {mission.order.comms_timeout:g} s"
            if mission.order.on_comms_loss == OnCommsLoss.RETURN:
                self._give_up(mission, gone)
                self._until_contact, self._places = True, self._world.way.places(TRAIL_STRIDE)[:-1]
            else:
                self.halt(Phase.HOLDING, gone)
            return []
        if mission.returning and self._until_contact and not self._out_of_contact(mission):
            mission.returning, self._until_contact = False, False
            back = f"{mission.failure}; it came back until one was, `rbtrg-robot mission resume` goes on"
            self.halt(Phase.PAUSED, back)
            return []
        if self._attempt is None:
            if now >= self._retry_at:
                self._begin(mission)
            return []
        if isinstance(self._attempt, Roaming):
            orders, verdict = self._roam(mission, self._attempt)
        else:
            self._attempt.photo = self._world.photo
            orders = self._attempt.orders(now)
            verdict = self._attempt.verdict(now, self._world.goal, self._world.robot)
        if verdict.outcome is Outcome.DONE:
            self._done(mission, verdict.detail)
        elif verdict.outcome is Outcome.FAILED:
            self._failed(mission, verdict.detail)
        elif verdict.outcome is Outcome.NEEDS_OPERATOR:
            self.halt(Phase.PAUSED, verdict.detail)
        return orders

    def _roam(self, mission: Mission, step: Roaming) -> tuple[Outputs, Verdict]:
        world = self._world
        if world.views is not None:
            step.take(world.views, world.now)
            world.views = None
        if isinstance(step, Docking):
            step.see(world.dock)
        way = step.way_home(world.way.length)
        low = "" if mission.order.no_return else world.reserve.short(way)
        back = world.reserve.seconds(way)
        verdict = step.verdict(world.now, world.goal, world.robot, back, low)
        if verdict.outcome is not Outcome.RUNNING:
            return [], verdict
        if step.wants_goal:
            assert step.target is not None
            mission.goal_id = ""  # the next one has an id of its own
            self._send(mission, *step.target)
            step.drives(mission.goal_id, world.now)
        elif step.target is None and mission.goal_id:
            mission.goal_id = ""
            self._goals.want(None)
        if world.now - self._told >= NS and step.progress:
            self._told = world.now
            mission.mark(Status.RUNNING, step.progress)
            mission.memory = step.memory(world.now)
            self.changed = True
        return step.orders(world.now, world.pose), verdict

    def _send(
        self,
        mission: Mission,
        x: float,
        y: float,
        yaw: float | None = None,
        timeout: float = 0.0,
        accept_risk: bool = False,
    ) -> None:
        fields = {
            "timeout": timeout,
            "owner": f"mission {mission.order.name}".strip(),
            "accept_risk": accept_risk,
            "no_return": mission.order.no_return,
        }
        self._goals.want(goal_request(self._world.now, mission.name_goal(), x, y, yaw, **fields))

    def _out_of_contact(self, mission: Mission) -> bool:
        if mission.order.on_comms_loss == OnCommsLoss.CONTINUE:
            return False
        if self._world.contact is None:
            self._world.contact = self._world.now
        return self._world.now - self._world.contact > mission.order.comms_timeout * NS

    def _low(self, mission: Mission) -> str:
        """Why the battery needs the way home to begin; empty where it does not, or it has begun."""
        if mission.order.no_return or mission.returning:
            return ""
        return self._world.reserve.short(self._world.way.length)

    def _begin(self, mission: Mission) -> None:
        """Try the present step. A goal of before a restart goes on: the navigator knows it by its id."""
        step, now = mission.step, self._world.now
        mission.mark(Status.RUNNING)
        if mission.returning and self._places:
            self._send(mission, *self._places[0])
        elif step.kind in (Kind.GOTO, Kind.HOME):
            place = mission.home if step.kind == Kind.HOME else step
            yaw = place.yaw if place.has_yaw else None
            self._send(mission, place.x, place.y, yaw, step.timeout, step.accept_risk)
        mission.asking = step.kind == Kind.ASK
        if step.kind == Kind.EXPLORE:
            mission.goal_id, self._world.views = "", None
            self._attempt = Exploration(step, now, mission.ends_at, mission.memory)
        elif step.kind == Kind.COVER:
            mission.goal_id, home = "", mission.ends_at is not None
            self._attempt = Coverage(step, now, self._world.pose, home, mission.memory)
        elif step.kind == Kind.DOCK:
            mission.goal_id = ""
            self._attempt = Docking(step, now)
        else:
            self._attempt = Attempt(step, now, mission.goal_id)
        self.changed = True
        if step.blocking_type == Blocking.NONE:
            self._done(mission, "")

    def _drop(self, mission: Mission, status: Status, result: str) -> None:
        """Leave the present step."""
        if isinstance(self._attempt, Roaming):
            mission.memory = self._attempt.memory(self._world.now)
        mission.mark(status, result)
        mission.goal_id, mission.asking = "", False
        self._attempt = None
        self._retry_at = self._world.now
        self._goals.want(None)
        self.changed = True

    def _done(self, mission: Mission, detail: str) -> None:
        self._drop(mission, Status.FINISHED, detail)
        if mission.returning and self._places:
            self._places.pop(0)
        elif mission.returning:
            mission.end(Phase.FAILED, f"{mission.failure}; the robot is back")
        else:
            self._next(mission)

    def _next(self, mission: Mission) -> None:
        if not mission.advance():
            mission.end(Phase.FINISHED, "")

    def _failed(self, mission: Mission, why: str) -> None:
        step = mission.step
        self._drop(mission, Status.FAILED, why)
        where = f"step {mission.cursor.at} ({step.kind}): {why}"
        if mission.returning and self._places:
            self._places.pop(0)  # the next one is nearer to home
        elif mission.returning and mission.tries < RETURN_TRIES:
            mission.tries += 1
            self._retry_at = self._world.now + RETRY_PAUSE
        elif mission.returning:
            mission.end(Phase.FAILED, f"{mission.failure}; it did not get back: {why}")
        elif step.on_failure == OnFailure.RETRY and mission.tries < step.retries:
            mission.tries += 1
            self._retry_at = self._world.now + RETRY_PAUSE
        elif step.on_failure == OnFailure.SKIP:
            self._next(mission)
        elif step.on_failure == OnFailure.RETURN:
            self._go_home(mission, where)
        else:
            mission.end(Phase.FAILED, where)

    def _give_up(self, mission: Mission, why: str) -> None:
        self._drop(mission, Status.FAILED, why)
        self._go_home(mission, why)

    def _go_home(self, mission: Mission, why: str) -> None:
        mission.returning, mission.failure, mission.tries = True, why, 0
        self._until_contact, self._places = False, []

    # --- what others and operators do -------------------------------------------------------------------------

    def yield_to_others(self) -> None:
        """Somebody stopped the robot, drives it or sent it elsewhere: the mission goes on only when told to."""
        if self.mission and self.mission.phase in (Phase.RUNNING, Phase.HOLDING):
            why = self._world.others()
            if why:
                self.halt(Phase.PAUSED, why)

    def start(self, order: msg.MissionOrder) -> None:
        """A new mission."""
        self.mission = Mission.begin(order)
        self._attempt, self._retry_at = None, self._world.now

    def halt(self, phase: Phase, why: str) -> None:
        """Stand, until told to go on or until an operator is in contact."""
        mission = self.mission
        assert mission is not None
        self._drop(mission, Status.PAUSED, why)
        mission.phase, mission.reason = phase, why

    def resume(self) -> None:
        """Go on with the present step."""
        assert self.mission is not None
        self.mission.phase, self.mission.reason = Phase.RUNNING, ""
        self._retry_at = self._world.now

    def skip(self) -> None:
        """Leave the present step out."""
        assert self.mission is not None
        self._drop(self.mission, Status.FAILED, "skipped")
        self._next(self.mission)

    def stop(self, why: str) -> None:
        """End it here."""
        assert self.mission is not None
        self._drop(self.mission, Status.FAILED, why)
        self.mission.end(Phase.STOPPED, why)

    def answer(self, text: str) -> str:
        """Take the answer to the present question; why not, in words."""
        mission = self.mission
        if mission is None or not mission.asking or self._attempt is None:
            return "the mission asks nothing now"
        if text not in mission.step.choices:
            return f"{text!r} is none of {', '.join(mission.step.choices)}"
        self._attempt.answer = text
        return ""
