"""Generated rescue lanes seen on the way only, with the sensors a robot has by default: does it start, what does the map say of the
ground it is about to drive on, and does it call ground what is none?
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.scenes import Scene, load_scene
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep, LockstepTimeout
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.frames import MapFrame
from tools.bench.report import Report

AHEAD = np.arange(0.4, 3.0, 0.04)
SIDE = np.arange(-0.2, 0.21, 0.04)
"""Of the strip the body is about to drive over [m]."""
WALL = 0.3
"""Higher than this above the robot's ground [m] the lane ends: what is behind is not ahead."""
FALSE = 0.10
"""A trusted height this far above all true ground within `NEAR` [m] is ground that is not there."""
NEAR = 0.08
MOVED = 0.5
"""A robot that came this far from its start has started [m]."""
EVERY = 100
"""Lockstep steps of 5 ms between two looks at the map."""
TRUSTED_LIMIT, FALSE_LIMIT = 95.0, 0.0


@dataclass(slots=True)
class Lane:
    """What one drive showed."""

    moved: float = 0.0
    state: str = ""
    seconds: float = 0.0
    seen: list[float] = field(default_factory=list)
    """Trusted share of the strip ahead, one a look [0..1]."""
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


def ahead(scene: Scene, patch: MapPatch, true: tuple[float, ...], held: tuple[float, ...]) -> float:
    """Trusted share [0..1] of the strip before the robot up to the first wall; NaN where a wall is next.

    `true` and `held`: x, y [m], yaw [rad] of the robot in the scene and where the map has it.
    """
    d, s = np.meshgrid(AHEAD, SIDE, indexing="ij")
    ground = heights(scene, *_placed(true, d, s))
    tall = ~(ground < heights(scene, *_placed(true, np.zeros(1), np.zeros(1)))[0] + WALL)
    wall = np.flatnonzero(tall.any(axis=1))
    rows = wall[0] if len(wall) else len(AHEAD)
    x, y = _placed(held, d[:rows], s[:rows])
    c = np.rint((x - patch.origin[0]) / patch.resolution).astype(int)
    r = np.rint((y - patch.origin[1]) / patch.resolution).astype(int)
    trusted = patch.layers["trusted"] > 0
    inside = (c >= 0) & (r >= 0) & (c < trusted.shape[1]) & (r < trusted.shape[0])
    hit = np.zeros(x.shape, bool)
    hit[inside] = trusted[r[inside], c[inside]]
    return float(hit.mean()) if rows else float("nan")


def false_ground(scene: Scene, patch: MapPatch, true: tuple[float, ...], held: tuple[float, ...]) -> int:
    """Trusted cells that hang above all true ground around them; the map is laid onto the scene at the robot.

    Cells more than `WALL` above the robot's ground do not count: a wall that is not there stops the robot, ground that is not there
    lets it fall.
    """
    r, c = np.nonzero(patch.layers["trusted"] > 0)
    dx = patch.origin[0] + c * patch.resolution - held[0]
    dy = patch.origin[1] + r * patch.resolution - held[1]
    turn = true[2] - held[2]
    x = true[0] + np.cos(turn) * dx - np.sin(turn) * dy
    y = true[1] + np.sin(turn) * dx + np.cos(turn) * dy
    steps = np.arange(-NEAR, NEAR + 1e-6, scene.resolution)
    highest = np.full(x.shape, -np.inf)
    for a in steps:
        for b in steps:
            highest = np.fmax(highest, heights(scene, x + a, y + b))
    claimed = patch.layers["elevation"][r, c]
    low = claimed < heights(scene, *_placed(true, np.zeros(1), np.zeros(1)))[0] + WALL
    return int(np.count_nonzero(low & (claimed > highest + FALSE)))


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
        except LockstepTimeout:
            out.state = "not ready"
            return out
        frame = MapFrame()
        x, y, yaw = config.start_pose()
        frame.x, frame.y, frame.yaw = x, y, yaw
        goal = next(iter(scene.goals.values()))
        begin = stack.seconds
        stack.send_goal(goal[0], goal[1])
        while stack.seconds < begin + timeout:
            for _ in range(EVERY):
                stack.step()
            place = stack.newest[t.TRUTH].pose.pose
            true = (place.position.x, place.position.y, yaw_of(place.orientation))
            held_at = stack.newest[t.ODOM].pose.pose
            held = frame.pose2(held_at.position.x, held_at.position.y, yaw_of(held_at.orientation))
            patch = stack.host.stage("elevation").map.full()
            out.seen.append(ahead(scene, patch, true, held))
            out.false = max(out.false, false_ground(scene, patch, true, held))
            out.moved = max(out.moved, float(np.hypot(true[0] - x, true[1] - y)))
            status = stack.statuses[-1] if stack.statuses else None
            if status is not None and GoalState(status.state).terminal:
                out.state = f"{status.state} {status.reason}".strip()
                break
        out.seconds = stack.seconds - begin
    return out


def rows(report: Report, seeds: int, timeout: float) -> None:
    """Rows `lanes.*`: robots that start, trusted share of the strip 0.4 to 3 m ahead, cells called ground that are none."""
    lanes = [drive(f"lanes:{seed}", timeout) for seed in range(seeds)]
    report.rate("lanes.started", sum(lane.moved >= MOVED for lane in lanes), len(lanes), 1.0)
    seen = [share for lane in lanes for share in lane.seen] or [0.0]
    report.add("lanes.trusted_pct", 100.0 * float(np.nanmean(seen)), "%", TRUSTED_LIMIT, at_least=True)
    report.add("lanes.false_ground_cells", max(lane.false for lane in lanes), "cells", FALSE_LIMIT)
    report.rate("lanes.reached", sum(lane.state == "reached" for lane in lanes), len(lanes))
