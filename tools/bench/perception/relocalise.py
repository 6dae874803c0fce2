"""A robot that stands anywhere in a scene mapped before looks for itself: right, wrong and sure of it, ambiguous, and
how long it takes.

    python -m tools.bench perception --only relocalise --poses 100

The map is made on a tour through all places that the robot can reach, the errors of its poses included. Then boxes are
moved, and the robot stands at
random places with random headings. Truth judges, and nothing else uses it. open3d's FPFH and RANSAC get the same two
clouds.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.lidar.caster import OrientedBox, TerrainCaster
from hal.lidar.simulator import LidarSimulator
from hal.robots import describe
from hal.robots.go2w.facts import STAND, stand_height
from hal.rotation import quaternion, rotation_rpy, rpy_of, wrap
from hal.scenes import Scene, load_scene
from hal.types import Array
from mapping.elevation.map import ElevationMap
from mapping.elevation.sensor import Sensor
from mapping.relocalise import Place, PriorMap, Submap, Verdict, locate
from tools.bench.report import Report

SCENES = ("yard", "maze", "rescue_slopes", "rescue_platform", "rescue_steps")
WHEEL_PLACES = np.array([[0.25, 0.2], [0.25, -0.2], [-0.25, 0.2], [-0.25, -0.2]])
"""Under which the ground must carry [m]."""
UNDER = np.array([(a, b) for a in np.arange(-0.4, 0.41, 0.08) for b in np.arange(-0.26, 0.27, 0.04)])
"""The body and a little more [m]."""
BODY_ROOM = 0.2
"""Nothing beneath it may be higher than this [m]."""
MOST_UNEVEN, MOST_SLOPE, MOST_CLIMB = 0.03, math.radians(20.0), 0.15
"""[m], [rad], and [m] between neighbouring places."""
GRID_SPACING, TOUR_SPACING = 0.2, 1.0
"""Places that are tried, and places from which the map is made [m] apart."""
GROUND_A_BOX = 12.0
"""Of reachable ground there is a box on so many m^2. They stand elsewhere when the robot comes back."""
POSE_ERRORS = (0.01, math.radians(0.2))
"""Of the poses on the tour [m], [rad], and of the level in both [rad]."""
LOOK_SPACING = (1.0, 2.0)
"""From one look to the next [m]."""
MOST_LOOKS = 3
"""At most."""
SWEEP_COUNT = 3
"""Of each LiDAR at a place."""
CORRECT_WITHIN = (0.1, 2.0)
"""[m], [deg]"""
RIGHT_LIMIT, SECONDS_LIMIT = 0.95, 5.0
HEIGHT = stand_height(STAND)


@dataclass(slots=True)
class World:
    """A scene with its mapped state and the robot's way to look at it."""

    scene: Scene
    random: np.random.Generator
    places: list[tuple[float, float]] = field(default_factory=list)

    def stance(self, x: float, y: float, yaw: float) -> Array | None:
        """(4, 4) pose of base_link standing there; None where it cannot."""
        c, s = math.cos(yaw), math.sin(yaw)
        at = WHEEL_PLACES @ np.array([[c, s], [-s, c]]) + (x, y)
        if not all(self.scene.contains(*w) for w in at):
            return None
        z = np.array([self.scene.z(*w) for w in at])
        plane, *_ = np.linalg.lstsq(np.column_stack([WHEEL_PLACES, np.ones(4)]), z, rcond=None)
        under = UNDER @ np.array([[c, s], [-s, c]]) + (x, y)
        tops = [self.scene.z(*w) - plane @ (*u, 1.0) for u, w in zip(UNDER, under, strict=True)]
        flat = np.abs(np.column_stack([WHEEL_PLACES, np.ones(4)]) @ plane - z).max() < MOST_UNEVEN
        if not flat or math.hypot(*plane[:2]) > math.tan(MOST_SLOPE) or max(tops) > BODY_ROOM:
            return None
        pose = np.eye(4)
        pose[:3, :3] = rotation_rpy(math.atan(plane[1]), -math.atan(plane[0]), yaw)
        pose[:3, 3] = (x, y, plane[2]) + HEIGHT * pose[:3, 2]
        return pose

    def explore(self) -> None:
        """All places that can be reached from the start."""
        seen: dict[tuple[int, int], float] = {}
        x0, y0, _ = self.scene.start
        queue = [(0, 0)]
        while queue:
            i, j = queue.pop()
            if (i, j) in seen:
                continue
            x, y = x0 + i * GRID_SPACING, y0 + j * GRID_SPACING
            if not self.scene.contains(x, y) or not any(
                self.stance(x, y, yaw) is not None for yaw in (0.0, 0.8, 1.6, 2.4)
            ):
                continue
            z = seen[i, j] = self.scene.z(x, y)
            self.places.append((x, y))
            for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                near = x0 + a * GRID_SPACING, y0 + b * GRID_SPACING
                if (
                    (a, b) not in seen
                    and self.scene.contains(*near)
                    and abs(self.scene.z(*near) - z) < MOST_CLIMB
                ):
                    queue.append((a, b))

    def anywhere(self, boxes: tuple[OrientedBox, ...], near: Array | None = None) -> Array:
        """A random pose off the boxes; `near` a pose: where the robot comes from there by `LOOK_SPACING`."""
        places = self.places
        if near is not None:
            places = [p for p in places if LOOK_SPACING[0] < math.dist(p, near[:2, 3]) < LOOK_SPACING[1]]
        for _ in range(10_000):
            x, y = places[int(self.random.integers(len(places)))]
            x, y = x + self.random.uniform(-0.1, 0.1), y + self.random.uniform(-0.1, 0.1)
            pose = self.stance(x, y, self.random.uniform(-math.pi, math.pi))
            if pose is not None and all(math.dist((x, y), box.centre[:2]) > 0.9 for box in boxes):
                return pose
        raise ValueError(f"{self.scene.name}: no place to stand")

    def boxes(self) -> tuple[OrientedBox, ...]:
        """Boxes at random places."""
        out = []
        for _ in range(max(2, round(len(self.places) * GRID_SPACING**2 / GROUND_A_BOX))):
            x, y = self.places[int(self.random.integers(len(self.places)))]
            size = self.random.uniform(0.3, 0.7, 3)
            z = self.scene.z(x, y) + 0.5 * size[2]
            out.append(OrientedBox((x, y, z), (size[0], size[1], size[2]), self.random.uniform(0.0, 3.0)))
        return tuple(out)

    def tour(self) -> list[Array]:
        """Poses about `TOUR_SPACING` apart that cover all places."""
        chosen: list[Array] = []
        for x, y in self.places:
            if all(math.dist((x, y), pose[:2, 3]) > TOUR_SPACING for pose in chosen):
                yaws = self.random.uniform(-math.pi, math.pi, 8)
                standing = (self.stance(x, y, yaw) for yaw in yaws)
                chosen += [pose for pose in standing if pose is not None][:1]
        return chosen


class Eyes:
    """Both LiDARs of the robot."""

    def __init__(self, caster: TerrainCaster, seed: int) -> None:
        self.lidars = [lidar.mounted() for lidar in describe().lidars]
        self._sims = [
            LidarSimulator(lidar.spec, m.mount, caster, seed, name=m.name)
            for lidar, m in zip(describe().lidars, self.lidars, strict=True)
        ]
        self._now = 1_000_000_000

    def look(self, pose: Array, boxes: tuple[OrientedBox, ...]) -> list[tuple[Sensor, NDArray[np.float32]]]:
        """Points (n, 3) in base_link of one sweep of each, standing at `pose` (4, 4)."""
        self._now += 200_000_000
        w = quaternion(pose[:3, :3])[[3, 0, 1, 2]]
        out = []
        for lidar, sim in zip(self.lidars, self._sims, strict=True):
            sim.set_boxes(boxes)
            sim._last = sim._sweep = None
            sim.advance(self._now, pose[:3, 3], w)
            scan = sim.advance(self._now + 100_000_000, pose[:3, 3], w)
            assert scan is not None
            xyz = np.column_stack([scan.points[a] for a in "xyz"]).astype(np.float64)
            turned = rotation_rpy(*lidar.mount.rpy)
            points = (xyz @ turned.T + lidar.mount.translation).astype(np.float32)
            out.append((Sensor.of(lidar), points))
        return out


def off(pose: Array, random: np.random.Generator, place: float, angle: float) -> Array:
    """A pose with errors of its place [m] and of its three angles [rad]."""
    out = pose.copy()
    out[:3, :3] = rotation_rpy(*(angle * random.standard_normal(3))) @ pose[:3, :3]
    out[:3, 3] += place * random.standard_normal(3)
    return out


def survey(world: World, eyes: Eyes, boxes: tuple[OrientedBox, ...]) -> ElevationMap:
    """The map of a tour."""
    made = ElevationMap()
    for k, pose in enumerate(world.tour()):
        held = off(pose, world.random, *POSE_ERRORS)
        for n in range(SWEEP_COUNT):
            for sensor, points in eyes.look(pose, boxes):
                stamp = 10**9 * (2 * k + 1) + n * 10**8
                made.fuse(points, held[:3, 3], quaternion(held[:3, :3]), stamp, sensor)
                made.clean()
                if n == 0:
                    made.cloud.add(points, held[:3, :3], held[:3, 3])
    return made


def look(world: World, eyes: Eyes, submap: Submap, pose: Array, boxes: tuple[OrientedBox, ...]) -> None:
    """What the robot sees standing at `pose` (4, 4), in its `odom`: elsewhere and turned, its errors those of odometry
    over a few metres."""
    odom = np.eye(4)
    odom[:3, :3] = rotation_rpy(0.0, 0.0, 0.3)
    odom[:3, 3] = 2.0, -1.0, 0.1
    held = odom @ off(pose, world.random, *POSE_ERRORS)
    submap.stand()
    for _ in range(SWEEP_COUNT):
        for sensor, points in eyes.look(pose, boxes):
            submap.add(points, held[:3, 3], quaternion(held[:3, :3]), sensor.origin, HEIGHT)


def fpfh(cloud: NDArray[np.float64], submap: NDArray[np.float64]) -> Array:
    """(4, 4) `map` <- submap by open3d's FPFH and RANSAC, then ICP point to plane, with the settings of its tutorial
    for voxels of 0.25 m."""
    import open3d

    open3d.utility.random.seed(0)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    p: Any = open3d.pipelines.registration  # its stubs are of another version
    voxel = 0.25
    clouds, features = [], []
    for points in (submap, cloud):
        pcd = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)).voxel_down_sample(voxel)
        pcd.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel, max_nn=30))
        near = open3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel, max_nn=100)
        clouds.append(pcd)
        features.append(p.compute_fpfh_feature(pcd, near))
    found = p.registration_ransac_based_on_feature_matching(
        *clouds, *features, True, 1.5 * voxel, p.TransformationEstimationPointToPoint(False), 3,
        [p.CorrespondenceCheckerBasedOnEdgeLength(0.9), p.CorrespondenceCheckerBasedOnDistance(1.5 * voxel)],
        p.RANSACConvergenceCriteria(100_000, 0.999),
    )  # fmt: skip
    exact = p.registration_icp(
        *clouds, 0.4 * voxel, found.transformation, p.TransformationEstimationPointToPlane()
    )
    return np.asarray(exact.transformation)


@dataclass(slots=True)
class Tally:
    """What became of the poses."""

    right: list[int] = field(default_factory=list)
    """Looks that were needed."""
    wrong: int = 0
    """Sure of a place that is not the robot's."""
    unsure: int = 0
    """Still ambiguous."""
    lost: int = 0
    """Not found, or ambiguous without the robot's place."""
    seconds: list[float] = field(default_factory=list)
    """CPU of each search [s]."""
    errors: list[tuple[float, float]] = field(default_factory=list)
    """Of the right ones [m], [deg]."""
    fpfh_right: int = 0
    fpfh_seconds: list[float] = field(default_factory=list)

    @property
    def poses(self) -> int:
        """Tried."""
        return len(self.right) + self.wrong + self.unsure + self.lost

    def take(self, verdict: Verdict, pose: Array, looks: int) -> None:
        """Judge the last answer."""
        hits = [_off(c.place, pose) for c in verdict.candidates]
        hit = [x < CORRECT_WITHIN[0] and turn < CORRECT_WITHIN[1] for x, turn in hits]
        if verdict.answer == "located" and hit[0]:
            self.right.append(looks)
            self.errors.append(hits[0])
        elif verdict.answer == "located":
            self.wrong += 1
        elif verdict.answer == "ambiguous" and any(hit):
            self.unsure += 1
        else:
            self.lost += 1


def _off(place: Place, pose: Array) -> tuple[float, float]:
    """Distance [m] and turn [deg] between an answer and where the robot stands."""
    turn = abs(wrap(place.yaw - rpy_of(pose[:3, :3])[2]))
    return math.dist((place.x, place.y), pose[:2, 3]), math.degrees(turn)


def drive(name: str, poses: int, seed: int) -> Tally:
    """One scene."""
    world = World(load_scene(name), np.random.default_rng([seed, *name.encode()]))
    world.explore()
    eyes = Eyes(world.scene.caster(), seed)
    made = survey(world, eyes, world.boxes())
    cloud, ground = made.cloud.points, made.grid()
    prior = PriorMap(cloud, [ground])
    locate(prior, Submap())
    tally = Tally()
    for _ in range(poses):
        boxes = world.boxes()
        pose, submap = world.anywhere(boxes), Submap()
        verdict = Verdict("not_found")
        looks = 0
        for looks in range(1, MOST_LOOKS + 1):
            look(world, eyes, submap, pose, boxes)
            if looks == 1:
                begin = time.process_time()
                found = fpfh(cloud.astype(np.float64), submap.cloud()[0])
                tally.fpfh_seconds.append(time.process_time() - begin)
                yaw = math.atan2(found[1, 0], found[0, 0])
                x, turn = _off(Place(found[0, 3], found[1, 3], found[2, 3], yaw, 0.0), pose)
                tally.fpfh_right += x < CORRECT_WITHIN[0] and turn < CORRECT_WITHIN[1]
            begin = time.process_time()
            verdict = locate(prior, submap)
            tally.seconds.append(time.process_time() - begin)
            if verdict.answer == "located" or looks == MOST_LOOKS:
                break
            pose = world.anywhere(boxes, near=pose)
        tally.take(verdict, pose, looks)
    return tally


def rows(report: Report, poses: int, seed: int) -> None:
    """Rows `relocalise.*`: rates over all scenes, and for each scene."""
    every: list[Tally] = []
    for k, name in enumerate(SCENES):
        tally = drive(name, poses // len(SCENES) + (k < poses % len(SCENES)), seed)
        every.append(tally)
        report.rate(f"relocalise.right.{name}", len(tally.right), tally.poses)
        report.rate(f"relocalise.one_look.{name}", tally.right.count(1), tally.poses)
        report.rate(f"relocalise.fpfh_right.{name}", tally.fpfh_right, tally.poses)
    n = sum(tally.poses for tally in every)
    report.rate("relocalise.right", sum(len(tally.right) for tally in every), n, RIGHT_LIMIT)
    report.rate("relocalise.one_look", sum(tally.right.count(1) for tally in every), n)
    report.rate("relocalise.wrong", sum(tally.wrong for tally in every), n, 0.0, at_least=False)
    report.rate("relocalise.ambiguous", sum(tally.unsure for tally in every), n, at_least=False)
    report.rate("relocalise.not_found", sum(tally.lost for tally in every), n, at_least=False)
    report.rate("relocalise.fpfh_right", sum(tally.fpfh_right for tally in every), n)
    errors = np.array([e for tally in every for e in tally.errors] or [(math.nan, math.nan)])
    report.add("relocalise.error_mm", 1000.0 * float(np.median(errors[:, 0])), "mm")
    report.add("relocalise.error_deg", float(np.median(errors[:, 1])), "deg")
    report.add(
        "relocalise.worst_s",
        max(s for tally in every for s in tally.seconds),
        "s",
        SECONDS_LIMIT,
        max(s for tally in every for s in tally.fpfh_seconds),
    )
