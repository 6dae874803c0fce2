"""A backend behind the safety gate. The only place where commands become motion."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.contract import UP, Backend
from hal.limbs import WHEEL_JOINTS
from hal.lowlevel import Sighted
from hal.robots import Robot, describe
from hal.safety.gate import GateInputs, GateStatus, SafetyGate
from hal.safety.gate_types import MotionLimits
from hal.safety.mux import TELEOP, TRACKER
from hal.safety.tilt import TiltFilter
from hal.types import (
    FELT_EDGE,
    NS,
    GroundTruth,
    ImuSample,
    JointSample,
    LidarScan,
    ModeRequest,
    Phase,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)
from mapping.odometry.health import Health
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import fence_of
from rbtrg_robot.config import GUARD
from rbtrg_robot.stages.command_path import CommandPath
from rbtrg_robot.stages.feeling import Feeling
from rbtrg_robot.stages.sight import Sight
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.convert import imu_msg, joint_msg, scan_msg, truth_msg, xyz, xyzw, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import array, header, stamp_of

STEP_PERIOD = 5_000_000
"""Gate and simulator period [ns]."""
CLOCK_EVERY = 2
STATE_PERIOD = NS // 10
DIAGNOSTICS_PERIOD = NS
SETTLE_TIME = NS
"""Time [ns] that a restarted process gets to end what it left. A restarted navigator appears before it has told the
tracker that its goal is over."""
POSE_LIMIT = 0.3
"""Odometry older than this [s], or as far in the future, says nothing about motion."""


class RobotStage:
    """Commands in, sensor messages out; a backend and the safety gate between them.

    In: velocity commands, tilts of the trunk, requests, poses, which processes live. Out: IMU, joints, sweeps, robot
    state, and the simulator's clock and truth. It decides whether a velocity or a tilt reaches the robot. It never
    makes one of its own."""

    inputs: tuple[Topic, ...] = (
        t.CMD_VEL,
        t.TRUNK,
        t.TELEOP,
        t.TELEOP_TRUNK,
        t.ROBOT_COMMAND,
        t.ROBOT_STOP,
        t.POSE,
        t.ODOM_HEALTH,
        t.TF_STATIC,
        t.MOTION_LIMITS,
        t.AREAS,
    )

    def __init__(
        self,
        backend: Backend,
        gate: SafetyGate,
        *,
        simulated: bool,
        watched: frozenset[str],
        robot: Robot | None = None,
    ) -> None:
        """`watched`: processes without which the robot must not move; `robot`: what it is, None: the default one."""
        robot = robot or describe()
        self._radius = robot.limbs.radius
        self.backend = backend
        self._gate = gate
        self._fence = gate.geofence
        """Of the configuration."""
        self._simulated = simulated
        self._missing = set(watched)
        self._watched = watched
        self._lost: set[str] = set()
        self._settled = 0
        """Commands count from this time on [ns]."""
        self._tilt = TiltFilter()
        self._frame = MapFrame()
        self._stamps: dict[str, int] = {}
        self._pose: msg.Odometry | None = None
        self._astray = False
        """Odometry says that it is lost: its velocity tells nothing, the wheels and the gyro do."""
        self._sight = Sight(backend.places) if isinstance(backend, Sighted) and len(backend.places) else None
        if self._sight is not None:
            self.inputs = (*RobotStage.inputs, t.MAP_WINDOW, t.MAP_STATUS)
        self._feeling = Feeling(robot.limbs, robot.body)
        self._limits: dict[str, MotionLimits] = {}
        """The newest of each sender: a guard that was started anew is another one than before."""
        self.now = 0
        """When what comes in is taken [ns]: a host in real time sets it before, else that of the newest tick counts."""
        self._ticks = 0
        self._state_due = 0
        self._diagnostics_due = 0
        self._figures: dict[str, float] = {}
        """Of the backend, when they were last told."""
        self._shown: tuple[Any, ...] = ()
        self._rolls = self._turns = 0.0
        """Speed of the wheels [m/s], yaw rate of the gyro [rad/s]."""
        self._driven = VelocityCommand(0)
        self._trunk = PostureCommand(0)
        self._commands = CommandPath(gate)
        self.realtime_factor = 1.0
        lidars: tuple[Topic, ...] = tuple(t.SWEEPS[lidar.name] for lidar in backend.capabilities.lidars)
        sensors: tuple[Topic, ...] = (t.IMU, t.JOINTS, *lidars, t.ROBOT_STATE, t.TOUCHED, t.DIAGNOSTICS)
        self.outputs: tuple[Topic, ...] = (*sensors, t.CLOCK, t.TRUTH) if simulated else sensors

    def warm_up(self) -> None:
        """Reach the robot. Raises BackendError."""
        self.backend.connect()

    def close(self, *, lie_down: bool = True) -> None:
        """Leave the robot safe; see `Backend.close`."""
        self.backend.close(lie_down=lie_down)

    @property
    def start_time(self) -> int:
        """Source clock [ns] at which a simulator begins."""
        return int(self.backend.start_time)  # type: ignore[attr-defined]

    def alive(self, process: str, alive: bool) -> None:
        """A watched process appeared or went: without it the robot stands."""
        if process not in self._watched:
            return
        if alive:
            self._missing.discard(process)
            if process in self._lost:
                self._settled = self.now + SETTLE_TIME
        else:
            self._missing.add(process)
            self._lost.add(process)
            self._gate.forget()

    def on(self, topic: Topic, message: Any, sender: str = "") -> Outputs:
        """Take one message; `sender` names its publisher."""
        if t.CMD_VEL.carried(message, topic):
            if not self._missing and self.now >= self._settled:
                self._commands.drive(TRACKER, message, sender, self.now)
        elif t.TRUNK.carried(message, topic):
            if not self._missing and self.now >= self._settled:
                self._commands.tilt(TRACKER, message, sender, self.now)
        elif t.TELEOP.carried(message, topic):
            # The guard is all that hands need.
            if GUARD not in self._missing:
                self._commands.drive(TELEOP, message, sender, self.now)
        elif t.TELEOP_TRUNK.carried(message, topic):
            if GUARD not in self._missing:
                self._commands.tilt(TELEOP, message, sender, self.now)
        elif t.POSE.carried(message, topic):
            self._pose = message
        elif t.ODOM_HEALTH.carried(message, topic):
            self._astray = message.health == Health.LOST
        elif t.TF_STATIC.carried(message, topic):
            if self._frame.take(message) and self._sight is not None:
                self._sight.forget()
        elif t.MAP_WINDOW.carried(message, topic):
            if self._sight is not None:
                self._sight.window(message)
        elif t.MAP_STATUS.carried(message, topic):
            if self._sight is not None:
                self._sight.status(message)
        elif t.MOTION_LIMITS.carried(message, topic):
            limits = (message.forward, message.backward, message.left, message.right)
            ground = (message.uneven_ahead, message.uneven_behind, message.near_body)
            self._limits[sender] = MotionLimits(stamp_of(message), *limits, message.reason, *ground)
        elif t.AREAS.carried(message, topic):
            self._gate.geofence = self._fence.and_all_of(fence_of(message.areas))
        elif t.ROBOT_COMMAND.carried(message, topic):
            self._request(message)
        elif t.ROBOT_STOP.carried(message, topic):
            self._request(replace(message, mode=ModeRequest.STOP.value))
        elif t.ROBOT_STATE.carried(message, topic):
            self._commands.restore(message)
        return []

    def _request(self, message: msg.RobotCommand) -> None:
        mode = self._commands.request(message, self.now)
        if mode is not None:
            self.backend.request(mode)
            self._state_due = 0

    def tick(self, now: int) -> Outputs:
        """Gate, drive, read."""
        self.now = now
        self._ticks += 1
        if not self._missing and now >= self._settled:
            self._lost.clear()
        state = self.backend.state()
        self._driven = self._gate.output(now, self._inputs(now, state))
        self.backend.drive(replace(self._driven, climb=self._feeling.may_climb(self._driven.vx)))
        trunk = self._gate.trunk
        if (trunk.roll, trunk.pitch) != (self._trunk.roll, self._trunk.pitch):
            self.backend.posture(trunk)
        self._trunk = trunk
        if self._sight is not None and isinstance(self.backend, Sighted):
            self.backend.see(self._sight.ground(now, self._place()))
        outputs: Outputs = []
        for sample in self.backend.read(now):
            outputs += self._publish(sample)
        status = self._gate.status()
        self._commands.follow_gate(now)
        state = self.backend.state()
        shown = (
            state.phase,
            state.cause,
            status.latched,
            status.cause,
            self._commands.latch(now),
            self._commands.taken(now),
            status.not_moving,
            status.motion_unchecked,
            status.creeps > 0.0,
        )
        if now >= self._state_due or shown != self._shown:
            self._shown = shown
            self._state_due = now + STATE_PERIOD
            outputs.append((t.ROBOT_STATE, self._state_msg(now, state, status)))
        if now >= self._diagnostics_due:
            self._diagnostics_due = now + DIAGNOSTICS_PERIOD
            outputs += self._diagnostics(now)
        if self._simulated and self._ticks % CLOCK_EVERY == 0:
            clock = msg.Clock(clock=messages.time_msg(now))
            outputs.append((t.CLOCK, clock))
        return outputs

    def _diagnostics(self, now: int) -> Outputs:
        """The backend's figures; a warning while one of its counters rises."""
        figures = self.backend.diagnostics()
        if not figures:
            return []
        told, self._figures = self._figures, figures
        rising = [k for k, v in figures.items() if isinstance(v, int) and told and v > told.get(k, 0)]
        status = msg.DiagnosticStatus(
            level=msg.DiagnosticStatus.WARN if rising else msg.DiagnosticStatus.OK,
            name=t.BACKEND_FIGURES,
            message=f"rising: {', '.join(rising)}" if rising else "well",
            hardware_id=self.backend.capabilities.name,
            values=[
                msg.KeyValue(key=k, value=f"{v:.6g}" if isinstance(v, float) else str(v))
                for k, v in figures.items()
            ],
        )
        return [(t.DIAGNOSTICS, msg.DiagnosticArray(header=header(now, ""), status=[status]))]

    def _inputs(self, now: int, state: RobotState) -> GateInputs:
        velocity = pose = None
        if (fresh_pose := self._fresh) is not None:
            twist = fresh_pose.twist.twist
            if not self._astray:
                velocity = (twist.linear.x, twist.linear.y, twist.angular.z)
            place = fresh_pose.pose.pose
            # Where `odom` lies in `map` must be known: the fence would stand in the wrong place.
            if self._frame.known:
                pose = self._frame.pose2(place.position.x, place.position.y, yaw_of(place.orientation))
        wheels = (self._rolls, self._turns)
        fresh = all(0 <= now - self._stamps.get(x, -NS) < POSE_LIMIT * NS for x in ("imu", "joints"))
        self._feeling.guard(self._least(now))
        return GateInputs(
            state,
            self._tilt.tilt,
            velocity,
            wheels if fresh else None,
            self._tilt.lean,
            pose,
            self._feeling.limits(now),
            self._stamps,
        )

    @property
    def _fresh(self) -> msg.Odometry | None:
        """The newest pose; None where it is too old to tell of motion."""
        pose = self._pose
        return pose if pose is not None and abs(self.now - stamp_of(pose)) / NS < POSE_LIMIT else None

    def _place(self) -> tuple[NDArray[np.float64], float] | None:
        """Position (3,) [m] and yaw [rad] of base_link in `map`; None where it is not known."""
        if self._fresh is None or not self._frame.known:
            return None
        place = self._fresh.pose.pose
        position, _ = self._frame.pose3(xyz(place.position), xyzw(place.orientation))
        return position, self._frame.pose2(0.0, 0.0, yaw_of(place.orientation))[2]

    def _least(self, now: int) -> MotionLimits | None:
        """The guard's limits. While several senders are fresh, the least of all: nobody lifts what another one sets."""
        fresh = {
            sender: limits
            for sender, limits in self._limits.items()
            if abs(now - limits.stamp) <= self._gate.params.guard_timeout * NS
        }
        if not fresh:
            return max(self._limits.values(), key=lambda limits: limits.stamp, default=None)
        self._limits = fresh
        return reduce(MotionLimits.least, fresh.values())

    def _publish(self, sample: Sample) -> Outputs:
        if isinstance(sample, ImuSample):
            self._stamps["imu"] = sample.stamp
            self._turns = float(sample.gyro[2])
            self._tilt.update(sample)
            self._feeling.imu(sample)
            return [(t.IMU, imu_msg(sample))]
        if isinstance(sample, JointSample):
            self._stamps["joints"] = sample.stamp
            self._rolls = float(sample.velocity[WHEEL_JOINTS].mean()) * self._radius
            # Where the wheels feel an edge their reflex moves the robot, not the command.
            reflex = self.backend.state().cause.startswith(FELT_EDGE)
            driven = VelocityCommand(self.now) if reflex else self._driven
            speed = None if self._fresh is None else self._fresh.twist.twist.linear.x
            return [
                (t.JOINTS, joint_msg(sample)),
                *self._feeling.joints(sample, driven, self._place, speed),
            ]
        if isinstance(sample, LidarScan):
            # Of any LiDAR: where one is silent, odometry and map go on with the other and say so.
            self._stamps["lidar"] = max(sample.stamp, self._stamps.get("lidar", 0))
            return [(t.SWEEPS[sample.name], scan_msg(sample))]
        if isinstance(sample, GroundTruth):
            return [(t.TRUTH, truth_msg(sample))]
        return []  # RobotState is read from the backend at each tick

    def _state_msg(self, now: int, state: RobotState, status: GateStatus) -> msg.RobotState:
        hold, taken = status.hold, self._commands.taken(now)
        if self._missing and not status.latched:
            hold = f"waiting for {', '.join(sorted(self._missing))}"
        elif self.now < self._settled and not status.latched:
            hold = f"{', '.join(sorted(self._lost))} just came back"
        elif taken and hold in ("no command", "no fresh command"):
            hold = taken
        phase = (
            Phase.STOPPED if status.latched and state.phase in (Phase.READY, Phase.MOVING) else state.phase
        )
        refused = {**status.refused, **self._commands.turned_away}
        return msg.RobotState(
            header=header(now, "base_link"),
            phase=phase.value,
            cause="; ".join(filter(None, (state.cause + _remark(state, status), self._feeling.words(now)))),
            estop=status.latched,
            estop_cause=status.cause,
            latch=self._commands.latch(now),
            taken=taken,
            battery=float(state.battery),
            motor_temperature=float(state.motor_temperature),
            contact=array(state.contact, "bool"),
            vx=self._driven.vx,
            vy=self._driven.vy,
            wz=self._driven.wz,
            trunk_roll=self._trunk.roll,
            trunk_pitch=self._trunk.pitch,
            refused_reason=list(refused),
            refused_count=array(list(refused.values()), "uint32"),
            hold=hold,
            hands=self._commands.hands(now),
            realtime_factor=self.realtime_factor,
        )


def _remark(state: RobotState, status: GateStatus) -> str:
    """Remark of the gate after the robot's own words."""
    if status.not_moving:
        return "; commanded but not moving"
    if status.creeps:
        return f"; it creeps down a slope at {status.creeps:.2f} m/s"
    return (
        "; motion is not checked, odometry is silent" if status.motion_unchecked and state.phase in UP else ""
    )
