"""The mission stage: it takes an operator's order and does its steps, one after the other."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.stage_config import CommsConfig, HomeConfig
from rbtrg_robot.stages.mission.mission import Mission, Phase
from rbtrg_robot.stages.mission.order import (
    EVERYWHERE,
    Kind,
    OnCommsLoss,
    OnFailure,
    in_place_of,
    refusal,
    update_refusal,
)
from rbtrg_robot.stages.mission.reserve import Reserve
from rbtrg_robot.stages.mission.runner import Runner, World
from rbtrg_robot.stages.navigation.goal import KNOWN_IDS, Goal, GoalState
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.stages.navigation.reasons import absence, hindrance, unlocated
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import header, stamp_of

HOME_RADIUS = 1.0
"""[m] A robot so near to home is at home."""
TELL_PERIOD = NS
"""Between two states where nothing changed [ns]."""


class MissionStage:
    """Orders of operators in; goals, postures and the state of the mission out. In: requests, the presence of
    operators, the states of navigator and robot, which map is loaded, the pose. Out: the accepted order and its state,
    which together hold all that a restarted stage needs; goals for the navigator; `stand` and `sit` for the robot. It
    decides which step is next and what follows a failure. It never plans and never publishes a velocity.
    """

    inputs = (
        t.MISSION_REQUEST,
        t.PRESENCE,
        t.GOAL_STATUS,
        t.ROBOT_STATE,
        t.MAP_STATUS,
        t.ODOM,
        t.TF_STATIC,
        t.VIEWPOINTS,
        t.PHOTO,
        t.DOCK_POSE,
    )
    outputs = (
        *(t.MISSION_ORDER, t.MISSION_STATE, t.GOAL_REQUEST, t.ROBOT_COMMAND, t.EXPLORE_QUESTION),
        t.PHOTO_REQUEST,
    )

    def __init__(
        self,
        possible: frozenset[Kind] = EVERYWHERE,
        prior_map: str = "",
        floor: float = 0.0,
        comms: CommsConfig = CommsConfig(),
        home: HomeConfig = HomeConfig(),
    ) -> None:
        """`possible`: kinds of steps that can be done here; `prior_map`: hash of the loaded map, or empty; `floor`: see
        `Reserve`; `comms`: for whatever does not say it itself; `home`: when its battery sends the robot home."""
        self._comms = comms
        self._possible, self._prior_map = possible, prior_map
        self._world = World(reserve=Reserve(floor, home))
        self._runner = Runner(self._world)
        self._frame = MapFrame()
        self._told_home: Pose2 | None = None
        """In `map`, where an operator put it."""
        self._map: msg.MapStatus | None = None
        self._left: msg.MissionOrder | None = None
        """Order of a process that is gone; its state follows."""
        self._known: deque[str] = deque(maxlen=KNOWN_IDS)
        self._sent, self._taken_over = "", False
        """The newest goal of somebody, and whether a mission took its place or brought the robot home since."""
        self._warned = False
        self._answer = ("", "")
        """The newest request's id, and why it was refused."""
        self._due = 0

    def warm_up(self) -> None:
        """Nothing to compile."""

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        world, out = self._world, Outputs()
        if t.ODOM.carried(message, topic):
            if self._frame.known:
                pose = message.pose.pose
                world.pose = self._frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
                if world.robot is not None:
                    world.reserve.take(world.robot.battery, world.pose, world.now)
                mission = self._runner.mission
                home = mission.home if mission and mission.phase.active else None
                world.way.take(world.pose, (home.x, home.y, home.yaw) if home else self.home)
            return []
        if t.TF_STATIC.carried(message, topic):
            self._frame.take(message)
        elif t.MAP_STATUS.carried(message, topic):
            self._map, self._prior_map = message, message.prior
            return []
        elif t.VIEWPOINTS.carried(message, topic):
            world.views = message
            return []
        elif t.PHOTO.carried(message, topic):
            world.photo = stamp_of(message)
            return []
        elif t.DOCK_POSE.carried(message, topic):
            dock = Goal.from_pose(message, world.now)
            if dock.move_to_map(message.header.frame_id, self._frame, world.pose) is None and dock.finite:
                world.dock = stamp_of(message), (dock.x, dock.y, dock.yaw or 0.0)
            return []
        elif t.PRESENCE.carried(message, topic):
            world.contact = world.now
        elif t.GOAL_STATUS.carried(message, topic):
            if message.state in GoalState._value2member_map_:
                world.goal = message
                self._runner.yield_to_others()
        elif t.ROBOT_STATE.carried(message, topic):
            world.robot = message
            self._runner.yield_to_others()
        elif t.MISSION_REQUEST.carried(message, topic):
            out = self._take(message)
        elif t.MISSION_ORDER.carried(message, topic):
            self._left = message
        elif t.MISSION_STATE.carried(message, topic):
            return self._restore(message)
        return out + self._tell() + self._runner.goals()

    def tick(self, now: int) -> Outputs:
        """Go on with the mission; `now` in ns."""
        if now < self._world.now:
            self._runner.clock_reset()
            self._due = now
        self._world.now = now
        out = self._take_over() + self._runner.tick()
        if self._warned != bool(self._warning()):
            self._warned, self._runner.changed = not self._warned, True
        return self._tell(due=now >= self._due) + out

    @property
    def _sent_out(self) -> bool:
        """Somebody sent the robot somewhere, and wants it back."""
        goal = self._world.goal
        return goal is not None and goal.id != "" and not goal.no_return

    def _warning(self) -> str:
        """That the battery will be needed for the way home."""
        world, mission = self._world, self._runner.mission
        running = mission is not None and mission.phase.active
        away = world.way.length > HOME_RADIUS and not (mission is not None and running and mission.returning)
        stays = mission.order.no_return if mission and running else not self._sent_out
        return "" if stays or not away else world.reserve.warning(world.way.length)

    def _take_over(self) -> Outputs:
        """A goal of somebody becomes a mission, which stands or comes home, where nobody is in contact any more or the
        battery is needed for the way home; so does a robot that was sent out and stands there."""
        world, present, goal = self._world, self._runner.mission, self._world.goal
        if goal is None or not goal.id or (present and present.phase in (Phase.RUNNING, Phase.HOLDING)):
            return []
        if world.theirs and goal.id != self._sent:
            self._sent, self._taken_over, world.contact = goal.id, False, world.now
        if self._taken_over or not world.way.length > HOME_RADIUS:
            return []
        if hindrance(world.robot) or absence(world.robot, None):
            self._taken_over |= not world.theirs  # nothing moves when they let it go, until it is sent again
            return []
        if unlocated(self._map):
            return []
        if not world.theirs and present and present.phase.active:
            return []  # paused: it goes on only when told to
        home = self.home
        comes = world.theirs and home is not None and math.dist((goal.x, goal.y), home[:2]) < HOME_RADIUS
        low = "" if goal.no_return or comes else world.reserve.short(world.way.length)
        silent = world.now - (world.contact or world.now) > self._comms.timeout * NS
        lost = world.theirs and silent and self._comms.on_loss != OnCommsLoss.CONTINUE
        if not low and not lost:
            return []
        self._taken_over, world.displaced = True, goal.id if world.theirs else ""
        order = self._followed(in_place_of(goal, world.now, low, sent=world.theirs))
        self._runner.start(order)
        return [(t.MISSION_ORDER, order)]

    def _followed(self, order: msg.MissionOrder) -> msg.MissionOrder:
        """With what the order leaves to the stack."""
        order.on_comms_loss = order.on_comms_loss or self._comms.on_loss
        order.comms_timeout = order.comms_timeout or self._comms.timeout
        if not order.has_home and (home := self.home) is not None:
            order.home_x, order.home_y, order.home_yaw = home
        return order

    def _take(self, request: msg.MissionRequest) -> Outputs:
        out: Outputs = []
        if request.id not in self._known:
            self._known.append(request.id)
            self._answer = (request.id, self._obey(request, out))
        self._runner.changed = True
        return out

    def _obey(self, request: msg.MissionRequest, out: Outputs) -> str:
        """Do it; why not, in words, where it is refused."""
        mission, runner = self._runner.mission, self._runner
        if request.action == "run":
            return self._start(request, out)
        if request.action == "home":
            return self._put_home(request.order)
        if mission is None or not mission.phase.active:
            return "no mission is under way"
        if request.order_id not in ("", mission.order.order_id):
            return "that mission is over"
        if request.action == "update":
            return self._update(mission, request.order, out)
        if request.step not in (0, mission.cursor.at):
            return f"that was step {request.step}; the mission is at step {mission.cursor.at}"
        who = f"by {request.owner or 'an operator'}"
        if request.action == "pause":
            if mission.phase is not Phase.PAUSED:
                runner.halt(Phase.PAUSED, f"paused {who}")
        elif request.action == "resume":
            if mission.phase is Phase.PAUSED:
                if why := self._world.hindrance():
                    return why
                self._world.contact = self._world.now  # who says so is there
                runner.resume()
        elif request.action == "skip":
            if mission.returning:
                return "it gave up and is on its way home; `rbtrg-robot mission stop` ends it"
            runner.skip()
        elif request.action == "stop":
            runner.stop(f"stopped {who}")
        elif request.action == "answer":
            return runner.answer(request.answer)
        else:
            return f"{request.action!r} is none of run, update, pause, resume, skip, stop, answer, home"
        return ""

    def _start(self, request: msg.MissionRequest, out: Outputs) -> str:
        order, present = request.order, self._runner.mission
        if present and present.phase.active:
            return f"mission {present.order.name or present.order.order_id} is under way: stop it first"
        if present and present.order.order_id == order.order_id:
            return "this order was followed before: give it a new order_id"
        if why := refusal(order, self._possible, self._prior_map) or self._world.hindrance():
            return why
        order = self._followed(order)
        if not order.has_home and self.home is None and _returns(order):
            return "where home is is not known yet, so it could not return: give the mission a home"
        order.header = header(self._world.now, MAP)
        order.owner = order.owner or request.owner
        self._world.contact, self._world.displaced, self._taken_over = self._world.now, "", False
        self._runner.start(order)
        out.append((t.MISSION_ORDER, order))
        return ""

    def _update(self, mission: Mission, order: msg.MissionOrder, out: Outputs) -> str:
        if order.order_id != mission.order.order_id:
            return "it is the update of another mission"
        why = refusal(order, self._possible, self._prior_map)
        why = why or update_refusal(mission.order, order, mission.cursor.at)
        if not why:
            old = mission.order
            home = (old.home_x, old.home_y, old.home_yaw)
            order = self._followed(order)
            mission.update(self._with_home(order, home, old.owner))
            out.append((t.MISSION_ORDER, mission.order))
        return why

    def _with_home(self, order: msg.MissionOrder, home: Pose2 | None, owner: str) -> msg.MissionOrder:
        """The order as it is followed: with a home, an owner and the time."""
        if order.has_home or home is None:
            home = (order.home_x, order.home_y, order.home_yaw)
        x, y, yaw = home
        stamp = header(self._world.now, MAP)
        return replace(order, header=stamp, owner=order.owner or owner, home_x=x, home_y=y, home_yaw=yaw)

    @property
    def home(self) -> Pose2 | None:
        """In `map`: where an operator put it, else where the run began; None before the robot knows where that is."""
        if self._told_home is not None:
            return self._told_home
        return (
            self._frame.pose2(0.0, 0.0, 0.0) if self._frame.known and unlocated(self._map) is None else None
        )

    def _put_home(self, order: msg.MissionOrder) -> str:
        place = (order.home_x, order.home_y, order.home_yaw) if order.has_home else self._world.pose
        if place is None or unlocated(self._map) is not None:
            return "where the robot stands is not known yet"
        if not all(map(math.isfinite, place)):
            return "home has numbers that are not finite"
        self._told_home = place
        return ""

    def _restore(self, state: msg.MissionState) -> Outputs:
        """The last words of the process before this one."""
        if self._told_home is None and state.home_told:
            self._told_home = state.home_x, state.home_y, state.home_yaw
        if self._runner.mission is not None or self._left is None:
            return []
        if refusal(self._left, self._possible, self._prior_map):
            return []  # of another version or of a stack with other settings
        self._runner.mission = mission = Mission.restore(self._left, state)
        if mission is None:
            return []
        self._known.append(state.request)
        self._answer = (state.request, state.refused)
        return [(t.MISSION_ORDER, mission.order)]

    def _tell(self, *, due: bool = False) -> Outputs:
        """The state, where it changed or is due."""
        if not (self._runner.changed or due):
            return []
        self._runner.changed = False
        now, mission = self._world.now, self._runner.mission
        self._due = now + TELL_PERIOD
        idle = msg.MissionState(header=header(now, MAP), phase=Phase.IDLE.value)
        state = mission.state(now) if mission else idle
        state.request, state.refused = self._answer
        state.map, state.warning = self._prior_map, self._warning()
        if (home := self.home) is not None:
            state.has_home, state.home_told = True, self._told_home is not None
            state.home_x, state.home_y, state.home_yaw = home
        return [(t.MISSION_STATE, state)]


def _returns(order: msg.MissionOrder) -> bool:
    """It may have to go home."""
    return order.on_comms_loss == OnCommsLoss.RETURN or any(
        s.on_failure == OnFailure.RETURN or s.kind == Kind.HOME for s in order.steps
    )


def build(config: StackConfig) -> MissionStage:
    """From the stack's configuration."""
    recorded = "recorder" not in config.absent
    sees = config.camera.mounted() is not None and "camera" not in config.absent
    possible = (
        EVERYWHERE | ({Kind.RECORD} if recorded else set()) | ({Kind.PHOTO} if recorded and sees else set())
    )
    return MissionStage(
        possible, fingerprint(config.map_file), config.gate.min_battery, config.comms, config.home
    )
