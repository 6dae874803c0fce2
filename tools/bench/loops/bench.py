"""Maps that close: drift before and after, wrong loops where corridors look alike, time and memory.

    python -m tools.bench loops --only twins --seeds 20
    python -m tools.bench loops --only twins --seeds 20 --follow
    python -m tools.bench loops --only site

    python -m tools.bench loops --only graph --seeds 20

`graph` is the way through `site` without LiDARs: each place that is passed again closes a loop that is 6 mm and 0.05
deg off. It tells how near odometry and loops can come alone, and with keyframes that sweeps lay onto each other.
`ring` is a short loop, `twins` two corridors that look the same to the last crate, `site` 150 x 150 m with a hill and
four such corridors, 1.2 km. What the LiDARs see is cast on the scene; the odometry is the truth with errors of the
size that the stack's odometry has (`tools.closing.Drift`), `--drift` times as large. With `--follow` loops close scan
by scan, as `loops.online` does it. `driven` and `online` are the ring with physics and the stack's own odometry, closed
by `map build` and by itself. Truth judges, and nothing else uses it.
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from itertools import islice, pairwise

import numpy as np

from hal.rotation import wrap
from hal.scenes import Scene
from hal.types import Array
from mapping.closing import Closed, Closing, Recording, corrected, fuse
from mapping.closing.close import EXACT_SIGMA, LOOP_LENGTH, LOOP_SIGMA, NEXT_SIGMA, RANDOM_DRIFT, STEADY_DRIFT
from mapping.closing.graph import PoseGraph, between, levelled
from mapping.closing.keyframes import KEYFRAME_SPACING
from mapping.elevation.config import ElevationConfig
from tools.bench.loops import driven
from tools.bench.report import Report
from tools.closing import HEIGHT, Drift, Drive, Way, drifted, record, ring, site, twins, way_through

SITES = ("ring", "twins", "site")
DRIVEN = {"driven": driven.built_rows, "online": driven.online_rows}
REGISTRATION_ERROR = np.array([0.006, 0.006, 0.006, math.radians(0.05)])
"""Errors of a registration: x, y, z [m], yaw [rad]."""
NEIGHBOUR_ERROR = np.array([0.001, 0.001, 0.001, math.radians(0.005)])
"""The same of neighbours whose sweeps are laid onto each other,"""
LOOP_ERROR = np.array([0.001, 0.001, 0.002, math.radians(0.005)])
"""and of loops."""
PIECES_PER_SCAN, LAST_PIECES = 10, 500
"""Of work: a tick of the stage `loops` each, at 10 Hz and half a metre a second; at the end more than are left."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench loops", description=__doc__)
    parser.add_argument(
        "--only",
        choices=(*SITES, "graph", *DRIVEN),
        action="append",
        help="may be repeated; the first three without it",
    )
    parser.add_argument(
        "--seeds", type=int, default=1, help="drives of each, each with its own drift and scene"
    )
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--scale", type=float, default=1.0, help="of ring and site")
    parser.add_argument("--drift", type=float, default=1.0, help="times that of the stack's odometry")
    parser.add_argument("--step", type=float, default=0.5, help="between scans [m]")
    parser.add_argument("--set", action="append", default=[], help="of the driven ones, one key: a.b=c")
    parser.add_argument("--follow", action="store_true", help="close loops while the scans come")
    parser.add_argument("--map", action="store_true", help="fuse the elevation map of each as well")
    options = parser.parse_args(args)
    report = Report("loops")
    for name in options.only or SITES:
        if name == "graph":
            graph_rows(report, options)
        elif name in DRIVEN:
            DRIVEN[name](report, name, *world("ring", options.first, options.scale), options)
        else:
            rows(report, name, options)
    return report


def graph_rows(report: Report, options: argparse.Namespace) -> None:
    """Largest error of any keyframe after closing, over the drives: by odometry and loops, and with sweeps between
    neighbours."""
    scene, way = site(options.scale, options.first)
    truth = way_through(scene, way, KEYFRAME_SPACING)
    ground = np.array([levelled(pose, HEIGHT) for pose in truth])
    along = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(ground[:, :2], axis=0), axis=1)])
    nodes = [0]
    for k in range(len(along)):
        if along[k] - along[nodes[-1]] >= 0.95 * KEYFRAME_SPACING:
            nodes.append(k)
    loops = [
        (min(near)[1], b)
        for b in range(len(nodes))
        if (
            near := [
                (d, a)
                for a in range(b)
                if (d := _apart(ground, along, nodes[a], nodes[b])) < KEYFRAME_SPACING
            ]
        )
    ]
    report.add("graph.loops", len(loops), "1")
    for name in ("odometry", "sweeps"):
        found = []
        for seed in range(options.first, options.first + options.seeds):
            said = drifted(truth, Drift().times(options.drift), seed)
            place = np.array([levelled(pose, HEIGHT) for pose in said])
            rng = np.random.default_rng(seed)
            graph = PoseGraph()
            graph.begin(ground[0])
            for a, b in pairwise(nodes):
                far = along[b] - along[a]
                if name == "sweeps":
                    seen = between(ground[a], ground[b]) + NEIGHBOUR_ERROR * rng.standard_normal(4)
                    graph.drive(seen, NEXT_SIGMA, far)
                else:
                    graph.drive(between(place[a], place[b]), RANDOM_DRIFT * math.sqrt(far), far)
            wrong, sigma = (LOOP_ERROR, EXACT_SIGMA) if name == "sweeps" else (REGISTRATION_ERROR, LOOP_SIGMA)
            for a, b in loops:
                seen = between(ground[nodes[a]], ground[nodes[b]]) + wrong * rng.standard_normal(4)
                graph.close(a, b, seen, sigma)
            graph.solve(STEADY_DRIFT)
            off = graph.nodes - ground[nodes]
            turned = np.degrees(np.abs(wrap(off[:, 3]))).max()
            found.append((np.linalg.norm(off[:, :3], axis=1).max(), turned))
        metres, degrees = np.array(found).T
        report.add(f"graph.{name}.median_m", float(np.median(metres)), "m")
        report.add(f"graph.{name}.worst_m", float(metres.max()), "m")
        report.add(f"graph.{name}.worst_deg", float(degrees.max()), "deg")
        report.rate(f"graph.{name}.within", int((metres <= driven.WANTED_ERROR[0]).sum()), len(metres))


def _apart(ground: Array, along: Array, a: int, b: int) -> float:
    """Distance of two places [m], infinite where the robot has not been elsewhere between them."""
    return (
        float(np.linalg.norm(ground[a, :2] - ground[b, :2]))
        if along[b] - along[a] > LOOP_LENGTH
        else math.inf
    )


def world(name: str, seed: int, scale: float) -> tuple[Scene, Way]:
    """A scene and the way through it."""
    if name == "ring":
        return ring((10.0 * scale, 7.0 * scale), seed)
    if name == "twins":
        return twins(float(np.random.default_rng(seed).uniform(3.6, 9.0)), seed)
    return site(scale, seed)


class Following:
    """Loops that close while the scans come."""

    def __init__(self, closing: Closing) -> None:
        self.told: list[Closed] = []
        self.seconds = 0.0
        """CPU."""
        self._closing, self._pieces = closing, closing.follow()

    def step(self) -> None:
        """A scan came."""
        begin = time.process_time()
        self.told += [one for one in islice(self._pieces, PIECES_PER_SCAN) if one is not None]
        self.seconds += time.process_time() - begin

    def end(self) -> Closed:
        """No scan comes any more: what is known once all was searched."""
        self.told += [one for one in islice(self._pieces, LAST_PIECES) if one is not None]
        return self._closing.closed()


def rows(report: Report, name: str, options: argparse.Namespace) -> None:
    """All drives of one scene."""
    before, after, loops, refused, wrong, seconds, disk, length = [], [], 0, 0, 0, 0.0, 0.0, 0.0
    for seed in range(options.first, options.first + options.seeds):
        scene, way = world(name, seed, options.scale)
        truth = way_through(scene, way, options.step)
        recording, params = Recording(), ElevationConfig()
        drive = Drive(scene, truth, drifted(truth, Drift().times(options.drift), seed), seed)
        closing = Closing(recording, params, levelled(truth[0], HEIGHT), max(1.0, options.drift))
        following = Following(closing)
        record(recording, 0, drive, following.step if options.follow else lambda: None)
        begin = time.process_time()
        closed = following.end() if options.follow else closing.close()
        seconds += following.seconds + time.process_time() - begin
        poses = corrected(recording.scans, closed.keyframes, closed.nodes)
        before.append(errors(corrected(recording.scans, closed.keyframes, closed.driven), truth))
        after.append(errors(poses, truth))
        loops, refused, wrong = (
            loops + len(closed.loops),
            refused + len(closed.refused),
            wrong + max(driven.wrongs(one, grounds_of(one, truth)) for one in (*following.told, closed)),
        )
        disk, length = disk + recording.nbytes / 1e6, length + recording.scans[-1].along
        if options.map:
            begin = time.process_time()
            made = fuse(recording, poses, params)
            report.add(f"{name}.{seed}.fuse_s", time.process_time() - begin, "s")
            report.add(f"{name}.{seed}.known_cells", made.store.counts()[1], "1")
        recording.close()
    worst_before, worst_after = np.max(before, axis=0), np.max(after, axis=0)
    report.add(f"{name}.drives", options.seeds, "1")
    report.add(f"{name}.driven", length, "m")
    report.add(f"{name}.before_m", worst_before[0], "m")
    report.add(f"{name}.before_deg", worst_before[1], "deg")
    report.add(f"{name}.after_m", worst_after[0], "m", driven.WANTED_ERROR[0])
    report.add(f"{name}.after_deg", worst_after[1], "deg", driven.WANTED_ERROR[1])
    report.add(f"{name}.loops", loops, "1", 1.0, at_least=True)
    report.add(f"{name}.refused", refused, "1")
    report.add(f"{name}.wrong", wrong, "1", 0.0)
    report.add(f"{name}.close_ms_per_m", 1e3 * seconds / length, "ms")
    report.add(f"{name}.disk_mb", disk, "MB")
    report.add(f"{name}.peak_mb", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, "MB")


def errors(poses: Array, truth: Array) -> tuple[float, float]:
    """Largest error of poses (n, 4, 4) of base_link: place [m], heading [deg]."""
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0]) - np.arctan2(truth[:, 1, 0], truth[:, 0, 0])
    place = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
    return float(place.max()), float(np.degrees(np.abs(wrap(yaw)).max()))


def grounds_of(closed: Closed, truth: Array) -> Array:
    """(n, 4) of the ground under each keyframe of a drive whose poses are `truth` (n, 4, 4)."""
    return np.array([levelled(truth[frame.scan], HEIGHT) for frame in closed.keyframes])
