"""The robot's side of the Unitree topics without a network: services, modes, telemetry bytes, and faults to inject.

Pure: time comes in, messages go in and out. `tests.hal.unitree.peer` puts it on DDS; unit tests drive it in lockstep.
Semantics follow what users report of the real robot: Move is held for a second and ignored for a while after StandUp,
StandDown works only after StandUp, the mode switcher is busy after ReleaseMode, sportmodestate ends with the service.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from hal.robots import Robot, describe
from hal.rotation import rotation_rpy
from hal.types import NS, POINT_DTYPE, ModeRequest, Phase, VelocityCommand
from hal.unitree import api
from hal.unitree.api import MotionSwitcher, ObstaclesAvoid, Request, Response, Sport
from hal.unitree.cloud import RawImu, encode_cloud, encode_imu
from hal.unitree.layout import (
    CDR_HEADER,
    LOW_STATE_CDR,
    SPORT_MODE_STATE_CDR,
    low_state_checksum,
)
from hal.unitree.link import L1_IMU, LOW_STATE, SPORT_STATE
from hal.unitree.motion import GO2W_WHEELS

HOLD = 1.0
"""[s] the last Move is kept."""
LOW_STATE_RATE = 500
"""[Hz] of the real robot."""
LOW_STATE_PERIOD = NS // LOW_STATE_RATE
BESIDE = GO2W_WHEELS.half_track * np.array([1.0, -1.0, 1.0, -1.0])
"""Of the wheels, to the left [m]."""


@dataclass
class Faults:
    """What is wrong with this robot. Times in seconds; change them while it runs."""

    deaf: float = 0.0
    """Move is accepted and ignored for this long after StandUp."""
    busy: float = 0.0
    """The mode switcher answers 7002 for this long after ReleaseMode (or from the start when released)."""
    released: bool = False
    """No motion service is active at the start."""
    drop: int = 0
    """This many responses are lost."""
    late: float = 0.0
    """Responses come this much later."""
    low_silent: bool = False
    low_frozen: bool = False
    """LowState keeps coming with the same content."""
    sport_silent: bool = False
    sport_frozen: bool = False
    """sportmodestate keeps coming with the same stamp."""
    coded: bool = False
    """sportmodestate tells the posture in error_code alone; mode and body_height stay 0."""
    lidar_silent: bool = False
    epoch: float = 1.7e9
    """What the robot's clock shows at the start: 0 is 1970."""
    tick_step: float = 0.0
    """The counter of LowState is off by this much: it was set, with no restart."""
    lidar_step: float = 0.0
    """The same of the LiDAR's clock."""
    accel_scale: float = 1.0
    """On what LowState's accelerometer tells: 1 / 9.81 is g, -1 has the signs reversed."""
    l1_accel: float = 0.0
    """Added to the accelerations of the L1 [m/s^2]."""
    every: int = 1
    """One LowState of so many comes."""
    charge: int = 87
    """[%] of the battery, as told."""
    attitude: float = 1.0
    """Length of LowState's quaternion."""
    lost: int = 0
    """Messages that a motor has lost."""
    wxyz: bool = True
    """The L1's quaternion order, as on the real robot."""
    upright_l1: bool = False
    """The L1 is mounted upright instead of upside down."""
    fallen: bool = False
    """On its back; RecoveryStand rights it within a second."""
    stuck: bool = False
    """Getting up and lying down are accepted without effect."""
    low_bent: bool = False
    """A bit of LowState is not what it was when its checksum was taken."""
    l1_yaw: float = 0.0
    """[rad] the L1 is turned about its own z axis."""
    l1_leak: float = 0.0
    """Share of its z rate that the L1's gyro shows in x."""
    unsigned: bool = False
    """LowState has no checksum."""
    garbage: bool = False
    """Every tenth message of each topic is cut off."""
    babble: bool = False
    """The mode switcher's answers are cut off."""
    remote: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Sticks and trigger of the robot's own remote: lx, rx, ry, L2, ly."""
    rolls: bool = False
    """StopMove and zero Moves are answered, and it rolls on until Damp."""
    serial: int = 0
    """Serial number in LowState."""
    refuse: dict[int, int] = field(default_factory=dict)
    """Sport api id -> result code."""


class Body(Protocol):
    """What moves."""

    def advance(self, now: int) -> None:
        """Simulate to `now` [ns since the robot was switched on]."""

    def drive(self, vx: float, wz: float) -> None:
        """Velocity from now on."""

    def request(self, mode: ModeRequest) -> None:
        """Stand, sit, damp or recover."""

    x: float
    y: float
    yaw: float
    v: float
    wz: float
    height: float
    tilt: float
    phase: Phase
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    accel: np.ndarray
    gyro: np.ndarray

    def scan(self) -> np.ndarray | None:
        """(n,) POINT_DTYPE in base_link of the sweep that just ended, or None."""


class KinematicBody:
    """A point with lag: quick to start and to understand."""

    def __init__(self, standing: bool = True, *, wheeled: bool = True) -> None:
        self._wheeled = wheeled
        self.x = self.y = self.yaw = self.v = self.wz = self.tilt = 0.0
        self.height = 0.32 if standing else 0.08
        self.phase = Phase.READY if standing else Phase.SITTING
        self.q, self.dq, self.tau = np.zeros(16), np.zeros(16), np.full(16, 2.0)
        self.accel, self.gyro = np.array([0.0, 0.0, 9.81]), np.zeros(3)
        self._now = 0
        self._command = (0.0, 0.0)
        self._goal: tuple[Phase, int] | None = None
        self._scan_at = 0
        self._rng = np.random.default_rng(7)

    def drive(self, vx: float, wz: float) -> None:
        self._command = (vx, wz)

    def request(self, mode: ModeRequest) -> None:
        if mode in (ModeRequest.STAND, ModeRequest.RECOVER) and self.phase is not Phase.READY:
            self.phase, self._goal = Phase.STANDING, (Phase.READY, self._now + NS)
        elif mode is ModeRequest.SIT:
            self.phase, self._goal = Phase.STANDING, (Phase.SITTING, self._now + NS)
        elif mode is ModeRequest.DAMP:
            self.phase, self._goal, self.height = Phase.DAMPED, None, 0.08

    def advance(self, now: int) -> None:
        while self._now + 2_000_000 <= now:
            self._now += 2_000_000
            self._step(0.002)

    def _step(self, dt: float) -> None:
        if self._goal is not None and self._now >= self._goal[1]:
            self.phase, self._goal = self._goal[0], None
            self.height = 0.32 if self.phase is Phase.READY else 0.08
        vx, wz = self._command if self.phase is Phase.READY else (0.0, 0.0)
        dv = max(-3.0 * dt, min(3.0 * dt, (0.9 * vx - self.v) * dt / 0.1))
        self.v += dv
        self.wz += (0.95 * wz - self.wz) * dt / 0.1
        self.x += self.v * math.cos(self.yaw) * dt
        self.y += self.v * math.sin(self.yaw) * dt
        self.yaw += self.wz * dt
        self.accel[0], self.gyro[2] = dv / dt, self.wz
        if self._wheeled:
            self.dq[12:] = (self.v + self.wz * BESIDE) / GO2W_WHEELS.radius
            self.q[12:] += self.dq[12:] * dt

    def scan(self) -> np.ndarray | None:
        """Floor and a round wall 5 m away, ten times a second."""
        if self._now - self._scan_at < NS // 10:
            return None
        self._scan_at = self._now
        n = 2000
        points = np.zeros(n, POINT_DTYPE)
        angle = np.linspace(-np.pi, np.pi, n)
        floor = np.arange(n) % 2 == 0
        radius = np.where(floor, 1.0 + (np.arange(n) % 7) * 0.5, 5.0)
        points["x"], points["y"] = radius * np.cos(angle), radius * np.sin(angle)
        points["z"] = np.where(floor, -0.40, 0.3)
        points["time"] = np.linspace(0.0, 0.1, n)
        points["intensity"] = 50.0
        return points


class RobotSide:
    """Services and telemetry of one robot. `now` [ns] counts from switching it on."""

    def __init__(
        self,
        body: Body,
        faults: Faults | None = None,
        lidar: str = "l1",
        topic: str = "",
        robot: Robot | None = None,
        rate: int = LOW_STATE_RATE,
    ) -> None:
        """rate: of LowState [Hz]."""
        self.body, self.faults = body, faults or Faults()
        self._low_period = NS // rate
        robot = robot or describe()
        self._motion = robot.settings.get("unitree", {}).get("motion_mode", "ai-w")
        self._lidar, self._topic = lidar, topic
        self.motion = "" if self.faults.released else self._motion
        self.mode = {Phase.READY: 1, Phase.STANDING: 8}.get(body.phase, 5)
        self.command = (0.0, 0.0)
        self.ended = ""
        """What ended the last motion: "stop" (StopMove), "zero" (a zero Move), "hold" (no Move for a second),
        "other"."""
        self.avoid_remote = False
        self._commanded_at = -(10**18)
        self._deaf_until = -(10**18)
        self._busy_until = round(self.faults.busy * NS) if self.faults.released else -(10**18)
        self._stood_up = False
        self._upright_at: int | None = None
        self._sport_stamp = 0
        self._tick = 0
        self._low_due = self._sport_due = self._imu_due = 0
        self._outbox: dict[str, list[bytes]] = defaultdict(list)
        self._answers: list[tuple[int, str, Response]] = []
        self._sent: dict[str, int] = defaultdict(int)
        self.moves: list[int] = []
        """When a Move came [ns]; whoever reads it empties it."""
        self._low = np.zeros(1, LOW_STATE_CDR)
        low = self._low[0]
        low["head"], low["foot_force"], low["motor_state_first_mode"] = (0xFE, 0xEF), 60, 1
        low["motor_state_modes"]["mode"] = 1
        # Looked up once: LowState is written 500 times a second.
        motors, imu = low["motor_state"], low["imu_state"]
        self._joints = tuple(motors[name][:16] for name in ("q", "dq", "tau_est", "temperature"))
        self._lost = motors["lost"][5:6], motors["reserve"][5, 0:1]
        self._imu = tuple(imu[name] for name in ("quaternion", "gyroscope", "accelerometer"))
        # head (2 bytes), keys (2), then floats: lx, rx, ry, L2, ly
        self._sticks = low["wireless_remote"][4:24].view("<f4")
        self._sport = np.zeros(1, SPORT_MODE_STATE_CDR)
        mount = robot.mounts[lidar or "xt16"]
        translation, rpy = mount.translation, mount.rpy
        if self.faults.upright_l1:
            rpy = (0.0, 0.0, 0.0)
        about_itself = rotation_rpy(0.0, 0.0, self.faults.l1_yaw)
        self._mount = (rotation_rpy(*rpy) @ about_itself, np.array(translation))
        (cr, cp, cy), (sr, sp, sy) = np.cos(np.array(rpy) / 2), np.sin(np.array(rpy) / 2)
        about_z = _product((cy, 0.0, 0.0, sy), (cp, 0.0, sp, 0.0))
        half = 0.5 * self.faults.l1_yaw
        turned = _product(tuple(about_z), (cr, sr, 0.0, 0.0))
        self._turned = tuple(_product(tuple(turned), (math.cos(half), 0.0, 0.0, math.sin(half))))

    # -- services --------------------------------------------------------------------------------------------------

    def handle(self, service: str, request: Request, now: int) -> None:
        """Take a request; its response is put into `responses` in time, or never."""
        parameter = json.loads(request.parameter) if request.parameter else {}
        code, data = self._serve(service, request.api, parameter, now)
        if request.no_reply:
            return
        if self.faults.drop > 0:
            self.faults.drop -= 1
            return
        text = json.dumps(data) if data else ""
        if self.faults.babble and service == api.MOTION_SWITCHER:
            text = text[: len(text) // 2]
        due = now + round(self.faults.late * NS)
        self._answers.append((due, service, Response(request.id, request.api, code, text)))

    def responses(self, now: int) -> list[tuple[str, Response]]:
        """What is due."""
        due = [(service, response) for at, service, response in self._answers if at <= now]
        self._answers = [a for a in self._answers if a[0] > now]
        return due

    def _serve(self, service: str, number: int, parameter: dict, now: int) -> tuple[int, dict]:
        if service == api.MOTION_SWITCHER:
            return self._serve_switcher(number, parameter, now)
        if service == api.OBSTACLES_AVOID:
            if number == ObstaclesAvoid.USE_REMOTE_COMMAND_FROM_API:
                self.avoid_remote = bool(parameter["is_remote_commands_from_api"])
            elif number == ObstaclesAvoid.MOVE and self.avoid_remote:
                self._move(parameter["x"], parameter["yaw"], now)
            return 0, {}
        if service != api.SPORT:
            return 3103, {}
        if not self.motion:
            return 3203, {}
        if number in self.faults.refuse:
            return self.faults.refuse[number], {}
        return self._serve_sport(number, parameter, now), {}

    def _serve_switcher(self, number: int, parameter: dict, now: int) -> tuple[int, dict]:
        if number == MotionSwitcher.CHECK_MODE:
            return 0, {"form": "0", "name": self.motion}
        if number == MotionSwitcher.RELEASE_MODE:
            self.release(now)
            return 0, {}
        if number == MotionSwitcher.SELECT_MODE:
            if now < self._busy_until:
                return api.BUSY, {}
            self.motion = parameter["name"]
            return 0, {}
        return 3103, {}

    def release(self, now: int) -> None:
        """What the app can do at any time: the motion service goes, torque drops."""
        self.motion, self._busy_until = "", now + round(self.faults.busy * NS)
        self._end("other")
        self.body.drive(0.0, 0.0)

    def _serve_sport(self, number: int, parameter: dict, now: int) -> int:
        if self.faults.stuck and number in (Sport.STAND_UP, Sport.STAND_DOWN, Sport.RECOVERY_STAND):
            return 0
        match number:
            case Sport.MOVE:
                self._move(parameter["x"], parameter["z"], now)
            case Sport.STOP_MOVE:
                self._end("stop")
            case Sport.STAND_UP:
                self._stood_up = True
                if self.body.phase is not Phase.READY:
                    self.body.request(ModeRequest.STAND)
                    self._deaf_until = now + round(self.faults.deaf * NS)
                self.mode = 6
                self._end("other")
            case Sport.BALANCE_STAND:
                if self.body.phase is Phase.READY:
                    self.mode = 1
            case Sport.RECOVERY_STAND:
                self._upright_at = now + NS
                self.body.request(ModeRequest.RECOVER)
                self.mode = 8
            case Sport.STAND_DOWN:
                self._end("other")
                if self._stood_up:
                    self.body.request(ModeRequest.SIT)
                    self.mode, self._stood_up = 5, False
            case Sport.DAMP:
                self._end("other")
                self.body.request(ModeRequest.DAMP)
                self.mode = 7
            case Sport.EULER:
                pass
            case _:
                return 3103
        return 0

    def _move(self, vx: float, wz: float, now: int) -> None:
        self.moves.append(now)
        if self.mode in (1, 3) and now >= self._deaf_until and self.motion:
            if (vx, wz) == (0.0, 0.0):
                self._end("zero")
                if self.command != (0.0, 0.0):
                    return
            elif self.command == (0.0, 0.0):
                self.ended = ""
            self.command, self._commanded_at = (vx, wz), now

    def _end(self, why: str) -> None:
        if self.command != (0.0, 0.0) and not (self.faults.rolls and why in ("stop", "zero", "hold")):
            self.command, self.ended = (0.0, 0.0), why

    # -- telemetry -------------------------------------------------------------------------------------------------

    def step(self, now: int) -> None:
        """Advance the body and write the telemetry that is due."""
        if now - self._commanded_at > HOLD * NS:
            self._end("hold")
        if self._upright_at is not None and now >= self._upright_at:
            self.faults.fallen, self._upright_at = False, None
        if self.mode in (1, 3):
            self.mode = 3 if self.command != (0.0, 0.0) else 1
        elif self.mode == 8 and self.body.phase is Phase.READY:
            self.mode = 1
        self.body.drive(*self.command)
        self.body.advance(now)
        f = self.faults
        stamp = now + round(f.epoch * NS)
        if now >= self._low_due:
            self._low_due = max(self._low_due + self._low_period, now)
            if not f.low_frozen:
                self._tick = now // 1_000_000 + round(1e3 * f.tick_step)
                self._write_low()
            if not f.low_silent and now // self._low_period % f.every == 0:
                self._put(LOW_STATE, self._low_bytes())
        if now >= self._sport_due:
            self._sport_due = max(self._sport_due + NS // 50, now)
            if self.motion and not f.sport_silent:
                self._sport_stamp = self._sport_stamp if f.sport_frozen else stamp
                self._put(SPORT_STATE, self._sport_bytes(self._sport_stamp))
        if self._lidar == "l1" and now >= self._imu_due:
            self._imu_due = max(self._imu_due + NS // 250, now)
            turn = self._mount[0].T
            gyro = turn @ self.body.gyro
            raw = RawImu(
                stamp + round(f.lidar_step * NS),
                _product(self._quaternion(), self._turned),
                gyro + np.array([self.faults.l1_leak * gyro[2], 0.0, 0.0]),
                turn @ self.body.accel + self.faults.l1_accel,
            )
            self._put(L1_IMU, encode_imu(raw, "utlidar_imu", f.wxyz))
        points = self.body.scan()
        if points is not None and len(points) and self._topic and not self.faults.lidar_silent:
            base = np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float64)
            local = (base - self._mount[1]) @ self._mount[0]
            out = points.copy()
            out["x"], out["y"], out["z"] = local.T
            start = stamp + round((f.lidar_step - float(points["time"].max())) * NS)
            self._put(self._topic, encode_cloud(start, "utlidar_lidar", out))

    def outbox(self) -> dict[str, list[bytes]]:
        """Messages by topic since the last call."""
        out, self._outbox = self._outbox, defaultdict(list)
        return out

    def _put(self, topic: str, data: bytes) -> None:
        self._sent[topic] += 1
        if self.faults.garbage and self._sent[topic] % 10 == 0:
            data = data[: len(data) // 3]
        self._outbox[topic].append(data)

    def _quaternion(self) -> tuple[float, float, float, float]:
        roll = math.pi if self.faults.fallen else self.body.tilt
        cr, sr = math.cos(roll / 2), math.sin(roll / 2)
        cy, sy = math.cos(self.body.yaw / 2), math.sin(self.body.yaw / 2)
        return cr * cy, sr * cy, sr * sy, cr * sy

    def _write_low(self) -> None:
        low, body, faults = self._low[0], self.body, self.faults
        low["tick"], low["sn"] = self._tick % 2**32, (faults.serial, 0)
        q, dq, tau, temperature = self._joints
        q[:], dq[:], tau[:], temperature[:] = body.q, body.dq, body.tau, 38
        quaternion, gyro, accel = self._imu
        quaternion[:], gyro[:], accel[:] = self._quaternion(), body.gyro, body.accel
        accel *= faults.accel_scale
        quaternion *= faults.attitude
        self._lost[0][:], self._lost[1][:] = faults.lost, 4 * (faults.lost > 0)
        low["bms_state"]["soc"] = faults.charge
        self._sticks[:] = faults.remote

    def _low_bytes(self) -> bytes:
        low = self._low[0]
        low["crc"] = 0 if self.faults.unsigned else low_state_checksum(CDR_HEADER + self._low.tobytes())
        data = bytearray(CDR_HEADER + self._low.tobytes())
        data[100] ^= self.faults.low_bent
        return bytes(data)

    def _sport_bytes(self, stamp: int) -> bytes:
        sport, body = self._sport[0], self.body
        sport["stamp"]["sec"], sport["stamp"]["nanosec"] = stamp // NS, stamp % NS
        sport["mode"] = self.mode
        sport["body_height"] = body.height
        if self.faults.coded:
            low = self.mode == 7 or body.height < 0.2
            sport["error_code"] = 1001 if low else 1013 if self.mode in (1, 3) else 1002
            sport["mode"], sport["body_height"] = 0, 0.0
        sport["velocity"] = (body.v * math.cos(body.yaw), body.v * math.sin(body.yaw), 0.0)
        sport["yaw_speed"] = body.wz
        sport["position"] = (body.x, body.y, body.height)
        return CDR_HEADER + self._sport.tobytes()


def _product(a: tuple[float, ...], b: tuple[float, ...]) -> np.ndarray:
    """Of two quaternions w, x, y, z."""
    (w, x, y, z), (p, q, r, s) = a, b
    return np.array(
        [
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        ]
    )


class MujocoBody:
    """The simulated Go2-W as the body: its samples become telemetry."""

    MOST_AT_ONCE = NS // 20
    """[ns] simulated per step: behind a busy machine the body moves slower, or it would answer ever later."""

    def __init__(self, scene: Any = "flat", standing: bool = True, **options: Any) -> None:
        """scene: a name, or a Scene; options: as for `hal.mujoco.backend.MujocoBackend`."""
        from hal.mujoco.backend import MujocoBackend
        from hal.scenes import load_scene

        scene = load_scene(scene) if isinstance(scene, str) else scene
        self._backend = MujocoBackend(scene, seated=not standing, **options)
        self._backend.connect()
        self._mount = self._backend.capabilities.lidars[0].mount
        self._rotation = rotation_rpy(*self._mount.rpy)
        self.x = self.y = self.yaw = self.v = self.wz = self.tilt = 0.0
        self.height = 0.35 if standing else 0.08
        self.q, self.dq, self.tau = np.zeros(16), np.zeros(16), np.zeros(16)
        self.accel, self.gyro = np.array([0.0, 0.0, 9.81]), np.zeros(3)
        self.phase = self._backend.state().phase
        self._points: np.ndarray | None = None
        self._now = self._asked = 0

    def drive(self, vx: float, wz: float) -> None:
        self._backend.drive(VelocityCommand(self._now, vx=vx, wz=wz))

    def request(self, mode: ModeRequest) -> None:
        self._backend.request(mode)
        self.phase = self._backend.state().phase

    def advance(self, now: int) -> None:
        from hal.types import GroundTruth, ImuSample, JointSample, LidarScan

        self._now += min(now - self._asked, self.MOST_AT_ONCE)
        self._asked = now
        for sample in self._backend.read(self._now):
            if isinstance(sample, ImuSample):
                self.gyro, self.accel = sample.gyro, sample.accel
            elif isinstance(sample, JointSample):
                self.q, self.dq, self.tau = sample.position, sample.velocity, sample.effort
            elif isinstance(sample, LidarScan):
                self._points = sample.points
            elif isinstance(sample, GroundTruth):
                self._pose(sample)
        phase = self._backend.state().phase
        self.phase = Phase.READY if phase is Phase.MOVING else phase

    def _pose(self, truth) -> None:
        x, y, z, w = truth.orientation
        self.x, self.y = float(truth.position[0]), float(truth.position[1])
        self.yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self.tilt = math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y))))
        self.v, self.wz = float(truth.linear[0]), float(truth.angular[2])
        self.height = 0.35 if self._backend.state().phase in (Phase.READY, Phase.MOVING) else 0.10

    def scan(self) -> np.ndarray | None:
        points, self._points = self._points, None
        if points is None:
            return None
        out = points.copy()
        local = np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float64)
        out["x"], out["y"], out["z"] = (local @ self._rotation.T + np.array(self._mount.translation)).T
        return out
