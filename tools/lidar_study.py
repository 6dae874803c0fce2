"""Which LiDAR gives the best map ahead of a Go2-W? Odometry and elevation map on synthetic runs, compared with the
truth.

    python -m tools.lidar_study [--seconds 30] [--png docs/images/lidar.png]

For every LiDAR the robot drives down a corridor it has not seen, once with a level trunk and once pitching by +-10 deg.
Twice a second the strip it will drive over (0.4 to 4 m ahead of base_link, 0.8 m wide) is read from the map as the
planner sees it: relative to the estimated pose. Reported per distance: share of trusted cells, and the RMS height
error of trusted cells on even ground.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from hal.lidar.spec import LIDARS, LidarSpec
from hal.robots.go2w.facts import WHEEL_RADIUS, wheel_centres
from hal.rotation import rotation
from hal.scenes import Scene
from hal.scenes.survey import relief
from hal.types import Array, Extrinsics, GroundTruth, JointSample, Sample
from mapping.elevation.map import ElevationMap
from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import OdometryConfig, ScanOdometry
from rbtrg_robot.stage_config import ElevationStageConfig
from tools.bench.perception.odometry import take
from tools.synthetic import SyntheticRun
from tools.synthetic_motion import Motion
from tools.synthetic_scenes import FEATURES, corridor, feature_scene

BIN_EDGES = np.array([0.4, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0])
"""Distance ahead of base_link [m]."""
SAMPLE_SPACING = 0.04
CLEAN_EVERY = ElevationStageConfig().clean_every
LEVEL = Motion(kind="straight", pitch=radians(1.0), roll=radians(1.0), bob=0.003)
SHAKEN = Motion(kind="straight")
MID360_LEVEL = Extrinsics((0.16, 0.0, 0.13))
CANDIDATES: dict[str, tuple[LidarSpec, Extrinsics | None]] = {
    "xt16": (LIDARS["xt16"], None),
    "xt16, every 2nd azimuth": (LIDARS["xt16"].decimated(2), None),
    "mid360, pitched 20 deg": (LIDARS["mid360"], None),
    "mid360, level": (LIDARS["mid360"], MID360_LEVEL),
    "l1": (LIDARS["l1"], None),
}


@dataclass(slots=True)
class Score:
    """Quality of the map on one run."""

    trusted: Array
    """(bins,) share of trusted cells."""
    rmse: Array
    """(bins,) [m] on even ground; NaN where less than 50 such cells were trusted."""
    odometry: float
    """RMS translation error over 1 s [m]."""
    cpu: float
    """Odometry and fusion per scan [s]."""


class Stack:
    """Odometry and map as the robot runs them."""

    def __init__(self, run: SyntheticRun, engine: str) -> None:
        params = OdometryConfig().model_copy(update={"engine": engine})
        self.odometry = LidarInertialOdometry(params, {"main": run.extrinsics})
        self.odometry.warm_up()
        self.map = ElevationMap()
        self.map.warm_up()
        self._sensor = run.sensor
        self._joints: JointSample | None = None
        self.cpu: list[float] = []

    def feed(self, sample: Sample) -> list[ScanOdometry]:
        """Take one sample; the scans finished by it, already in the map."""
        begin = time.thread_time()
        if isinstance(sample, JointSample):
            self._joints = sample
        results = [r for r in take(self.odometry, sample) if len(r.cloud)]
        for r in results:
            self.map.fuse(r.cloud, r.position, r.orientation, r.stamp, self._sensor)
            if self._joints is not None:
                below = wheel_centres(self._joints.position) - np.array([0.0, 0.0, WHEEL_RADIUS])
                self.map.fuse_ground(below, r.position, r.orientation, r.stamp)
            if self.map.scans % CLEAN_EVERY == 0:
                self.map.clean()
            self.cpu.append(time.thread_time() - begin)
        return results


def heights(scene: Scene, x: Array, y: Array) -> Array:
    """True height [m] at each x, y: the cell that holds it."""
    rows, cols = scene.height.shape
    c = np.clip(np.round((x - scene.origin[0]) / scene.resolution).astype(int), 0, cols - 1)
    r = np.clip(np.round((y - scene.origin[1]) / scene.resolution).astype(int), 0, rows - 1)
    return scene.height[r, c].astype(np.float64)


def study(run: SyntheticRun, engine: str = "kiss_icp") -> Score:
    """Drive `run` and score the strip ahead."""
    stack = Stack(run, engine)
    uneven = replace(run.scene, height=relief(run.scene.height, 2), survey=None)
    ahead, side = np.meshgrid(
        np.arange(BIN_EDGES[0], BIN_EDGES[-1], SAMPLE_SPACING), np.arange(-0.4, 0.41, SAMPLE_SPACING)
    )
    count, trusted, squares, flat = (np.zeros(len(BIN_EDGES) - 1) for _ in range(4))
    track: list[tuple[int, Array]] = []
    seen = 0
    for sample in run.samples():
        if isinstance(sample, GroundTruth):
            continue
        for r in stack.feed(sample):
            track.append((r.stamp, r.position))
            seen += 1
            if seen < 50 or seen % 5:
                continue
            position, orientation = (v[0] for v in run.truth(r.stamp))
            x, y = _turned(orientation, position, ahead, side)
            mx, my = _turned(r.orientation, r.position, ahead, side)
            patch = stack.map.window(float(r.position[0]), float(r.position[1]), 4.5)
            row = np.round((my - patch.origin[1]) / patch.resolution).astype(int)
            col = np.round((mx - patch.origin[0]) / patch.resolution).astype(int)
            known = patch.layers["trusted"][row, col] > 0.5
            error = (
                patch.layers["elevation"][row, col] - r.position[2] - (heights(run.scene, x, y) - position[2])
            )
            even = known & (heights(uneven, x, y) < 0.01)
            bins = np.digitize(ahead, BIN_EDGES) - 1
            for k in range(len(count)):
                here = bins == k
                count[k] += here.sum()
                trusted[k] += (known & here).sum()
                squares[k] += np.square(error[even & here]).sum()
                flat[k] += (even & here).sum()
    return Score(
        trusted / count,
        np.sqrt(squares / np.where(flat > 50, flat, np.nan)),
        _drift(run, track),
        float(np.median(stack.cpu)),
    )


def _turned(q: Array, p: Array, ahead: Array, side: Array) -> tuple[Array, Array]:
    """x, y of points ahead and left of a pose, on the level."""
    r = rotation(np.asarray(q, np.float64))
    yaw = np.arctan2(r[1, 0], r[0, 0])
    return p[0] + np.cos(yaw) * ahead - np.sin(yaw) * side, p[1] + np.sin(yaw) * ahead + np.cos(yaw) * side


def _drift(run: SyntheticRun, track: list[tuple[int, Array]]) -> float:
    """RMS error of the distance moved within 1 s [m]."""
    stamps = np.array([s for s, _ in track])
    got = np.array([p for _, p in track])
    want, _ = run.truth(stamps)
    error = np.linalg.norm(got[10:] - got[:-10], axis=1) - np.linalg.norm(want[10:] - want[:-10], axis=1)
    return float(np.sqrt((error**2).mean()))


def seen_features(spec: LidarSpec, mount: Extrinsics | None) -> dict[str, float]:
    """Share of each feature's cells whose height in the map is right within 0.04 m, 2 m ahead of the robot.

    For the pole: 1 when a trusted cell stands there at least 0.2 m high. For the pit, whose floor cannot be seen from
    there: the share of its cells that are not taken for ground.
    """
    shares = {}
    for name, feature in FEATURES.items():
        scene, boxes = feature_scene(name)
        x, y, yaw = scene.start
        drive = (feature.face - 2.0 - x) / 0.41
        motion = replace(LEVEL, start=(x, y, yaw), stop=1.0 + drive)
        run = SyntheticRun(scene, motion, spec, mount, duration=drive + 3.0, boxes=boxes)
        stack = Stack(run, "kiss_icp")
        last: ScanOdometry | None = None
        for sample in run.samples():
            if not isinstance(sample, GroundTruth):
                results = stack.feed(sample)
                last = results[-1] if results else last
        assert last is not None
        position, _ = (v[0] for v in run.truth(last.stamp))
        x0, x1, y0, y1 = feature.rect
        gx, gy = np.meshgrid(
            np.arange(x0, min(x1, x0 + 0.6) + 1e-6, 0.02), np.arange(max(y0, -0.4), min(y1, 0.4) + 1e-6, 0.02)
        )
        patch = stack.map.window(float(last.position[0]), float(last.position[1]), 4.0)
        mx, my = _turned(last.orientation, last.position, gx - position[0], gy - position[1])
        row = np.round((my - patch.origin[1]) / patch.resolution).astype(int)
        col = np.round((mx - patch.origin[0]) / patch.resolution).astype(int)
        z = patch.layers["elevation"][row, col] - last.position[2] + position[2]
        known = patch.layers["trusted"][row, col] > 0.5
        if name == "pole":
            shares[name] = float((known & (z > 0.2)).any())
        elif name == "pit":
            shares[name] = float((~known | (z < -0.1)).mean())
        else:
            shares[name] = float((known & (np.abs(z - feature.top) < 0.04)).mean())
    return shares


def main() -> None:
    """Run the study and draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m tools.lidar_study")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--png", default="docs/images/lidar.png")
    options = parser.parse_args()
    scene = corridor(0.45 * options.seconds + 6.0, seed=3)
    scores: dict[str, dict[str, Score]] = {}
    for name, (spec, mount) in CANDIDATES.items():
        scores[name] = {}
        for gait, motion in (("level", LEVEL), ("pitching", SHAKEN)):
            s = study(SyntheticRun(scene, motion, spec, mount, duration=options.seconds, seed=1))
            scores[name][gait] = s
            print(
                f"{name:24s} {gait:9s} trusted % {np.round(100 * s.trusted).astype(int)}"
                f"  rmse mm {np.round(1000 * s.rmse, 1)}  1 s {1000 * s.odometry:.1f} mm  {1000 * s.cpu:.1f} ms/scan",
                flush=True,
            )
        print(f"{name:24s} seen {seen_features(spec, mount)}", flush=True)
    draw(scores, options.png)


def draw(scores: dict[str, dict[str, Score]], path: str) -> None:
    """Coverage and error over the distance ahead."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6))
    middle = 0.5 * (BIN_EDGES[1:] + BIN_EDGES[:-1])
    for k, (name, by_gait) in enumerate(scores.items()):
        for gait, s in by_gait.items():
            style = {"color": f"C{k}", "ls": "-" if gait == "level" else "--", "marker": "o", "ms": 3}
            axes[0].plot(middle, 100.0 * s.trusted, label=name if gait == "level" else None, **style)
            axes[1].plot(middle, 1000.0 * s.rmse, **style)
    axes[0].set_ylabel("trusted cells [%]")
    axes[1].set_ylabel("RMS height error on even ground [mm]")
    axes[1].set_ylim(0.0, 40.0)
    for axis in axes:
        axis.set_xlabel("distance ahead of base_link [m]")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8, title="solid: level trunk, dashed: pitching 10 deg", title_fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
