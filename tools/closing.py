"""Drives for maps that close: a scene, a way through it, what the LiDARs see on it, and an odometry that drifts. No
physics, no stack."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hal.robots.go2w.facts import STAND, stand_height
from hal.rotation import quaternion, rotation_rpy
from hal.scenes import Scene
from hal.scenes.canvas import Canvas
from hal.types import NS, Array
from mapping.closing.graph import levelled
from mapping.closing.recording import Recording
from mapping.elevation.sensor import Sensor
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import BASE, MAP, ODOM, cloud_msg, odometry_msg, rpy_quaternion, transform_msg
from rbtrg_robot.wire.messages import encode
from tools.bench.perception.relocalise import WHEEL_PLACES, Eyes

HEIGHT = stand_height(STAND)
DRIVE_SPEED = 1.0
"""[m/s]"""
Way = Sequence[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Drift:
    """Errors of an odometry, standard deviations; each drive draws its own. About 1.5 times those of the stack's
    odometry in 70 m of new corridor: it bent by 0.0023 deg a metre with 0.007 deg by the root of a metre, and lost 0.2
    mm of height a metre. Lengths: of tyres that slip.
    """

    scale: float = 0.001
    """Of all lengths."""
    bend: float = math.radians(0.0035)
    """Heading by the metre [rad/m]."""
    climb: float = 0.0005
    """Height by the metre."""
    walk: tuple[float, float, float, float] = (0.005, 0.005, 0.005, math.radians(0.01))
    """x, y, z [m], yaw [rad] by the root of a metre."""
    tilt: float = math.radians(0.15)
    """Of the level [rad]: an accelerometer's bias."""

    def times(self, much: float) -> Drift:
        """So many times more of all but the tilt."""
        x, y, z, yaw = self.walk
        walk = much * x, much * y, much * z, much * yaw
        return Drift(much * self.scale, much * self.bend, much * self.climb, walk, self.tilt)


def way_through(scene: Scene, corners: Way, step: float = 0.25, turning: float = math.radians(12.0)) -> Array:
    """(n, 4, 4) poses of base_link along straight lines between corners, `step` [m] apart, turning on the spot by
    `turning` [rad] at a time, standing on the ground of the scene."""
    poses = []
    heading = None
    for (ax, ay), (bx, by) in pairwise(corners):
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
    at = WHEEL_PLACES @ np.array([[c, s], [-s, c]]) + (x, y)
    z = np.array([scene.z(*w) for w in at])
    plane, *_ = np.linalg.lstsq(np.column_stack([WHEEL_PLACES, np.ones(4)]), z, rcond=None)
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
                stamp += max(
                    NS // 10, round(math.dist(there[:3, 3], self.truth[k - 1, :3, 3]) / DRIVE_SPEED * NS)
                )
            yield stamp, said, self.eyes.look(there, ())


def record(recording: Recording, run: int, drive: Drive, then: Callable[[], None] = lambda: None) -> None:
    """Put a drive into a recording; `then` is called after each scan."""
    for stamp, pose, clouds in drive.sweeps():
        recording.add(run, stamp, pose, clouds, HEIGHT, np.empty((0, 3)))
        then()


def write_log(path: Path, drive: Drive, sets: Sequence[str] = ()) -> None:
    """A drive as a run's log: poses, deskewed clouds, where the robot started."""
    config = load(None, sets, scene="flat")
    x, y, _, yaw = levelled(drive.truth[0])
    with LogWriter(path, {}, {CONFIG: config.to_yaml().encode()}) as log:

        def write(topic: Topic, message: msg.Message, stamp: int) -> None:
            log.write(topic, encode(message), stamp, stamp)

        frame = transform_msg(0, MAP, ODOM, (x, y, 0.0), rpy_quaternion((0.0, 0.0, yaw)))
        write(t.TF_STATIC, msg.TFMessage(transforms=[frame]), 10 * NS)
        for stamp, pose, clouds in drive.sweeps():
            for lidar, (_, points) in zip(drive.eyes.lidars, clouds, strict=True):
                write(t.CLOUDS[lidar.name], cloud_msg(stamp, BASE, points), stamp)
            turned = quaternion(pose[:3, :3])
            write(t.ODOM, odometry_msg(stamp, pose[:3, 3], turned, np.zeros(3), np.zeros(3)), stamp)


def ring(half: tuple[float, float] = (10.0, 7.0), seed: int = 0) -> tuple[Scene, Way]:
    """A corridor of 3 m round a block of twice `half` [m], with crates and pillars along its walls, and the corners of
    one and a quarter rounds."""
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


def twins(apart: float = 9.0, seed: int = 0) -> tuple[Scene, Way]:
    """Two corridors of 24 x 3 m, `apart` [m], that look the same to the last crate, and a way through one, through the
    other, and through the first again."""
    canvas = Canvas((-15.0, 15.0, -4.5, apart + 4.5), 0.05)
    canvas.border(0.2, 2.0)
    for y in (0.0, apart):
        for side in (-1.6, 1.6):
            canvas.bar((-12.0, y + side), (12.0, y + side), 0.2, 2.0)
        clutter(canvas, (-12.0, 12.0, y - 1.5, y + 1.5), np.random.default_rng(seed), 0.7)
    out = apart + 3.2
    corners = [
        (-13.5, 0.0),
        (13.5, 0.0),
        (13.5, out),
        (-13.5, out),
        (-13.5, apart),
        (13.5, apart),
        (13.5, 0.0),
        (-8.0, 0.0),
    ]
    return _scene("twins", canvas, corners), corners


def site(scale: float = 1.0, seed: int = 0) -> tuple[Scene, Way]:
    """150 x 150 m times `scale`: a way round the outside, over a hill in one corner, into a house of four corridors
    that look the same, and out again along ways that were driven before; 1.2 km.
    """
    half = 75.0 * scale
    canvas = Canvas((-half, half, -half, half), 0.1)
    canvas.border(0.3, 2.5)
    rng = np.random.default_rng(seed)
    edge, deep, hall = 65.0 * scale, 20.0 * scale, 6.0
    places = [-1.5 * hall, -0.5 * hall, 0.5 * hall, 1.5 * hall]
    for x in places:
        for side in (-1.6, 1.6):
            canvas.bar((x + side, -deep), (x + side, deep), 0.3, 2.5)
        clutter(canvas, (x - 1.5, x + 1.5, -deep, deep), np.random.default_rng(seed + 1), 0.5)
    out = deep + 3.0
    near = 2.5 * hall
    corners = [
        *((-edge, -edge), (edge, -edge), (edge, edge), (-edge, edge), (-edge, -edge)),
        *(
            (-near, -edge),
            (-near, -out),
            (places[0], -out),
            (places[0], out),
            (places[1], out),
            (places[1], -out),
        ),
        *(
            (places[2], -out),
            (places[2], out),
            (places[3], out),
            (places[3], -out),
            (near, -out),
            (near, -edge),
        ),
        *(
            (edge, -edge),
            (edge, 0.0),
            (near, 0.0),
            (near, out),
            (places[2], out),
            (places[2], -out),
            (places[1], -out),
        ),
        *(
            (places[1], out),
            (places[0], out),
            (-near, out),
            (-near, edge),
            (-edge, edge),
            (-edge, 0.5 * edge),
        ),
    ]
    lengths = np.array([math.dist(a, b) for a, b in pairwise(corners)])
    for _ in range(round(0.5 * lengths.sum())):  # walls and crates beside the way
        k = int(rng.choice(len(lengths), p=lengths / lengths.sum()))
        (ax, ay), (bx, by) = corners[k], corners[k + 1]
        share, aside = rng.uniform(), rng.choice((-1.0, 1.0)) * rng.uniform(2.2, 7.0)
        x = ax + share * (bx - ax) - aside * (by - ay) / lengths[k]
        y = ay + share * (by - ay) + aside * (bx - ax) / lengths[k]
        size = rng.uniform(0.3, 3.0), rng.uniform(0.2, 0.8)
        clear = min(_from_line((x, y), a, b) for a, b in pairwise(corners)) > 0.5 * math.hypot(*size) + 0.8
        if clear and not (abs(x) < near and abs(y) < out + 1.5):
            canvas.block((x, y), size, rng.uniform(0.0, 3.1), rng.uniform(0.5, 2.5))
    hill = 4.0 * np.exp(-((canvas.x - edge) ** 2 + (canvas.y - edge) ** 2) / (2.0 * (14.0 * scale) ** 2))
    canvas.height += hill
    return _scene("site", canvas, corners), corners


def _from_line(p: tuple[float, float], a: tuple[float, float], b: tuple[float, float]) -> float:
    """Distance of a point from a piece of a line [m]."""
    way = np.subtract(b, a)
    share = float(np.clip(np.dot(np.subtract(p, a), way) / (way @ way), 0.0, 1.0))
    return float(np.hypot(*(np.subtract(p, a) - share * way)))


def _scene(name: str, canvas: Canvas, corners: Way) -> Scene:
    return Scene(name, canvas.array(), canvas.resolution, canvas.origin, (*corners[0], 0.0), {})
