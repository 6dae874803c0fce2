"""Drives for maps that close: a scene, a way through it, what the LiDARs see on it, and an odometry that drifts. No physics, no stack."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.go2w import STAND, stand_height
from hal.rotation import rotation_rpy
from hal.scenes import Scene
from hal.scenes.canvas import Canvas
from hal.types import NS, Array
from mapping.closing.recording import Recording
from mapping.elevation.sensor import Sensor
from tools.bench.perception.relocalise import WHEELS, Eyes

HEIGHT = stand_height(STAND)
SPEED = 1.0
"""[m/s]"""
Way = Sequence[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Drift:
    """Errors of an odometry, standard deviations; each drive draws its own. 1.5 times what was measured in 70 m of new corridor, and slip."""

    scale: float = 0.003
    """Of all lengths."""
    bend: float = math.radians(0.003)
    """Heading by the metre [rad/m]."""
    climb: float = 0.0015
    """Height by the metre."""
    walk: tuple[float, float, float, float] = (0.01, 0.01, 0.01, math.radians(0.03))
    """x, y, z [m], yaw [rad] by the root of a metre."""
    tilt: float = math.radians(0.15)
    """Of the level [rad]: an accelerometer's bias."""


def way_through(scene: Scene, corners: Way, step: float = 0.25, turning: float = math.radians(12.0)) -> Array:
    """(n, 4, 4) poses of base_link along straight lines between corners, `step` [m] apart, turning on the spot by `turning` [rad] at a time,
    standing on the ground of the scene."""
    poses = []
    heading = None
    for (ax, ay), (bx, by) in itertools.pairwise(corners):
        yaw = math.atan2(by - ay, bx - ax)
        if heading is not None:
            turn = math.remainder(yaw - heading, 2.0 * math.pi)
            n = math.ceil(abs(turn) / turning)
            poses += [_stance(scene, ax, ay, heading + turn * k / n) for k in range(1, n)]
        n = max(1, round(math.dist((ax, ay), (bx, by)) / step))
        poses += [_stance(scene, ax + (bx - ax) * k / n, ay + (by - ay) * k / n, yaw) for k in range(n)]
        heading = yaw
    return np.array(poses)


def _stance(scene: Scene, x: float, y: float, yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    at = WHEELS @ np.array([[c, s], [-s, c]]) + (x, y)
    z = np.array([scene.z(*w) for w in at])
    plane, *_ = np.linalg.lstsq(np.column_stack([WHEELS, np.ones(4)]), z, rcond=None)
    pose = np.eye(4)
    pose[:3, :3] = rotation_rpy(math.atan(plane[1]), -math.atan(plane[0]), yaw)
    pose[:3, 3] = (x, y, plane[2]) + HEIGHT * pose[:3, 2]
    return pose


def drifted(truth: Array, drift: Drift, seed: int) -> Array:
    """(n, 4, 4) what an odometry says of true poses (n, 4, 4): it begins at the ground under the first one, x ahead."""
    rng = np.random.default_rng(seed)
    scale, bend, climb = rng.standard_normal(3) * (drift.scale, drift.bend, drift.climb)
    roll, pitch = drift.tilt * rng.standard_normal(2)
    tilt = rotation_rpy(roll, pitch, 0.0)
    yaw = np.arctan2(truth[:, 1, 0], truth[:, 0, 0])
    out = np.empty_like(truth)
    place, turn = np.array([0.0, 0.0, HEIGHT]), -yaw[0]
    for k, pose in enumerate(truth):
        if k:
            moved = pose[:3, 3] - truth[k - 1, :3, 3]
            far = float(np.hypot(*moved[:2]))
            noise = rng.standard_normal(4) * drift.walk * math.sqrt(far)
            place = place + rotation_rpy(0.0, 0.0, turn) @ (moved * (1.0 + scale)) + noise[:3]
            place[2] += climb * far
            turn += bend * far + noise[3]
        out[k] = np.eye(4)
        out[k, :3, :3] = tilt @ rotation_rpy(0.0, 0.0, turn) @ pose[:3, :3]
        out[k, :3, 3] = place
    return out


@dataclass(slots=True)
class Drive:
    """One run: what there is, what the odometry says."""

    scene: Scene
    truth: Array
    """(n, 4, 4)"""
    odometry: Array
    """(n, 4, 4)"""
    seed: int = 0
    eyes: Eyes = field(init=False)

    def __post_init__(self) -> None:
        self.eyes = Eyes(self.scene.caster(), self.seed)

    def sweeps(self) -> Iterator[tuple[int, Array, list[tuple[Sensor, NDArray[np.float32]]]]]:
        """Stamp [ns], pose by odometry (4, 4), what each LiDAR sees there in base_link."""
        stamp = 10 * NS
        for k, (there, said) in enumerate(zip(self.truth, self.odometry, strict=True)):
            if k:
                stamp += max(NS // 10, round(math.dist(there[:3, 3], self.truth[k - 1, :3, 3]) / SPEED * NS))
            yield stamp, said, self.eyes.look(there, ())


def record(recording: Recording, run: int, drive: Drive) -> None:
    """Put a drive into a recording."""
    for stamp, pose, clouds in drive.sweeps():
        recording.add(run, stamp, pose, clouds, HEIGHT, np.empty((0, 3)))


def ring(half: tuple[float, float] = (10.0, 7.0), seed: int = 0) -> tuple[Scene, Way]:
    """A corridor of 3 m round a block of twice `half` [m], with crates and pillars along its walls, and the corners of one and a quarter rounds."""
    a, b = half
    canvas = Canvas((-a - 3.0, a + 3.0, -b - 3.0, b + 3.0), 0.05)
    canvas.border(0.2, 2.0)
    canvas.box((-a, a, -b, b), 2.0)
    rng = np.random.default_rng(seed)
    for x0, x1, y0, y1 in (
        (-a - 2, a + 2, -b - 3, -b),
        (-a - 2, a + 2, b, b + 3),
        (-a - 3, -a, -b - 2, b + 2),
        (a, a + 3, -b - 2, b + 2),
    ):
        clutter(canvas, (x0, x1, y0, y1), rng, 0.4)
    x, y = a + 1.5, b + 1.5
    corners = [(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y), (x, -y), (x, -0.3 * y)]
    return _scene("ring", canvas, corners), corners


def clutter(
    canvas: Canvas, rect: tuple[float, float, float, float], rng: np.random.Generator, density: float
) -> None:
    """Crates and pillars along both long sides of a corridor x0, x1, y0, y1 [m], `density` of them a metre."""
    x0, x1, y0, y1 = rect
    long_x = x1 - x0 > y1 - y0
    for _ in range(round(density * max(x1 - x0, y1 - y0))):
        size = rng.uniform(0.2, 0.6, 2)
        across = rng.choice((0.08, 0.92)) + rng.uniform(-0.03, 0.03)
        if long_x:
            centre = rng.uniform(x0, x1), y0 + across * (y1 - y0)
        else:
            centre = x0 + across * (x1 - x0), rng.uniform(y0, y1)
        canvas.block(centre, (size[0], size[1]), rng.uniform(0.0, 1.5), rng.uniform(0.4, 1.8))


def twins() -> tuple[Scene, Way]:
    """Two corridors of 24 x 3 m, 9 m apart, that look the same to the last crate, and a way through one and, the same way, through the other."""
    canvas = Canvas((-15.0, 15.0, -4.5, 13.5), 0.05)
    canvas.border(0.2, 2.0)
    for y in (0.0, 9.0):
        for side in (-1.6, 1.6):
            canvas.bar((-12.0, y + side), (12.0, y + side), 0.2, 2.0)
        clutter(canvas, (-12.0, 12.0, y - 1.5, y + 1.5), np.random.default_rng(0), 0.7)
    corners = [(-13.5, 0.0), (13.5, 0.0), (13.5, 4.5), (-13.5, 4.5), (-13.5, 9.0), (13.5, 9.0)]
    return _scene("twins", canvas, corners), corners


def _scene(name: str, canvas: Canvas, corners: Way) -> Scene:
    return Scene(name, canvas.array(), canvas.resolution, canvas.origin, (*corners[0], 0.0), {})
