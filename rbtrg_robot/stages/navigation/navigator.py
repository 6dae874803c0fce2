"""The navigator owns the goal: it asks for routes, hands paths to the tracker, and knows when to give up."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import fence_of
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stage_config import NavigatorConfig
from rbtrg_robot.stages.navigation.behaviours import Action, Behaviours, Trigger
from rbtrg_robot.stages.navigation.goal import KNOWN_IDS, Goal, GoalArea, GoalState, over_unseen, status_of
from rbtrg_robot.stages.navigation.inputs import Inputs
from rbtrg_robot.stages.navigation.path_order import PathOrder, heading_off
from rbtrg_robot.stages.navigation.plan_query import PlanQuery
from rbtrg_robot.stages.navigation.progress import (
    AT_REST,
    STRAY_BESIDE,
    Budget,
    Pose2,
    ProgressMonitor,
    RouteWatch,
    Slide,
    Trail,
)
from rbtrg_robot.stages.navigation.reasons import PATIENCE, Reason, hindrance, unlocated
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.frames import MapFrame

REJECTING = (Reason.INVALID, Reason.OUTSIDE, Reason.KEPT_OUT, Reason.IN_OBSTACLE, Reason.TOO_RISKY)
"""Reasons that refuse a goal that never had a route; later they abort it."""
PLANNER_SILENT = "the planner is silent"
LOOKING = "looking at the ground ahead"
CREEPING = "creeping over ground nobody saw"
MOVE_ON = 0.15
"""[m]: the front wheels stay in the circle that the body turns in, which the planner has looked at."""
HELD_REPLAN = 2.5
"""Seconds from a plan to the next one while the guard holds the robot: the tracker makes a bend of a short turn after 2
s."""
ENDS_NEARER = 0.05
"""[m] by which a plan must end nearer to the goal than a robot that is there, or it is there for good."""
LOOK_AGAIN = 1.0
"""Seconds from a failed plan to the next try."""


class NavigatorStage:
    """Goals in, paths for the tracker and the goal's status out.
    In: goals and cancellations, plans, the state of route, tracker, odometry, map, guard and robot. Out: plan
    requests, paths, the status of the goal. It decides when to plan, to drive, to wait, to recover and to
    give up, and tells the reason. It never computes a route and never publishes a velocity.
    """

    inputs = (
        t.GOAL_REQUEST,
        t.GOAL_POSE,
        t.PLAN,
        t.ROUTE_STATUS,
        t.TRACKER_STATE,
        t.ODOM,
        t.ODOM_HEALTH,
        t.MAP_STATUS,
        t.ROBOT_STATE,
        t.TF_STATIC,
        t.MOTION_LIMITS,
        t.TOUCHED,
        t.AREAS,
    )
    outputs = (t.GOAL_STATUS, t.PLAN_REQUEST, t.PATH_COMMAND)

    def __init__(
        self,
        params: NavigatorConfig,
        area: GoalArea = GoalArea(),
        step_vx: float = 0.0,
        max_trunk_tilt: float = 0.0,
        creep: float = 0.0,
        length: float = 0.70,
        width: float = 0.43,
    ) -> None:
        """`step_vx` [m/s], `max_trunk_tilt` [rad], `creep` [m/s], `length`, `width` [m]: see `Capabilities`."""
        self._tilt, self._creep = max_trunk_tilt, creep
        self._params = params
        self._area, self._configured = area, area
        self._frame = MapFrame()
        self._now = 0
        self._goal: Goal | None = None
        self._known: deque[str] = deque(maxlen=KNOWN_IDS)
        self._pose: Pose2 | None = None
        self._inputs = Inputs()
        self._query = PlanQuery(params.replan_period)
        self._plan: msg.Plan | None = None
        self._radius = 0.5 * math.hypot(length, width)
        self._route = RouteWatch(self._radius)
        self._short = 0
        self._behaviours = self._afresh()
        self._order = PathOrder(step_vx)
        self._progress, self._rest, self._budget = ProgressMonitor(), ProgressMonitor(AT_REST), Budget()
        self._trail = Trail(length, width)
        self._slide = Slide()
        self._trouble = ""
        """Why the robot stood last."""
        self._refused = Reason.NONE
        """Why the newest answer of the planner holds no way."""
        self._missing_since = 0
        self._status_due = 0
        self._out: Outputs = []

    def warm_up(self) -> None:
        """Nothing to compile."""

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        self._out = []
        self._inputs.take(topic, message, self._now)
        if t.ODOM.carried(message, topic):
            if self._frame.known:
                pose = message.pose.pose
                self._pose = self._frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
                self._trail.add(self._pose)
        elif t.TF_STATIC.carried(message, topic):
            if self._frame.take(message):
                self._moved()
        elif t.GOAL_REQUEST.carried(message, topic):
            self._request(message)
        elif t.GOAL_POSE.carried(message, topic):
            self._set(Goal.from_pose(message, self._now), message)
        elif t.PLAN.carried(message, topic):
            self._take_plan(message)
        elif t.ROUTE_STATUS.carried(message, topic) and self._query.is_about_route(message):
            self._route.told(self._now, message)
        elif t.TOUCHED.carried(message, topic):
            self._touched(message)
        elif t.AREAS.carried(message, topic):
            self._area = self._configured.beside(fence_of(message.areas))
        elif t.GOAL_STATUS.carried(message, topic):
            self._restore(message)
        return self._out

    def _moved(self) -> None:
        self._pose = None
        self._trail.forget()
        if not self._goal or not self._goal.state.active:
            return
        if self._inputs.map is not None and self._inputs.map.location == "closing":
            # The goal stays where it is in the map: another way to it is asked for.
            self._missing_since = self._now
            self._stand(self._goal, "the loops of the map were closed")
        else:
            self._end(GoalState.ABORTED, Reason.LOST, "the pose was set anew")

    def _request(self, message: msg.GoalRequest) -> None:
        if message.action == 0:
            self._set(Goal.from_request(message, self._now), message)
        elif self._goal and self._goal.state.active and message.id in ("", self._goal.id):
            self._end(GoalState.CANCELLED, Reason.CANCELLED, self._goal.foreign(message.owner))
        else:
            self._status()

    def _set(self, goal: Goal, message: msg.GoalRequest | msg.PoseStamped) -> None:
        if goal.id in self._known:
            self._status()  # a repeat: its sender has not heard the answer yet, or it was long under way
            return
        self._known.append(goal.id)
        stray = goal.move_to_map(message.header.frame_id, self._frame, self._pose)
        if self._goal and self._goal.state.active:
            self._end(GoalState.PREEMPTED, Reason.PREEMPTED, self._goal.foreign(goal.owner))
        self._goal = goal
        self._short = 0
        if self._behaviours.at_edge:
            self._trail.forget()
        self._behaviours = self._afresh()
        self._progress, self._rest, self._budget = ProgressMonitor(), ProgressMonitor(AT_REST), Budget()
        self._plan = None
        self._query.drop()
        self._missing_since, self._trouble, self._refused = 0, "", Reason.NONE
        heard = self._inputs
        trouble = stray or unlocated(heard.map) or goal.misplaced(self._area) or hindrance(heard.robot)
        if trouble is not None:
            self._end(GoalState.REJECTED, *trouble)
        else:
            self._status()
            self._ask()
            self._status()

    def _afresh(self) -> Behaviours:
        return Behaviours(self._params, feels_edges=self._creep > 0.0, tilts=self._tilt > 0.0)

    def _restore(self, message: msg.GoalStatus) -> None:
        # After a crash nobody knows how far the goal had come: say so instead of driving on.
        self._known.append(message.id)
        if self._goal is None and message.state in [s.value for s in GoalState if s.active]:
            self._goal = Goal.from_status(message, self._now)
            self._end(GoalState.ABORTED, Reason.PROCESS_LOST, "the navigator restarted")

    def _take_plan(self, message: msg.Plan) -> None:
        goal = self._goal
        if not goal or not goal.state.active or not self._query.answers(self._now, goal, message):
            return
        if self._missing_since:
            return  # asked before the inputs went: a new route is asked for when they are back
        self._route = RouteWatch(self._radius)
        if self._arrived(goal) and not (message.ok and self._ends_nearer(goal, message)):
            return self._reach()
        goal.p_fail, goal.worst = message.p_fail, message.worst
        if math.isnan(goal.first[0]):
            goal.first = message.p_fail, message.worst
        self._refused = Reason.NONE if message.ok else Reason.of(message.reason) or Reason.NO_ROUTE
        if message.ok:
            self._behaviours.found()
            self._budget.plan(message.length)
            self._plan = message
            goal.begun = True
            goal.frontier = not message.reaches_goal
            goal.risk = float(message.transition_body.max(initial=0.0))
            goal.state = GoalState.MOVING
            goal.detail = CREEPING if message.creep else over_unseen(message)
            self._out.append((t.PATH_COMMAND, self._order.route(self._now, message, self._creep)))
            return self._status()
        reason = self._refused
        hopeless = reason is Reason.INVALID or (reason is Reason.TOO_RISKY and not goal.begun)
        assert self._pose is not None, "no route is asked for without one"
        action = Action.GIVE_UP if hopeless else self._behaviours.next(Trigger.NO_ROUTE, self._pose)
        if action is Action.LOOK_DOWN:
            self._look(goal)
        elif action is Action.LOOK:
            self._stand(goal, message.detail)
            goal.state = GoalState.PLANNING
        elif action in (Action.CREEP, Action.ALLOW):
            self._stand(goal, message.detail)
            self._replan(goal)
        elif action is Action.GIVE_UP or reason is Reason.IN_OBSTACLE or not self._move_out(goal):
            refused = reason in REJECTING and not goal.begun
            state = GoalState.REJECTED if refused else GoalState.ABORTED
            self._end(state, reason, message.detail + goal.place(self._pose))

    def tick(self, now: int) -> Outputs:
        """Supervise the goal."""
        if now < self._now:  # the clock was reset: stamps of before mean nothing
            self._inputs.restart()
        self._now = now
        self._out = []
        goal = self._goal
        if goal and goal.state.active:
            self._supervise(goal)
        if now >= self._status_due or now < self._status_due - NS:
            self._status()
        if (again := self._order.repeat(now, self._inputs.tracker)) is not None:
            self._out.append((t.PATH_COMMAND, again))
        return self._out

    def _supervise(self, goal: Goal) -> None:
        now, p = self._now, self._params
        if goal.timeout > 0 and now - goal.accepted > goal.timeout * NS:
            return self._end(GoalState.ABORTED, Reason.TIMEOUT, f"after {goal.timeout:.0f} s")
        if (trouble := hindrance(self._inputs.robot)) is not None:
            return self._end(GoalState.ABORTED, *trouble)
        if (missing := self._inputs.missing(now, p.input_timeout, frame=self._frame.known)) is not None:
            reason, detail = missing
            if not self._missing_since:
                self._missing_since = now
                self._stand(goal, detail)
            goal.detail = detail
            if reason is Reason.TAKEN:
                goal.state, self._missing_since = GoalState.PAUSED, now
            self._budget.rest()
            if now - self._missing_since > PATIENCE.get(reason, p.patience) * NS:
                self._end(GoalState.ABORTED, reason, detail)
            return None
        if self._missing_since:
            if self._pose is None:
                return None
            self._missing_since = 0
            goal.detail = ""
            self._plan = None
            return self._ask()
        if self._pose is not None:
            if self._rest.stuck(now, self._pose) and self._arrived(goal):
                return self._reach()
            if spent := self._budget.spent(now, self._pose):
                last = f", last: {self._trouble}" if self._trouble else ""
                reason = self._refused or Reason.STUCK
                return self._end(GoalState.ABORTED, reason, spent + last + goal.place(self._pose))
        if self._behaviours.crept and self._plan is not None and self._inputs.edge and self._pose is not None:
            return self._keep_off(goal, self._behaviours.edge(self._pose), 1.0)
        if self._query.open:
            if self._query.waited(now) > p.patience:
                return self._end(GoalState.ABORTED, Reason.PROCESS_LOST, "the planner does not answer")
            if self._query.silence(now) > p.plan_retry:
                if goal.state is GoalState.MOVING:
                    self._stand(goal, PLANNER_SILENT)
                self._ask(again=True)
            return None
        if goal.state is GoalState.PLANNING:
            waits = self._order.looking(now, self._inputs.tracker)
            if not waits and (goal.detail == LOOKING or self._query.age(now) > LOOK_AGAIN):
                self._replan(goal)
            return None
        return self._follow(goal)

    def _follow(self, goal: Goal) -> None:
        now = self._now
        on_path = self._order.obeyed(self._inputs.tracker)
        if on_path and self._inputs.phase == "done":
            return self._arrive(goal)
        broken = self._route.broken(now, self._plan, self._pose) if goal.state is GoalState.MOVING else ""
        if not broken and self._inputs.planner_silent(now, self._params.plan_retry):
            broken = PLANNER_SILENT
        beside = self._inputs.beside if on_path else 0.0
        strayed = goal.state is GoalState.RECOVERING and beside > STRAY_BESIDE
        # Astride a face a robot goes on: one that was stopped there, with its nose down a kerb, turned back and fell.
        off = self._slide.off(now, beside) and not self._inputs.astride
        if (off or strayed) and not broken:
            broken = f"{beside:.2f} m beside its way"
        if broken:
            self._stand(goal, broken)
            if self._arrived(goal):
                return self._reach()
            return self._replan(goal)
        if on_path and self._inputs.phase == "final_turn":
            self._progress.reset()  # the tracker ends that in time by itself
        elif self._pose is not None and on_path and self._progress.stuck(now, self._pose):
            return self._recover(goal)
        turn = self._inputs.turn_held
        if goal.state is GoalState.MOVING and (turn or self._inputs.way_held):
            if self._query.age(now) > HELD_REPLAN:
                if turn and self._pose is not None:
                    self._behaviours.hold_turn(self._pose, left=turn > 0.0)
                self._replan(goal)
        elif goal.state is GoalState.MOVING and goal.frontier:
            on_edge = self._route.over_edge(self._plan, self._pose)
            creeps = self._plan is not None and self._plan.creep
            if self._query.due(now, self._inputs.tracker, on_edge=on_edge, creeps=creeps):
                self._replan(goal)
        return None

    def _arrive(self, goal: Goal) -> None:
        """At the end of a path: that is the goal, a frontier, or the last drivable place before the goal."""
        if goal.state is GoalState.RECOVERING or goal.frontier:
            goal.state = GoalState.MOVING
            return self._replan(goal)
        if self._arrived(goal):
            return self._reach()
        short = self._distance(goal)
        if short <= self._params.goal_tolerance and self._pose is not None:
            self._end(GoalState.ABORTED, Reason.STUCK, heading_off(goal.yaw, self._pose[2]))
        elif self._short < self._params.short_retries:
            self._short += 1  # seen from here the last stretch may be drivable
            self._replan(goal)
        else:
            self._end(GoalState.ABORTED, Reason.NO_ROUTE, f"the last {short:.2f} m are not drivable")
        return None

    def _distance(self, goal: Goal) -> float:
        """[m] from base_link; infinite while nobody knows where the robot is."""
        return math.dist(self._pose[:2], (goal.x, goal.y)) if self._pose else math.inf

    def _arrived(self, goal: Goal) -> bool:
        """Whether the robot is at the goal. That is a matter of its pose: what a path or a plan says of the rest
        changes nothing. The one place that decides it."""
        if self._pose is None or self._distance(goal) > self._params.goal_tolerance:
            return False
        return not heading_off(goal.yaw, self._pose[2])

    def _reach(self) -> None:
        """The robot is at the goal, as far as its place is known: one that is known worse than the tolerance is not
        called reached."""
        if unsure := self._inputs.unsure(self._params.goal_tolerance):
            self._end(GoalState.ABORTED, Reason.UNSURE, unsure)
        else:
            self._end(GoalState.REACHED, Reason.NONE)

    def _ends_nearer(self, goal: Goal, plan: msg.Plan) -> bool:
        end = math.dist((plan.x[-1], plan.y[-1]), (goal.x, goal.y)) if len(plan.x) else math.inf
        return end < self._distance(goal) - ENDS_NEARER

    def _recover(self, goal: Goal) -> None:
        """Move out of the place, then replan around it; give up where that was done often enough. A robot that is at
        the goal needs neither."""
        if self._arrived(goal):
            return self._reach()
        self._progress.reset()
        assert self._pose is not None
        way, room = self._inputs.way, self._inputs.room_ahead
        trigger = Trigger.STUCK if way else Trigger.TURN_STUCK
        action = self._behaviours.next(trigger, self._pose, way=way, room_ahead=room)
        if action is Action.GIVE_UP:
            tried = f"after {goal.recoveries} recoveries{goal.place(self._pose)}"
            self._end(GoalState.ABORTED, Reason.STUCK, tried)
        elif action is Action.MOVE_ON:
            self._straight(goal, MOVE_ON, "moving on")
        elif not self._move_out(goal, barred=way):
            goal.recoveries += 1
            self._replan(goal)
        return None

    def _touched(self, message: msg.PoseStamped) -> None:
        goal, place = self._goal, message.pose.position
        if goal and goal.state.active and self._pose is not None and not self._missing_since:
            way = math.copysign(1.0, math.cos(yaw_of(message.pose.orientation) - self._pose[2]))
            self._keep_off(goal, self._behaviours.touched(self._pose, place.x, place.y), way)

    def _keep_off(self, goal: Goal, action: Action, way: float) -> None:
        """The robot felt what the map did not tell, ahead, `way` 1.0, or behind, -1.0: get away from it, then replan
        around it; or give up."""
        self._query.drop()
        if action is Action.GIVE_UP:
            self._end(GoalState.ABORTED, Reason.NO_ROUTE, "choose another goal")
        elif not self._move_out(goal, barred=way):
            self._stand(goal, self._behaviours.felt)
            self._replan(goal)

    def _move_out(self, goal: Goal, barred: float = 0.0) -> bool:
        """Move straight over ground it stood on, for which no turn is needed, not in the direction `barred` nor where
        the guard holds it; False when there is none."""
        ways = self._inputs.held | {barred}
        if self._behaviours.at_edge:
            ways |= {1.0}  # the body covered what lies below the edge, too
        reach = self._trail.reach(self._pose, self._params.back_out, ways) if self._pose else 0.0
        if reach != 0.0:
            self._straight(goal, reach, "backing out" if reach < 0.0 else "moving out")
        return reach != 0.0

    def _straight(self, goal: Goal, reach: float, why: str) -> None:
        assert self._pose is not None
        goal.recoveries += 1
        goal.state = GoalState.RECOVERING
        goal.detail = why
        self._plan = None
        self._out.append((t.PATH_COMMAND, self._order.straight(self._now, goal.id, self._pose, reach)))
        self._status()

    def _replan(self, goal: Goal) -> None:
        goal.replans += 1
        self._ask()

    def _ask(self, *, again: bool = False) -> None:
        goal = self._goal
        if goal is None or self._pose is None:
            return
        if self._plan is None:
            goal.state = GoalState.PLANNING
        held, tried = self._behaviours.held_turns(self._pose), self._behaviours
        request = self._query.ask(
            self._now, goal, self._pose, tried.avoid, held, creep=tried.creep, again=again
        )
        self._out.append((t.PLAN_REQUEST, request))

    def _halt(self) -> None:
        self._progress.reset()
        self._plan = None
        self._out.append((t.PATH_COMMAND, self._order.stand(self._now)))

    def _look(self, goal: Goal) -> None:
        """Tilt the trunk and look at the ground ahead before the next plan."""
        self._stand(goal, LOOKING)
        goal.state = GoalState.PLANNING
        self._out[-1] = (
            t.PATH_COMMAND,
            self._order.look(self._now, goal.id, min(self._params.look_pitch, self._tilt)),
        )
        self._status()

    def _stand(self, goal: Goal, why: str) -> None:
        goal.detail = why
        self._trouble = why or self._trouble
        self._halt()

    def _end(self, state: GoalState, reason: Reason, detail: str = "") -> None:
        assert self._goal is not None
        felt = self._behaviours.felt if state is GoalState.ABORTED else ""
        self._goal.end(state, reason, "; ".join(part for part in (felt, detail) if part))
        self._query.drop()
        self._halt()
        self._status()

    def _status(self) -> None:
        self._status_due = self._now + NS // 2
        self._out.append((t.GOAL_STATUS, status_of(self._goal, self._now, self._inputs.distance_left)))


def build(config: StackConfig) -> NavigatorStage:
    """From the stack's configuration."""
    robot = config.capabilities()
    area = GoalArea.of(config)
    return NavigatorStage(
        config.navigator,
        area,
        robot.step_vx,
        robot.max_trunk_tilt,
        robot.creep,
        robot.length,
        robot.width,
    )
