"""Generated rescue lanes seen on the way only, with the sensors a robot has by default: does it start, what does the
map say of the
ground it is about to drive on, and does it call ground what is none?
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.rotation import rotation
from hal.scenes import Scene, load_scene
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep, LockstepTimeout
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.wire.convert import xyz, xyzw, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import stamp_of
from tools.bench.report import Report

STRIP_AHEAD = np.arange(0.4, 3.0, 0.04)
STRIP_SIDE = np.arange(-0.2, 0.21, 0.04)
"""Of the strip the body is about to drive over [m]."""
WALL_HEIGHT = 0.3
"""Higher than this above the robot's ground [m] the lane ends: what is behind is not ahead."""
FALSE_HEIGHT = 0.10
"""A trusted height this far above all true ground within `TRUTH_RADIUS` [m] is ground that is not there."""
TRUTH_RADIUS = 0.08
STARTED_WAY = 0.5
"""A robot that came this far from its start has started [m]."""
READY_SCANS = 15
"""Scans in the map when the goal is sent. `up` says ready after 15 to 20, because it asks every topic for its rate; the
lockstep host after one."""
LOOK_EVERY = 100
"""Lockstep steps of 5 ms between two looks at the map."""
TRUSTED_LIMIT, FALSE_LIMIT = 95.0, 0.0
RAY_SPACING = 0.02
"""Between two samples of a line of sight [m]."""


@dataclass(slots=True)
class Lane:
    """What one drive showed."""

    moved: float = 0.0
    state: str = ""
    seconds: float = 0.0
    seen: list[float] = field(default_factory=list)
    """Trusted share of the strip ahead, one a look [0..1]."""
    open: list[float] = field(default_factory=list)
    """The same of the part that no ground hides from every LiDAR."""
    false: int = 0
    """Most cells called ground at one look where there is none."""


def heights(scene: Scene, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """True height at x, y [m]; NaN beyond the terrain."""
    c = np.rint((x - scene.origin[0]) / scene.resolution).astype(int)
    r = np.rint((y - scene.origin[1]) / scene.resolution).astype(int)
    inside = (c >= 0) & (r >= 0) & (c < scene.height.shape[1]) & (r < scene.height.shape[0])
    out = np.full(x.shape, np.nan)
    out[inside] = scene.height[r[inside], c[inside]]
    return out


def ahead(
    scene: Scene, patch: MapPatch, true: tuple[float, ...], held: tuple[float, ...], eyes: NDArray[np.float64]
) -> tuple[float, float]:
    """Trusted shares [0..1] of the strip before the robot up to the first wall: of all of it, and of what is open to
    one of
    `eyes` (n, 3), the places of the LiDARs in the scene [m]. NaN where there is none.

    `true` and `held`: x, y [m], yaw [rad] of the robot in the scene and where the map has it.
    """
    d, s = np.meshgrid(STRIP_AHEAD, STRIP_SIDE, indexing="ij")
    ground = heights(scene, *_placed(true, d, s))
    tall = ~(ground < heights(scene, *_placed(true, np.zeros(1), np.zeros(1)))[0] + WALL_HEIGHT)
    wall = np.flatnonzero(tall.any(axis=1))
    rows = wall[0] if len(wall) else len(STRIP_AHEAD)
    x, y = _placed(held, d[:rows], s[:rows])
    c = np.rint((x - patch.origin[0]) / patch.resolution).astype(int)
    r = np.rint((y - patch.origin[1]) / patch.resolution).astype(int)
    trusted = patch.layers["trusted"] > 0
    inside = (c >= 0) & (r >= 0) & (c < trusted.shape[1]) & (r < trusted.shape[0])
    hit = np.zeros(x.shape, bool)
    hit[inside] = trusted[r[inside], c[inside]]
    lies_open = np.zeros(x.shape, bool)
    for eye in eyes:
        lies_open |= in_view(scene, eye, *_placed(true, d[:rows], s[:rows]))
    return _share(hit), _share(hit[lies_open])


def in_view(
    scene: Scene, eye: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the straight line from `eye` (3,) to the ground at x, y [m] passes above all ground between."""
    z = heights(scene, x, y)
    n = int(np.hypot(x - eye[0], y - eye[1]).max(initial=0.0) / RAY_SPACING) + 2
    out = np.isfinite(z)
    for k in range(1, n):
        at = k / n
        low = heights(scene, eye[0] + at * (x - eye[0]), eye[1] + at * (y - eye[1]))
        # The last centimetres before the cell may be as high as its own noise.
        near = np.hypot(x - eye[0], y - eye[1]) * (1.0 - at) < 2.0 * scene.resolution
        out &= near | ~(low > eye[2] + at * (z - eye[2]))
    return out


def _share(hit: NDArray[np.bool_]) -> float:
    return float(hit.mean()) if hit.size else float("nan")


def false_ground(scene: Scene, patch: MapPatch, true: tuple[float, ...], held: tuple[float, ...]) -> int:
    """Trusted cells that hang above all true ground around them; the map is laid onto the scene at the robot.

    Cells more than `WALL_HEIGHT` above the robot's ground do not count: a wall that is not there stops the robot,
    ground that is not there
    lets it fall.
    """
    r, c = np.nonzero(patch.layers["trusted"] > 0)
    dx = patch.origin[0] + c * patch.resolution - held[0]
    dy = patch.origin[1] + r * patch.resolution - held[1]
    turn = true[2] - held[2]
    x = true[0] + np.cos(turn) * dx - np.sin(turn) * dy
    y = true[1] + np.sin(turn) * dx + np.cos(turn) * dy
    steps = np.arange(-TRUTH_RADIUS, TRUTH_RADIUS + 1e-6, scene.resolution)
    highest = np.full(x.shape, -np.inf)
    for a in steps:
        for b in steps:
            highest = np.fmax(highest, heights(scene, x + a, y + b))
    claimed = patch.layers["elevation"][r, c]
    low = claimed < heights(scene, *_placed(true, np.zeros(1), np.zeros(1)))[0] + WALL_HEIGHT
    return int(np.count_nonzero(low & (claimed > highest + FALSE_HEIGHT)))


def _placed(
    pose: tuple[float, ...], ahead: NDArray[np.float64], aside: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose[0] + c * ahead - s * aside, pose[1] + s * ahead + c * aside


def drive(name: str, timeout: float, sets: tuple[str, ...] = ()) -> Lane:
    """One lane from its start to its goal, at most `timeout` simulated seconds."""
    config = load(None, ["record=false", *sets], scene=name)
    scene = load_scene(name)
    out = Lane()
    with Lockstep(config) as stack:
        try:
            stack.wait_ready(20.0)
            stack.run_until(
                lambda: stack.newest[t.MAP_STATUS].scans >= READY_SCANS, 5.0, f"scan {READY_SCANS}"
            )
        except LockstepTimeout:
            out.state = "not ready"
            return out
        frame = MapFrame()
        x, y, yaw = config.start_pose()
        frame.x, frame.y, frame.yaw = x, y, yaw
        goal = next(iter(scene.goals.values()))
        begin = stack.seconds
        truth: deque[Any] = deque([stack.newest[t.TRUTH]], maxlen=LOOK_EVERY)
        stack.send_goal(goal[0], goal[1])
        while stack.seconds < begin + timeout:
            for _ in range(LOOK_EVERY):
                stack.step()
                truth.append(stack.newest[t.TRUTH])
            # Once stamps of a LiDAR are shifted, the newest pose at a look is that of the sweep before: the truth of
            # its own time counts.
            stamp = stamp_of(stack.newest[t.ODOM])
            place = min(truth, key=lambda at: abs(stamp_of(at) - stamp)).pose.pose
            true = (place.position.x, place.position.y, yaw_of(place.orientation))
            held_at = stack.newest[t.ODOM].pose.pose
            held = frame.pose2(held_at.position.x, held_at.position.y, yaw_of(held_at.orientation))
            patch = stack.host.stage("elevation").map.full()
            turn, at = rotation(xyzw(place.orientation)), xyz(place.position)
            body = np.array([lidar.mount.translation for lidar in config.mounted_lidars()])
            share = ahead(scene, patch, true, held, at + body @ turn.T)
            out.seen.append(share[0])
            out.open.append(share[1])
            out.false = max(out.false, false_ground(scene, patch, true, held))
            out.moved = max(out.moved, float(np.hypot(true[0] - x, true[1] - y)))
            status = stack.statuses[-1] if stack.statuses else None
            if status is not None and GoalState(status.state).terminal:
                out.state = f"{status.state} {status.reason}".strip()
                break
        out.seconds = stack.seconds - begin
    return out


def rows(report: Report, seeds: int, timeout: float) -> None:
    """Rows `lanes.*`: robots that start, trusted share of the strip 0.4 to 3 m ahead, all of it and the part that no
    crest hides,
    cells called ground that are none, and in which lanes."""
    lanes = [drive(f"lanes:{seed}", timeout) for seed in range(seeds)]
    report.rate("lanes.started", sum(lane.moved >= STARTED_WAY for lane in lanes), len(lanes), 1.0)
    seen = [share for lane in lanes for share in lane.seen] or [0.0]
    report.add("lanes.trusted_pct", 100.0 * float(np.nanmean(seen)), "%", TRUSTED_LIMIT, at_least=True)
    lies_open = [share for lane in lanes for share in lane.open] or [0.0]
    report.add(
        "lanes.trusted_open_pct", 100.0 * float(np.nanmean(lies_open)), "%", TRUSTED_LIMIT, at_least=True
    )
    report.add("lanes.false_ground_cells", max(lane.false for lane in lanes), "cells", FALSE_LIMIT)
    for seed, lane in enumerate(lanes):
        if lane.false:
            report.add(f"lanes.false_ground_cells.{seed}", lane.false, "cells")
    report.rate("lanes.reached", sum(lane.state == "reached" for lane in lanes), len(lanes))
