"""A route by ART for the planner's own requests."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.search import Plan, PlanRequest
from planning.search.door import as_plan
from tools.baselines.art.contact import all_valid, way_is_valid
from tools.baselines.art.layers import Layers, density, layers
from tools.baselines.art.params import ArtParams
from tools.baselines.art.roadmap import cheapest, connect, seconds
from tools.baselines.route import places

Array = NDArray[np.float64]
TESTED_SHARE = 0.01
"""Share of the space's extent between two poses that are tested along an edge."""


def plan(grid: ElevationGrid, request: PlanRequest, params: ArtParams | None = None, seed: int = 0) -> Plan:
    """The route for `request` between two positions: the cheapest over a roadmap of `milestones` valid poses.

    The plan begins and ends at the positions asked for; the poses next to them were found within `start_radius` and
    `goal_radius`. Same
    arguments, same route. Raises NoRoute.
    """
    p = params or ArtParams()
    start, goal = places(grid, request)
    work = _Work(grid, p, np.random.default_rng(seed))
    ends = [
        work.near(start, p.start_radius, request.start_yaw),
        work.near(goal, p.goal_radius, request.goal_yaw),
    ]
    for name, found, reason in (
        ("start", ends[0], NoRouteReason.START_NOT_ON_GRAPH),
        ("goal", ends[1], NoRouteReason.GOAL_IN_OBSTACLE),
    ):
        if found is None:
            raise NoRoute(
                reason, f"ART finds no pose whose legs reach the ground at the {name}: choose another"
            )
    poses = np.array([*ends, *work.milestones()])
    nodes, cost, tested = work.solve(poses)
    if not len(nodes):
        raise NoRoute(NoRouteReason.NO_ROUTE, "ART finds no way: choose another goal, or another planner")
    xy = np.vstack([start, work.shortened(poses[nodes])[:, :2], goal])
    return as_plan(grid, request, xy, cost, tested)


class _Work:
    """One query."""

    def __init__(self, grid: ElevationGrid, p: ArtParams, rng: np.random.Generator) -> None:
        self.p, self.rng, self.grid = p, rng, grid
        self.base: Layers = layers(grid, p)
        self.ground = (
            self.base.height,
            self.base.masked,
            grid.origin[0],
            grid.origin[1],
            grid.resolution,
            p.boxes,
        )
        self.speed = np.array(p.speed)
        rows, cols = grid.shape
        # The release bounds space by twice the map: translation is tested coarsely, rotation finely.
        self.step = TESTED_SHARE * 2.0 * math.hypot(rows, cols) * grid.resolution
        self.turn = TESTED_SHARE * 0.5 * math.pi

    def poses(self, rows: NDArray[np.int64], cols: NDArray[np.int64], yaw: Array) -> Array:
        """(n, 7) poses on the ground of those cells, each shifted along the normal and tilted at random."""
        p, n = self.p, len(rows)
        normal = self.base.normal[rows, cols]
        shift = self.rng.uniform(-1.0, 1.0, n) * np.minimum(self.base.rise[rows, cols], 0.5) * p.reach[2]
        xyz = np.column_stack(
            [
                self.grid.origin[0] + cols * self.grid.resolution,
                self.grid.origin[1] + rows * self.grid.resolution,
                self.base.height[rows, cols],
            ]
        )
        c, s = np.cos(yaw), np.sin(yaw)
        along, across = c * normal[:, 0] + s * normal[:, 1], c * normal[:, 1] - s * normal[:, 0]
        pitch = np.arctan2(along, normal[:, 2]) + p.pitch_spread * 2.0 / math.pi * np.arcsin(
            self.rng.uniform(-1.0, 1.0, n)
        )
        roll = -np.arcsin(np.clip(across, -1.0, 1.0)) + self.rng.uniform(-p.roll_spread, p.roll_spread, n)
        return np.column_stack([xyz + shift[:, None] * normal, _quaternions(yaw, pitch, roll)])

    def near(self, xy: tuple[float, float], radius: float, yaw: float | None) -> Array | None:
        """A valid pose within `radius` [m] of a place, the nearest of those tried; None without one."""
        n = self.p.tries
        away = radius * np.sqrt(self.rng.random(n))
        angle = self.rng.uniform(-math.pi, math.pi, n)
        cols = np.round((xy[0] + away * np.cos(angle) - self.grid.origin[0]) / self.grid.resolution).astype(
            int
        )
        rows = np.round((xy[1] + away * np.sin(angle) - self.grid.origin[1]) / self.grid.resolution).astype(
            int
        )
        inside = (rows >= 0) & (rows < self.grid.shape[0]) & (cols >= 0) & (cols < self.grid.shape[1])
        rows, cols, away = rows[inside], cols[inside], away[inside]
        yaws = self.rng.uniform(-math.pi, math.pi, len(rows)) if yaw is None else np.full(len(rows), yaw)
        drawn = self.poses(rows, cols, yaws)
        good = all_valid(*self.ground, drawn)
        return drawn[good][np.argmin(away[good])] if good.any() else None

    def milestones(self) -> Array:
        """(n, 7) valid poses: as many as asked for, fewer where hardly any draw is valid."""
        p, (rows, cols) = self.p, self.grid.shape
        found = np.empty((0, 7))
        sigma = (p.torso[0] + p.torso[1]) / 4.0 / self.grid.resolution
        for _ in range(20 * (1 + p.milestones // p.batch)):
            at = np.column_stack(
                [
                    np.round((found[:, k] - self.grid.origin[k]) / self.grid.resolution).astype(int)
                    for k in (1, 0)
                ]
            ).clip(0, (rows - 1, cols - 1))
            chance = density(self.base, at, sigma, p.unknown_mass).ravel()
            if not chance.any():
                break
            cell = self.rng.choice(chance.size, p.batch, p=chance)
            drawn = self.poses(cell // cols, cell % cols, self.rng.uniform(-math.pi, math.pi, p.batch))
            found = np.concatenate([found, drawn[all_valid(*self.ground, drawn)]])
            if len(found) >= p.milestones:
                break
        return found[: p.milestones]

    def solve(self, poses: Array) -> tuple[NDArray[np.int64], float, int]:
        """Vertices of the cheapest valid route from pose 0 to 1, its cost [s], and how many edges were tested."""
        edges, cost = connect(poses, self.speed)
        both = np.concatenate([edges, edges[:, ::-1]])
        order = np.argsort(both[:, 0], kind="stable")
        first = np.concatenate([[0], np.cumsum(np.bincount(both[:, 0], minlength=len(poses)))])
        target, number = both[order, 1], order % len(edges)
        alive, good = np.ones(len(edges), np.bool_), np.zeros(len(edges), np.bool_)
        tested = 0
        while True:
            nodes, used, total = cheapest(poses, first, target, number, cost, alive, 0, 1, self.speed)
            for a, b, e in zip(nodes[:-1].tolist(), nodes[1:].tolist(), used.tolist(), strict=True):
                if good[e]:
                    continue
                tested += 1
                if not self._passes(poses[a], poses[b]):
                    alive[e] = False
                    break
                good[e] = True
            else:
                return nodes, total, tested

    def _passes(self, a: Array, b: Array) -> bool:
        return bool(way_is_valid(*self.ground, a, b, self.step, self.turn))

    def shortened(self, poses: Array) -> Array:
        """The route without the poses that a direct move spares, where that is valid and not slower."""
        out = [poses[0]]
        i = 0
        while i < len(poses) - 1:
            for j in range(len(poses) - 1, i, -1):
                whole = sum(seconds(poses[k], poses[k + 1], self.speed) for k in range(i, j))
                if j == i + 1 or (
                    seconds(poses[i], poses[j], self.speed) <= whole and self._passes(poses[i], poses[j])
                ):
                    out.append(poses[j])
                    i = j
                    break
        return np.array(out)


def _quaternions(yaw: Array, pitch: Array, roll: Array) -> Array:
    """(n, 4) w, x, y, z of ZYX angles [rad]."""
    cy, sy, cp, sp, cr, sr = (f(0.5 * a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
    return np.column_stack(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


def unmasked(grid: ElevationGrid, request: PlanRequest) -> Plan:
    """ART without the masks of its learnt cost."""
    return plan(grid, request, ArtParams(masks=False))
