"""A cheap stack for the console: a made-up robot on made-up ground that answers as the real one does, and the console
beside it."""

from __future__ import annotations

import io
import json
import math
import threading
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from hal.camera import CameraConfig, CameraFrame
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.console.server import Serving, serving
from rbtrg_robot.hosts.camera import image_msg, info_msg
from rbtrg_robot.latch import number
from rbtrg_robot.process.events import Events
from rbtrg_robot.process.runfiles import console_address
from rbtrg_robot.stages.mission.executor import MissionStage
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import (
    MAP,
    ODOM,
    cloud_msg,
    odometry_msg,
    patch_msg,
    rpy_quaternion,
    transform_msg,
    yaw_of,
)
from rbtrg_robot.wire.messages import header, stamp_of
from tools.bench.ports import free_port

PACE_LENGTH = 0.05
"""[m] that the robot drives between two words."""
WORD_PERIOD = 0.1
"""[s]"""


def ground() -> MapPatch:
    """12 x 9 m: a ramp, a platform, a kerb, a wall, a hole that nobody saw."""
    res = 0.04
    y, x = np.meshgrid(np.arange(-112, 112) * res, np.arange(-80, 220) * res, indexing="ij")
    height = np.zeros(x.shape, np.float32)
    height += 0.03 * np.sin(x * 1.3) * np.cos(y * 0.9)
    ramp = (x > 2.0) & (x < 4.0) & (abs(y) < 1.2)
    height[ramp] = 0.25 * (x[ramp] - 2.0)
    height[(x >= 4.0) & (x < 6.0) & (abs(y) < 1.6)] = 0.5
    height[(y > 2.4) & (y < 2.6) & (x < 5.0)] = 0.9
    height[(y < -2.0) & (y > -2.3)] += 0.06
    hole = (x - 6.8) ** 2 + (y + 2.6) ** 2 < 0.8
    height[hole] = np.nan
    trusted = (np.isfinite(height) & (x < 7.6)).astype(np.float32)
    source = np.where(np.isfinite(height), 2.0, 0.0).astype(np.float32)
    layers = {
        "elevation": height.astype(np.float32),
        "variance": np.where(np.isfinite(height), 1e-4, np.nan).astype(np.float32),
        "trusted": trusted,
        "upper_bound": np.full_like(height, np.nan),
        "source": source,
    }
    return MapPatch((float(x[0, 0]), float(y[0, 0])), res, 1, 1, layers)


class Robot:
    """Everything but the console, in one thread. It drives straight to its goal."""

    def __init__(self, *, busy: bool = False) -> None:
        """`busy`: points with every state, the map again twice a second, and five pictures once somebody asked."""
        self._busy = busy
        self.said = 0.0
        """Wall clock [s] of its last word."""
        self.port = free_port()
        self.bus = Bus(f"tcp/127.0.0.1:{self.port}", "supervisor", router=True)
        self.bus.subscribe(
            [
                *(t.ROBOT_STOP, t.ROBOT_COMMAND, t.GOAL_REQUEST, t.MAP_REQUEST, t.TELEOP, t.ROUTE_QUESTION),
                *(
                    t.MISSION_REQUEST,
                    t.PRESENCE,
                    t.INITIAL_POSE,
                    t.MAP_PRIOR,
                    t.CAMERA_REQUEST,
                    t.AREAS_REQUEST,
                    t.PHOTO_REQUEST,
                ),
            ]
        )
        self.status = b"{}"
        """What the supervisor answers."""
        self.bus.serve("status", lambda reply: reply(self.status))
        self.events = Events(lambda _: None, 0.1, time.time_ns, time.time_ns)
        self.bus.serve("events", lambda reply: reply(json.dumps(self.events.newest()).encode()))
        self.lock = threading.Lock()
        self.heard = threading.Event()
        """Set by every message that comes."""
        self.epoch = 1
        self.reset()
        self._turns = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        told = (t.ODOM, t.ROBOT_STATE, t.GOAL_STATUS, t.TF_STATIC, t.MAP_FULL, t.MAP_PARTS, t.MAP_STATUS)
        for topic in (*told, t.MISSION_ORDER, t.MISSION_STATE, t.CAMERA, t.CAMERA_INFO, t.AREAS, t.PHOTO):
            self.bus.advertise(topic)
        camera = CameraConfig().mounted()
        assert camera is not None
        self._camera = camera
        self.bus.publish(t.CAMERA_INFO, info_msg(camera, 1), 1)
        self._thread.start()

    def reset(self) -> None:
        """As it was at the start."""
        with self.lock:
            self.x = self.y = self.yaw = 0.0
            self.deaf = self.frozen = False
            """It hears no stop; it says nothing."""
            self.pace = PACE_LENGTH
            """[m] from word to word."""
            self.latch = 0
            self.cause = ""
            self.taken = ""
            self.goal: msg.GoalRequest | None = None
            self.state, self.reason = "idle", ""
            self.stops = 0
            self.goals: list[msg.GoalRequest] = []
            self.driven: list[tuple[float, float, float]] = []
            """Time [s], v, w of each command by hand."""
            self.present = 0
            """Signs of an operator."""
            self.mission = MissionStage()
            self.prior = ""
            self.filmed = self.photos = 0
            """Requests for pictures."""
            self.alike: list[float] = []
            """Places in a loaded map that look alike: x, y [m], heading [rad] of each."""
            self._offset(msg.Pose())

    def close(self) -> None:
        """End."""
        self._end.set()
        self._thread.join()
        self.bus.close()

    def _run(self) -> None:
        due = 0.0
        while not self._end.is_set():
            for received in self.bus.take(0.02):
                with self.lock:
                    self._hear(received.topic, received.decode())
                    if received.topic in self.mission.inputs:
                        self._do(self.mission.on(received.topic, received.decode()))
                self.heard.set()
            if time.monotonic() >= due:
                due = time.monotonic() + WORD_PERIOD
                with self.lock:
                    if not self.frozen:
                        self._say()

    def _offset(self, pose: msg.Pose) -> None:
        """Where `odom` lies in `map`: the robot stands at `pose` now, and looks along x of `odom`."""
        place, yaw, stamp = pose.position, yaw_of(pose.orientation), time.time_ns()
        c, s = math.cos(yaw), math.sin(yaw)
        at = (place.x - c * self.x + s * self.y, place.y - s * self.x - c * self.y, 0.0)
        turn = rpy_quaternion((0.0, 0.0, yaw))
        frames = msg.TFMessage(transforms=[transform_msg(stamp, MAP, ODOM, at, turn)])
        self.events.take(t.TF_STATIC, frames)
        self._do(self.mission.on(t.TF_STATIC, frames))
        self.bus.publish(t.TF_STATIC, frames, stamp)
        self.mission.on(t.TF_STATIC, frames)

    def _do(self, orders: Outputs) -> None:
        """What the mission wants."""
        for topic, message in orders:
            if topic in (t.MISSION_ORDER, t.MISSION_STATE):
                self.bus.publish(topic, message, time.time_ns())
            else:
                self._hear(topic, message)

    def _hear(self, topic: t.Topic, message: Any) -> None:
        self.events.take(topic, message)
        if topic is t.ROBOT_STOP:
            self.stops += 1
            if not self.deaf:
                self.latch = number(max(self.latch + 1, time.monotonic_ns()), message.latch)
                self.cause = message.cause
                if self.state == "moving":
                    self.state, self.reason = "aborted", "emergency_stop"
        elif topic is t.ROBOT_COMMAND and message.mode == "resume" and message.latch == self.latch:
            self.latch, self.cause, self.taken = 0, "", ""
            self.state = "moving" if self.state == "paused" else self.state
        elif topic is t.GOAL_REQUEST:
            if message.action == 1:
                self.state = "cancelled" if self.state in ("moving", "paused") else self.state
            elif self.goal is None or message.id != self.goal.id:
                self.goal = message
                self.goals.append(message)
                self.state, self.reason = ("rejected", "emergency_stop") if self.latch else ("moving", "")
        elif topic is t.MAP_REQUEST:
            if message.action == "full":
                self.bus.publish(t.MAP_FULL, patch_msg(ground()), 1)
            else:
                self.bus.publish(t.MAP_PARTS, msg.MapPart(parts=1, map=patch_msg(ground())), 1)
        elif topic is t.TELEOP:
            twist = message.twist
            self.driven.append((time.monotonic(), twist.linear.x, twist.angular.z))
            moves = twist.linear.x != 0.0 or twist.angular.z != 0.0
            if moves and not self.taken:  # the last word of a page that closed, a zero, takes nothing
                self.taken, self.latch = "teleop has the motion", time.monotonic_ns()
                self.state = "paused" if self.state == "moving" else self.state
            self.x += 0.05 * twist.linear.x * math.cos(self.yaw)
            self.y += 0.05 * twist.linear.x * math.sin(self.yaw)
            self.yaw += 0.05 * twist.angular.z
        elif topic is t.INITIAL_POSE:
            self._offset(message.pose.pose)
            self.alike = []
        elif topic is t.MAP_PRIOR:
            self.prior, self.epoch = message.id, self.epoch + (message.id != self.prior)
        elif topic is t.AREAS_REQUEST:
            self.bus.publish(t.AREAS, message, 1)
        elif topic is t.PRESENCE:
            self.present += 1
        elif topic is t.ROUTE_QUESTION:
            self._answer(message)
        elif topic is t.PHOTO_REQUEST:
            self.photos += 1
            frame = CameraFrame(time.time_ns(), grey())
            self.bus.publish(t.PHOTO, image_msg(self._camera, frame), frame.stamp)
        elif topic is t.CAMERA_REQUEST:
            self.filmed += 1

    def _answer(self, message: Any) -> None:
        self.bus.publish(t.ROUTE_REPORT, report(message), 1)

    def _say(self) -> None:
        stamp = time.time_ns()
        if self.goal is not None and self.state == "moving":
            dx, dy = self.goal.x - self.x, self.goal.y - self.y
            left = math.hypot(dx, dy)
            if left < 0.1:
                self.state = "reached"
            else:
                self.yaw = math.atan2(dy, dx)
                step = min(self.pace, left)
                self.x, self.y = self.x + step * dx / left, self.y + step * dy / left
        quaternion = rpy_quaternion((0.0, 0.0, self.yaw))
        speed = (0.5 if self.state == "moving" else 0.0, 0.0, 0.0)
        odom = odometry_msg(stamp, (self.x, self.y, 0.45), quaternion, speed, np.zeros(3))
        self.bus.publish(t.ODOM, odom, stamp)
        self._turns += 1
        if self._busy or self._turns % 10 == 0:
            self.bus.publish(t.CLOUD, cloud_msg(stamp, "base_link", POINTS), stamp)
        if self._busy and self._turns % 5 == 0:
            self.bus.publish(t.MAP_UPDATE, patch_msg(ground()), stamp)
        if self.filmed and self._turns % (2 if self._busy else 4) == 0:
            self.bus.publish(t.CAMERA, image_msg(self._camera, CameraFrame(stamp, grey())), stamp)
        self.said = time.time()
        state = msg.RobotState(
            header=header(stamp, "base_link"),
            phase="stopped" if self.cause else "moving" if self.state == "moving" else "ready",
            cause="standing",
            estop=bool(self.cause),
            estop_cause=self.cause,
            latch=self.latch,
            taken=self.taken,
            battery=0.8,
            realtime_factor=1.0,
        )
        self.bus.publish(t.ROBOT_STATE, state, stamp)
        health = msg.OdometryHealth(header=header(stamp, ODOM), health="good", overlap=0.9, inliers=0.95)
        self.bus.publish(t.ODOM_HEALTH, health, stamp)
        limits = msg.MotionLimits(
            header=header(stamp, "base_link"), forward=1.0, backward=1.0, left=1.0, right=1.0
        )
        self.bus.publish(t.MOTION_LIMITS, limits, stamp)
        status = msg.MapStatus(
            header=header(stamp, MAP),
            epoch=self.epoch,
            known_cells=60000,
            trusted_cells=55000,
            resolution=0.04,
            prior=self.prior,
            detail="the map was loaded; 60000 cells are known from before" if self.prior else "",
            location="ambiguous" if self.alike else "",
            location_detail="ambiguous in here.npz" if self.alike else "",
            candidates=np.array(self.alike),
        )
        self.bus.publish(t.MAP_STATUS, status, stamp)
        told = msg.GoalStatus(header=header(stamp, MAP), state=self.state, reason=self.reason)
        if self.goal is not None:
            told.id, told.x, told.y, told.owner = self.goal.id, self.goal.x, self.goal.y, self.goal.owner
            told.has_yaw, told.yaw = self.goal.has_yaw, self.goal.yaw
            told.distance_left = math.hypot(self.goal.x - self.x, self.goal.y - self.y)
        self.bus.publish(t.GOAL_STATUS, told, stamp)
        news: tuple[tuple[t.Topic, msg.Message], ...] = (
            *((t.ODOM, odom), (t.ROBOT_STATE, state)),
            *((t.MAP_STATUS, status), (t.GOAL_STATUS, told)),
        )
        for new in news:
            self.events.take(*new)
            self._do(self.mission.on(*new))
        for event in self.events.due():
            self.bus.publish(t.EVENTS, event, stamp_of(event))
        self._do(self.mission.tick(stamp))


@cache
def grey() -> bytes:
    """JPEG of a grey picture of the camera's size."""
    camera, out = CameraConfig(), io.BytesIO()
    Image.new("RGB", (camera.width, camera.height), (90, 90, 90)).save(out, "JPEG")
    return out.getvalue()


_angle = np.linspace(-math.pi, math.pi, 720)
_range = np.minimum(6.0, 2.4 / np.maximum(np.abs(np.sin(_angle)), 0.05))
POINTS = np.column_stack(
    [_range * np.cos(_angle), _range * np.sin(_angle), 0.2 * np.ones_like(_angle)]
).astype(np.float32)


def report(question: msg.RouteQuestion) -> msg.RouteReport:
    """A straight route in five transitions, the third the worst. Beyond x = 4.6 m it is likely to fail."""
    n = 6
    share = np.linspace(0.0, 1.0, n)
    x = question.start_x + share * (question.goal_x - question.start_x)
    y = question.start_y + share * (question.goal_y - question.start_y)
    yaw = np.full(n - 1, math.atan2(question.goal_y - question.start_y, question.goal_x - question.start_x))
    length = math.hypot(question.goal_x - question.start_x, question.goal_y - question.start_y)
    body = np.array([0.05, 0.1, 0.6, 0.2, 0.05])
    ok = question.goal_x < 5.0
    if not ok:
        return msg.RouteReport(
            id=question.id, question=True, ok=False, reason="no_route", detail="nothing leads there"
        )
    return msg.RouteReport(
        id=question.id,
        question=True,
        ok=True,
        reaches_goal=True,
        cost=1.4 * length,
        length=length,
        duration=length / 0.5,
        x=x,
        y=y,
        z=np.zeros(n),
        yaw=np.full(n, yaw[0]),
        node_x=x,
        node_y=y,
        node_z=np.zeros(n),
        transition_length=np.full(n - 1, length / (n - 1)),
        transition_cost=np.full(n - 1, 1.4 * length / (n - 1)),
        transition_turn=np.zeros(n - 1),
        transition_risk=np.full(n - 1, 0.1),
        transition_body=body,
        transition_unknown=np.zeros(n - 1),
        transition_p_fail=0.1 * body,
        p_fail=0.3 if question.goal_x > 4.6 else 0.1,
        worst="up a 0.16 m face at x 2.0 y 0.0",
        d_fb=body * 0.2,
        a_lr=body * 10.0,
        p_int=body * 0.05,
        worst_x=(x[:-1] + x[1:]) / 2,
        worst_y=(y[:-1] + y[1:]) / 2,
        worst_yaw=yaw,
        native_x=x,
        native_y=y + 0.3,
        native_length=1.02 * length,
        native_body=0.9,
    )


class Console:
    """The console's process, as a thread of this one."""

    def __init__(self, robot: Robot, folder: Path, name: str = "go2w", **settings: Any) -> None:
        """`folder`: of logs; `name` of the robot. The run folder is that of the environment."""
        self.robot = robot
        sets = ["console.port=0", *(f"console.{key}={value}" for key, value in settings.items())]
        self.config = load(
            None, sets, robot=name, scene="yard", port=robot.port, log_dir=str(folder / "logs" / "now")
        )
        self._end = threading.Event()
        self._up = threading.Event()
        self.serve: Serving | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        assert self._up.wait(20.0)

    def _run(self) -> None:
        with Bus(self.config.endpoint, "console") as bus, serving(self.config, bus) as self.serve:
            self._up.set()
            while not self._end.is_set():
                self.serve.turn(bus)

    def address(self, role: str = "operator") -> str:
        """Where a browser comes in."""
        return console_address(self.config.robot, role)

    def close(self) -> None:
        """As `up` ends it."""
        self._end.set()
        self._thread.join()
