"""A synthetic run of the robot: what its sensors would say, and the truth, without physics.

The standard run is the perception benchmark: a figure-eight through an arena for 60 s with a trunk that pitches by
+-10 deg at 0.7 Hz, and motion-distorted scans. Everything is seeded and streams: memory does not grow with duration.

    run = arena_run("mid360", seed=1)
    for sample in run.samples(): ...
    position, orientation = run.truth(stamps)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.lidar.caster import OrientedBox, TerrainCaster
from hal.lidar.simulator import LidarSimulator
from hal.lidar.spec import LIDARS, LidarSpec
from hal.robots.go2w.facts import ROBOT_MASS, WHEEL_RADIUS, wheel_jacobians
from hal.scenes import Scene
from hal.types import (
    GRAVITY,
    NS,
    Array,
    Extrinsics,
    GroundTruth,
    ImuSample,
    JointSample,
    MountedLidar,
    Sample,
)
from mapping.elevation.sensor import Sensor
from tools.synthetic_motion import Motion, legs, quaternions
from tools.synthetic_scenes import FEATURES, OBSTACLE, arena, corridor, feature_scene

TICK_PERIOD = NS // 200
"""IMU period and step of the LiDAR [ns]."""
CHUNK_TICKS = 200
"""Ticks worked out at once."""


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Errors of the proprioceptive sensors, standard deviations."""

    gyro: float = 0.003
    """White, per sample [rad/s]."""
    gyro_bias: float = 0.002
    """Constant, drawn once per axis: what a start-up calibration leaves [rad/s]."""
    accel: float = 0.05
    """White, per sample [m/s^2]."""
    accel_bias: float = 0.04
    """Constant, drawn once per axis [m/s^2]."""
    joint: float = 0.0005
    """Leg encoders [rad]."""
    joint_rate: float = 0.02
    """[rad/s]."""
    slip: float = 0.03
    """Slip of each wheel as a share of its speed, correlated over 0.3 s."""
    scale: float = 0.005
    """Error of the effective wheel radius as a share, drawn once per wheel."""


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticRun:
    """One run. Iterate `samples()`; ask `truth()` at any stamp."""

    scene: Scene
    motion: Motion = field(default_factory=Motion)
    lidar: LidarSpec = field(default_factory=lambda: LIDARS["xt16"])
    mount: Extrinsics | None = None
    """LiDAR in base_link; None: the model's usual mount."""
    duration: float = 60.0
    """[s]."""
    seed: int = 0
    noise: SensorNoise = field(default_factory=SensorNoise)
    boxes: tuple[OrientedBox, ...] = ()
    """Solid all the time."""
    obstacle: OrientedBox | None = None
    """Solid until `removed_at`."""
    removed_at: float = np.inf
    """[s] since the start."""
    gaps: tuple[tuple[float, float], ...] = ()
    """Scans that start in [from, to) [s] are lost."""
    start_stamp: int = 10 * NS
    """Stamp of the first sample [ns]; a multiple of the LiDAR's period."""
    caster: TerrainCaster | None = None
    """Share one between runs on the same scene; None: made here."""

    @property
    def extrinsics(self) -> Extrinsics:
        """LiDAR in base_link as simulated."""
        return self.mount or self.lidar.mount

    @property
    def sensor(self) -> Sensor:
        """The LiDAR as the elevation map takes it."""
        return Sensor.of(MountedLidar("main", self.lidar.name, self.extrinsics))

    def seconds(self, stamps: NDArray[np.integer] | int) -> Array:
        """Run time (n,) [s] of stamps [ns]."""
        return (np.atleast_1d(np.asarray(stamps, np.int64)) - self.start_stamp) / NS

    def truth(self, stamps: NDArray[np.integer] | int) -> tuple[Array, Array]:
        """True position (n, 3) [m] and orientation (n, 4) x, y, z, w of base_link in the world at stamps [ns]."""
        position, rotation = self.motion.pose(self.seconds(stamps))
        return position, quaternions(rotation)

    def path_length(self) -> float:
        """Planar distance driven [m]."""
        x, y, _ = self.motion.planar(np.linspace(0.0, self.duration, 20_000))
        return float(np.hypot(np.diff(x), np.diff(y)).sum())

    def samples(self) -> Iterator[Sample]:
        """ImuSample at 200 Hz, JointSample and GroundTruth at 50 Hz, LidarScan when its sweep is complete.

        In order of arrival: stamps ascend except that a scan carries the stamp of its first ray.
        """
        lidar = self._lidar()
        proprioception = _Proprioception(self.motion, self.noise, self.seed)
        ticks = round(self.duration * NS / TICK_PERIOD)
        for first in range(0, ticks + 1, CHUNK_TICKS):
            tick = np.arange(first, min(first + CHUNK_TICKS, ticks + 1))
            stamps = self.start_stamp + tick * TICK_PERIOD
            t = self.seconds(stamps)
            position, rotation = self.motion.pose(t)
            orientation = quaternions(rotation)
            linear, angular = self.motion.twist(t)
            gyro, accel = proprioception.imu(t, angular)
            joints = proprioception.joints(t[tick % 4 == 0], stamps[tick % 4 == 0])
            for i, stamp in enumerate(stamps.tolist()):
                yield ImuSample(stamp, gyro[i], accel[i])
                if tick[i] % 4 == 0:
                    yield next(joints)
                    yield GroundTruth(stamp, position[i], orientation[i], linear[i], angular[i])
                if self.obstacle is not None:
                    standing = t[i] < self.removed_at
                    lidar.set_boxes((*self.boxes, self.obstacle) if standing else self.boxes)
                scan = lidar.advance(stamp, position[i], orientation[i, [3, 0, 1, 2]])
                if scan is not None and not self._lost((scan.stamp - self.start_stamp) / NS):
                    yield scan

    def _lidar(self) -> LidarSimulator:
        caster = self.caster
        if caster is None:
            caster = self.scene.caster()
        simulator = LidarSimulator(self.lidar, self.extrinsics, caster, self.seed)
        simulator.set_boxes(self.boxes)
        return simulator

    def _lost(self, t: float) -> bool:
        return any(a <= t < b for a, b in self.gaps)


class _Proprioception:
    """IMU and joints with their errors; keeps the state of the random processes between chunks."""

    def __init__(self, motion: Motion, noise: SensorNoise, seed: int) -> None:
        self._motion = motion
        self._noise = noise
        streams = [np.random.default_rng([seed, k]) for k in range(3)]
        self._imu, self._encoder, self._ground = streams
        self._gyro_bias = noise.gyro_bias * self._imu.standard_normal(3)
        self._accel_bias = noise.accel_bias * self._imu.standard_normal(3)
        self._scale = 1.0 + noise.scale * self._ground.standard_normal(4)
        self._slip = np.zeros(4)
        self._wheel = np.zeros(4)
        self._last: float | None = None

    def imu(self, t: Array, angular: Array) -> tuple[Array, Array]:
        """Gyro (n, 3) [rad/s] and accelerometer (n, 3) [m/s^2]."""
        white = self._imu.standard_normal((len(t), 6))
        gyro = angular + self._gyro_bias + self._noise.gyro * white[:, :3]
        accel = self._motion.specific_force(t) + self._accel_bias + self._noise.accel * white[:, 3:]
        return gyro, accel

    def joints(self, t: Array, stamps: Array) -> Iterator[JointSample]:
        """Joint samples in order; each wheel carries a quarter of the weight."""
        state = legs(self._motion, t)
        rotation = self._motion.pose(t)[1]
        for i in range(len(t)):
            dt = 0.0 if self._last is None else float(t[i] - self._last)
            self._last = float(t[i])
            keep = np.exp(-dt / 0.3)
            self._slip = keep * self._slip + np.sqrt(
                1.0 - keep**2
            ) * self._noise.slip * self._ground.standard_normal(4)
            rolling = state.ground_speed[i] * self._scale
            spin = state.spin[i] + (rolling * (1.0 + self._slip) - state.ground_speed[i]) / WHEEL_RADIUS
            self._wheel = self._wheel + spin * dt
            white = self._encoder.standard_normal(28)
            load = rotation[i].T @ np.array([0.0, 0.0, 0.25 * ROBOT_MASS * GRAVITY])
            torque = -np.einsum("lai,a->li", wheel_jacobians(state.position[i]), load).reshape(12)
            yield JointSample(
                int(stamps[i]),
                np.concatenate([state.position[i] + self._noise.joint * white[:12], self._wheel]),
                np.concatenate([state.velocity[i], spin]) + self._noise.joint_rate * white[12:],
                np.concatenate([torque, np.zeros(4)]),
            )


def arena_run(
    lidar: str = "xt16", *, seed: int = 0, duration: float = 60.0, standstill: bool = False
) -> SyntheticRun:
    """The benchmark run."""
    motion = Motion(kind="standstill", start=(0.0, 0.0, 0.0)) if standstill else Motion()
    return SyntheticRun(arena(), motion, LIDARS[lidar], duration=duration, seed=seed)


def clearing_run(
    lidar: str = "xt16", *, removed_at: float = 10.0, duration: float = 20.0, seed: int = 0
) -> SyntheticRun:
    """The arena with `OBSTACLE` in it, taken away at `removed_at` [s]."""
    return SyntheticRun(
        arena(),
        Motion(),
        LIDARS[lidar],
        duration=duration,
        seed=seed,
        obstacle=OBSTACLE,
        removed_at=removed_at,
    )


def feature_run(feature: str, lidar: str = "xt16", *, distance: float = 2.0, seed: int = 0) -> SyntheticRun:
    """Drive up to a feature of `FEATURES` and rest with base_link `distance` [m] before its face."""
    scene, boxes = feature_scene(feature)
    x, y, yaw = scene.start
    speed, rest = 0.41, 1.0
    drive = (FEATURES[feature].face - distance - x) / speed
    motion = Motion(kind="straight", start=(x, y, yaw), speed=speed, rest=rest, stop=rest + drive)
    return SyntheticRun(scene, motion, LIDARS[lidar], duration=rest + drive + 2.0, seed=seed, boxes=boxes)


def soak_run(
    lidar: str = "xt16",
    *,
    minutes: float = 30.0,
    straight: bool = False,
    azimuth_step: int = 2,
    seed: int = 0,
) -> SyntheticRun:
    """A long run: rounds in the arena (a still scene), or `straight` down a corridor of new terrain."""
    spec = LIDARS[lidar].decimated(azimuth_step)
    duration = 60.0 * minutes
    if not straight:
        return SyntheticRun(arena(), Motion(), spec, duration=duration, seed=seed)
    motion = Motion(kind="straight")
    return SyntheticRun(corridor(motion.speed * duration, seed), motion, spec, duration=duration, seed=seed)
