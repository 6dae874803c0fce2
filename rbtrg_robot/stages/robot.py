"""The robot process: a backend behind the safety gate. The only place where commands become motion."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hal.contract import Backend
from hal.geofence import Geofence
from hal.safety import GateInputs, GateStatus, SafetyGate, StopCause
from hal.tilt import TiltFilter
from hal.types import (
    NS,
    GroundTruth,
    ImuSample,
    JointSample,
    LidarScan,
    ModeRequest,
    Phase,
    RobotState,
    Sample,
    VelocityCommand,
)
from rbtrg_robot import messages
from rbtrg_robot import topics as t
from rbtrg_robot.bus import Bus
from rbtrg_robot.convert import imu_msg, joint_msg, scan_msg, truth_msg, yaw_of
from rbtrg_robot.frames import MapFrame
from rbtrg_robot.messages import array, header, make, stamp_of
from rbtrg_robot.node import Heart
from rbtrg_robot.processes import BY_NAME, PROCESSES
from rbtrg_robot.stage import Outputs
from rbtrg_robot.topics import Topic

log = logging.getLogger(__name__)

STEP = 5_000_000
"""Gate and simulator period [ns]."""
CLOCK_EVERY = 2
STATE_PERIOD = NS // 10
START_LIMIT = 150.0
"""Longest wait [s] for the other processes before simulated time starts without them."""
POSE_LIMIT = 0.3
"""Odometry older than this [s] says nothing about motion."""


class RobotStage:
    """Backend, gate and their messages."""

    inputs = (t.CMD_VEL, t.ROBOT_COMMAND, t.POSE, t.TF_STATIC)

    def __init__(
        self, backend: Backend, gate: SafetyGate, *, simulated: bool, watched: frozenset[str]
    ) -> None:
        """`watched`: processes without which the robot must not move."""
        self._backend = backend
        self._gate = gate
        self._simulated = simulated
        self._missing = set(watched)
        self._watched = watched
        self._tilt = TiltFilter()
        self._frame = MapFrame()
        self._stamps: dict[str, int] = {}
        self._pose: Any = None
        self._now = 0
        self._ticks = 0
        self._state_due = 0
        self._shown: tuple[Any, ...] = ()
        self._driven = VelocityCommand(0)
        self.realtime_factor = 1.0
        sensors = (t.IMU, t.JOINTS, t.POINTS, t.ROBOT_STATE)
        self.outputs: tuple[Topic, ...] = (*sensors, t.CLOCK, t.TRUTH) if simulated else sensors

    def warm_up(self) -> None:
        """Reach the robot. Raises BackendError."""
        self._backend.connect()

    def close(self) -> None:
        """Leave the robot safe."""
        self._backend.close()

    @property
    def start_time(self) -> int:
        """Source clock [ns] at which a simulator begins."""
        return int(self._backend.options.start_time)  # type: ignore[attr-defined]

    def alive(self, process: str, alive: bool) -> None:
        """A watched process appeared or went: without it the robot stands."""
        if process not in self._watched:
            return
        if alive:
            self._missing.discard(process)
        else:
            self._missing.add(process)
            self._gate.forget()

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        if topic is t.CMD_VEL:
            if not self._missing:
                twist = message.twist
                command = VelocityCommand(
                    stamp_of(message),
                    twist.linear.x,
                    twist.linear.y,
                    twist.angular.z,
                    message.header.frame_id,
                )
                self._gate.command(command, self._now)
        elif topic is t.POSE:
            self._pose = message
        elif topic is t.TF_STATIC:
            self._frame.take(message)
        elif topic is t.ROBOT_COMMAND:
            self._request(message)
        elif (
            topic is t.ROBOT_STATE and message.estop
        ):  # handed over after a restart: a latch outlives a crash
            self._gate.stop(StopCause.OPERATOR, message.estop_cause)
        return []

    def _request(self, message: Any) -> None:
        if message.mode not in ModeRequest._value2member_map_:
            return
        mode = ModeRequest(message.mode)
        if mode is ModeRequest.STOP:
            self._gate.stop(StopCause.OPERATOR, message.cause)
        elif mode is ModeRequest.RESUME:
            self._gate.resume()
        self._backend.request(mode)
        self._state_due = 0

    def tick(self, now: int) -> Outputs:
        """Gate, drive, read."""
        self._now = now
        self._ticks += 1
        state = self._backend.state()
        self._driven = self._gate.output(now, self._inputs(now, state))
        self._backend.drive(self._driven)
        outputs: Outputs = []
        for sample in self._backend.read(now):
            outputs += self._publish(sample)
        status = self._gate.status()
        state = self._backend.state()
        shown = (state.phase, state.cause, status.latched, status.cause)
        if now >= self._state_due or shown != self._shown:
            self._shown = shown
            self._state_due = now + STATE_PERIOD
            outputs.append((t.ROBOT_STATE, self._state_msg(now, state, status)))
        if self._simulated and self._ticks % CLOCK_EVERY == 0:
            clock = make(t.CLOCK.type, clock=messages.time_msg(now))
            outputs.append((t.CLOCK, clock))
        return outputs

    def _inputs(self, now: int, state: RobotState) -> GateInputs:
        velocity = pose = None
        if self._pose is not None and (now - stamp_of(self._pose)) / NS < POSE_LIMIT:
            twist = self._pose.twist.twist
            velocity = (twist.linear.x, twist.linear.y, twist.angular.z)
            place = self._pose.pose.pose
            pose = self._frame.pose2(place.position.x, place.position.y, yaw_of(place.orientation))
        return GateInputs(state, self._tilt.tilt, velocity, pose, self._stamps)

    def _publish(self, sample: Sample) -> Outputs:
        if isinstance(sample, ImuSample):
            self._stamps["imu"] = sample.stamp
            self._tilt.update(sample)
            return [(t.IMU, imu_msg(sample))]
        if isinstance(sample, JointSample):
            self._stamps["joints"] = sample.stamp
            return [(t.JOINTS, joint_msg(sample))]
        if isinstance(sample, LidarScan):
            self._stamps["lidar"] = sample.stamp
            return [(t.POINTS, scan_msg(sample))]
        if isinstance(sample, GroundTruth):
            return [(t.TRUTH, truth_msg(sample))]
        return []  # RobotState is read from the backend at each tick

    def _state_msg(self, now: int, state: RobotState, status: GateStatus) -> Any:
        hold = status.hold
        if self._missing and not status.latched:
            hold = f"waiting for {', '.join(sorted(self._missing))}"
        phase = (
            Phase.STOPPED if status.latched and state.phase in (Phase.READY, Phase.MOVING) else state.phase
        )
        return make(
            t.ROBOT_STATE.type,
            header=header(now, "base_link"),
            phase=phase.value,
            cause=state.cause,
            estop=status.latched,
            estop_cause=status.cause,
            battery=float(state.battery),
            motor_temperature=float(state.motor_temperature),
            contact=array(state.contact, "bool"),
            vx=self._driven.vx,
            vy=self._driven.vy,
            wz=self._driven.wz,
            refused_reason=list(status.refused),
            refused_count=array(list(status.refused.values()), "uint32"),
            hold=hold,
            realtime_factor=self.realtime_factor,
        )


def build(config: Any, restored: dict[Topic, bytes] | None = None) -> RobotStage:
    """From the stack's configuration. Raises BackendError, SceneError.

    A restarted simulator goes on where the last one died: `restored` holds its newest truth.
    """
    watched = frozenset(p.name for p in PROCESSES if p.stops_motion and p.name not in config.without)
    backend = _simulator(config, restored or {}) if config.simulated else _hardware(config)
    area = config.allowed_area()
    gate = SafetyGate(backend.capabilities, config.gate, Geofence.of(area) if area else None)
    return RobotStage(backend, gate, simulated=config.simulated, watched=watched)


def _simulator(config: Any, restored: dict[Topic, bytes]) -> Backend:
    from hal.mujoco.backend import MujocoBackend
    from hal.mujoco.options import SimOptions

    options = SimOptions(
        controller=config.controller,
        policy_dir=config.policy_dir or None,
        lidar=config.lidar,
        lidar_mount=config.mount,
        seed=config.seed,
        start=config.origin,
        **config.sim,
    )
    if t.TRUTH in restored:
        truth = messages.decode(restored[t.TRUTH], t.TRUTH.type)
        place = truth.pose.pose
        start = (place.position.x, place.position.y, yaw_of(place.orientation))
        options = replace(options, start=start, start_time=stamp_of(truth) // STEP * STEP)
    backend = MujocoBackend(config.load_scene(), options)
    if backend.notice:
        log.info("%s", backend.notice)
    return backend


def _hardware(config: Any) -> Backend:
    from hal.unitree import make_backend
    from hal.unitree.options import UnitreeOptions

    mount = None if config.mount is None else (*config.mount.translation, *config.mount.rpy)
    options = UnitreeOptions(lidar=config.lidar, lidar_mount=mount)
    backend: Backend = make_backend(config.interface, dry_run=config.dry_run, options=options)
    return backend


class Pace:
    """Keeps a simulator on the wall clock, and measures how well it keeps up."""

    WINDOW = 2.0
    MOST_BEHIND = 0.1
    """[s] of lag that is caught up; more is given away, or the simulator would race after a stall."""

    def __init__(self, now: int) -> None:
        self._wall = time.monotonic()
        self._source = now
        self._history: deque[tuple[float, int]] = deque()

    def target(self) -> int:
        """Where the source clock should stand [ns]."""
        return self._source + int((time.monotonic() - self._wall) * NS)

    def at(self, now: int) -> float:
        """The source clock has reached `now`; returns the real-time factor over the last 2 s."""
        wall = time.monotonic()
        behind = self.target() - now
        if behind > self.MOST_BEHIND * NS:
            self._source -= behind
        self._history.append((wall, now))
        while wall - self._history[0][0] > self.WINDOW:
            self._history.popleft()
        (w0, n0), (w1, n1) = self._history[0], self._history[-1]
        return (n1 - n0) / NS / (w1 - w0) if w1 > w0 + 0.2 else 1.0


def main(config: Any, bus: Bus, stopping: Callable[[], bool], restored: dict[Topic, bytes]) -> None:
    """The process: paced by the wall clock."""
    heart = Heart(bus, BY_NAME["robot"].name)
    heart.beat("starting")
    stage = build(config, restored)
    now = stage.start_time if config.simulated else time.time_ns()
    try:
        stage.warm_up()
        changes: deque[tuple[str, bool]] = deque()

        def changed(process: str, alive: bool) -> None:
            changes.append((process, alive))
            bus.wake()

        bus.watch_processes(changed)
        for topic in stage.outputs:
            bus.advertise(topic)
        bus.subscribe(stage.inputs)
        for topic, payload in restored.items():
            stage.on(topic, messages.decode(payload, topic.type))
        if config.simulated and not restored:
            _wait_for_all(bus, heart, config, stopping)
        pace = Pace(now)
        while not stopping():
            heart.beat()
            ahead = (now + STEP - pace.target()) / NS if config.simulated else STEP / NS
            inbox = bus.take(min(max(ahead, 0.0), 0.005))
            while changes:
                stage.alive(*changes.popleft())
            for received in inbox:
                try:
                    stage.on(received.topic, received.decode())
                except messages.MessageError:
                    continue  # counted by its sender's tests; a broken command is no command
            if not config.simulated:
                now = time.time_ns()
                publish(bus, stage.tick(now), now)
                continue
            target = pace.target()
            while now + STEP <= target and not stopping():
                now += STEP
                publish(bus, stage.tick(now), now)
                stage.realtime_factor = pace.at(now)
                if bus.waiting:
                    break
    finally:
        stage.close()


def _wait_for_all(bus: Bus, heart: Heart, config: Any, stopping: Callable[[], bool]) -> None:
    """Simulated time starts when every process listens: nobody misses the first messages, so a re-run sees the same."""
    missing = {p.name for p in PROCESSES if p.name not in ("robot", *config.without)}
    if not config.record:
        missing.discard("recorder")
    bus.subscribe([t.HEARTBEAT])
    deadline = time.monotonic() + START_LIMIT
    while missing and not stopping() and time.monotonic() < deadline:
        heart.beat("starting", f"waiting for {', '.join(sorted(missing))}")
        for received in bus.take(0.1):
            if received.topic is t.HEARTBEAT:
                beat = received.decode()
                if beat.state == "ready":
                    missing.discard(beat.process)


def publish(bus: Bus, outputs: Outputs, now: int) -> None:
    """Send what a tick gave."""
    for topic, message in outputs:
        bus.publish(topic, message, stamp_of(message) or now)
