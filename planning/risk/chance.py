"""The chance that a route fails: what its controller was measured to do, at each face, slope, turn, gap and field of
posts on the way.

A route is a chain of straight moves with turns between them. Its four wheels trace lines over the map. Where one of
them rises or falls over a face (`planning.graph.faces`) it makes a quarter of a crossing of the envelope: a kerb under
all wheels is one crossing, one under the left wheels is half of one. Faces that follow each other like treads are
stairs. Hazards add along the route.

A failure is what ends a drive (`planning.graph.prices.ENDING`): the tracker leads a robot back that slid 0.1 m off its
line. Ground that nobody saw has no hazard.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hal.envelope import Envelope
from hal.raster import cells_of
from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.graph.cells import Cells
from planning.graph.describe import HEADING_STEP
from planning.graph.edge_price import HIGHEST_FACE, room_for, wheel_track
from planning.graph.faces import LEAST_FACE
from planning.graph.flags import FIELD
from planning.graph.params import GraphParams
from planning.graph.prices import ending, hazards
from planning.risk.pose_sets import turn_angle
from planning.risk.turns import ASKEW, BEND

Array = NDArray[np.float64]

SPACING = 0.10
"""Of the poses along a move [m]; in a turn it is `HEADING_STEP`."""
FOOT = 0.10
"""Foot and top of a face lie so far [m] before and behind its middle."""
EDGE = 10
"""So many of the samples under and beside the wheels, 3 cm apart, may be higher than the edge there: the highest one is
noise."""
LEAST_TOLD = 0.001
"""What fails more seldom is no place to tell of."""
NEAR = 0.6
"""Parts of one kind within so much [m] are told as one place."""


@dataclass(frozen=True, slots=True)
class Part:
    """One thing on the way that may go wrong."""

    transition: int
    hazard: float
    """-ln(1 - p)."""
    words: str
    """What it is, without its place."""
    x: float
    y: float
    """[m], `map`."""


@dataclass(frozen=True, slots=True)
class Chance:
    """How likely a route fails."""

    p_fail: float
    each: tuple[float, ...]
    """Of each transition with its turns."""
    worst: str
    """What is most likely to fail, and where; empty where nothing is."""


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A route as it is driven, frame `map`."""

    xy: Array
    """(n, 2) [m]"""
    back: NDArray[np.bool_]
    """(n - 1,) moves that are driven backward."""
    start_yaw: float
    goal_yaw: float
    """[rad], NaN = any."""


def chance(envelope: Envelope, grid: ElevationGrid, cells: Cells, way: Way, params: GraphParams) -> Chance:
    """How likely a way fails. `cells` and `params`: of the graph on `grid`; `envelope`: of the controller that drives."""
    count = len(way.back)
    parts = [p for p in Drive(envelope, grid, cells, way, params).parts() if p.hazard > 0.0]
    each = np.zeros(count)
    for part in parts:
        each[part.transition] += part.hazard
    return Chance(-math.expm1(-each.sum()), tuple((-np.expm1(-each)).tolist()), _worst(parts))


def _worst(parts: list[Part]) -> str:
    """In words: the part that those of its kind next to it make the most likely one to fail."""
    best, told = LEAST_TOLD, ""
    for part in sorted(parts, key=lambda p: -p.hazard)[:20]:
        kind = part.words.split()[:2]
        total = sum(
            p.hazard
            for p in parts
            if p.words.split()[:2] == kind and math.hypot(p.x - part.x, p.y - part.y) < NEAR
        )
        if total > best:
            best, told = total, f"{part.words} at x {part.x:.1f} y {part.y:.1f}"
    return told


class Drive:
    """One way over one map."""

    def __init__(
        self, envelope: Envelope, grid: ElevationGrid, cells: Cells, way: Way, params: GraphParams
    ) -> None:
        self._envelope, self._grid, self._cells, self._way = envelope, grid, cells, way
        axle, tread = params.axle, params.tread
        self._wheels = np.array([(a, b) for a in (axle, -axle) for b in (tread, -tread)])
        """(4, 2) where the wheels touch the ground, ahead of base_link and to its left [m]."""
        self._share = {name: ending(table) for name, table in envelope.manoeuvres.items()}
        reach = max(1, round(0.06 / grid.resolution))
        self._reach = reach
        poses, move, turn = self._poses()
        self._pose, self._move, self._turn = poses, move, turn

    # --- the way ----------------------------------------------------------------------------------------------
    def _poses(self) -> tuple[Array, NDArray[np.int64], Array]:
        """Poses (n, 3) of the body, the transition of each (n,), and how far it turns there from the pose before [rad]
        (n,), 0 in a move."""
        way = self._way
        leg = np.diff(way.xy, axis=0)
        yaw = np.arctan2(leg[:, 1], leg[:, 0]) + np.pi * way.back
        before = np.concatenate([[way.start_yaw], yaw])
        after = np.concatenate([yaw, [way.goal_yaw]])
        poses, move, turn = [], [], []
        for k in range(len(yaw) + 1):
            size = float(turn_angle(before[k], after[k]))
            if not math.isnan(size) and size != 0.0:
                n = math.ceil(abs(size) / HEADING_STEP)
                at = before[k] + size * (np.arange(n) + 0.5) / n
                poses.append(np.column_stack([np.broadcast_to(way.xy[k], (n, 2)), at]))
                move += [min(k, len(yaw) - 1)] * n
                turn += [size / n] * n
            if k < len(yaw):
                n = max(1, math.ceil(float(np.hypot(*leg[k])) / SPACING))
                at = way.xy[k] + leg[k] * (np.arange(n + 1) / n)[:, None]
                poses.append(np.column_stack([at, np.full(n + 1, yaw[k])]))
                move += [k] * (n + 1)
                turn += [0.0] * (n + 1)
        return np.concatenate(poses), np.array(move), np.array(turn)

    def _at(self, x: Array, y: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column of the cells at x, y [m], the nearest ones for places off the map."""
        grid = self._grid
        col = cells_of(x, grid.origin[0], grid.resolution)
        row = cells_of(y, grid.origin[1], grid.resolution)
        return np.clip(row, 0, grid.shape[0] - 1), np.clip(col, 0, grid.shape[1] - 1)

    def _under(self, poses: Array, points: Array) -> tuple[Array, Array]:
        """x, y [m] (n, m) of `points` (m, 2) of the body at `poses` (n, 3)."""
        c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        x = poses[:, :1] + points[:, 0] * c - points[:, 1] * s
        y = poses[:, 1:2] + points[:, 0] * s + points[:, 1] * c
        return x, y

    def _slopes(self, poses: Array) -> Array:
        """(n, 2) gradient [m/m] of the ground under the body at each pose, faces left out."""
        points = np.stack(np.meshgrid([-0.28, -0.14, 0.0, 0.14, 0.28], [-0.2, 0.0, 0.2]), -1).reshape(-1, 2)
        row, col = self._at(*self._under(poses, points))
        n, grid = self._reach, self._grid
        rows, cols = grid.shape
        inside = (row >= n) & (row < rows - n) & (col >= n) & (col < cols - n)
        row, col = np.clip(row, n, rows - 1 - n), np.clip(col, n, cols - 1 - n)
        even = inside & (np.abs(self._cells.faces[row, col]).max(axis=-1) < 1000.0 * LEAST_FACE)
        out = np.zeros((len(poses), 2))
        for axis, (dr, dc) in enumerate(((0, n), (n, 0))):
            ahead, behind = (row + dr, col + dc), (row - dr, col - dc)
            known = even & grid.trusted[ahead] & grid.trusted[behind]
            rise = np.where(known, grid.height[ahead] - grid.height[behind], np.nan) / (
                2 * n * grid.resolution
            )
            some = known.any(axis=1)
            out[some, axis] = np.nanmedian(rise[some], axis=1)
        return out

    # --- what may go wrong ------------------------------------------------------------------------------------
    def parts(self) -> Iterator[Part]:
        """All that may go wrong."""
        yield from self._crossings()
        yield from self._slope_and_posts()
        yield from self._turns()

    def _hazard(self, name: str, *values: float | Array, sigma: float = 0.0) -> Array:
        if name not in self._envelope.manoeuvres:
            return np.zeros(np.broadcast_shapes(*(np.shape(v) for v in values)))
        return hazards(self._envelope, name, sigma, *values, share=self._share[name])

    def _crossings(self) -> Iterator[Part]:
        """Faces and gaps that the wheels cross in moves: what they meet in a turn is the turn's."""
        grid, cells, way = self._grid, self._cells, self._way
        ground = (grid.height, cells.flags, cells.faces, *grid.origin, grid.resolution)
        for move, (a, b) in enumerate(pairwise(way.xy)):
            d = float(np.hypot(*(b - a)))
            if d == 0.0:
                continue
            u, back = (b - a) / d, bool(way.back[move])
            aside = np.array([-u[1], u[0]])
            crossed, gaps = np.empty((room_for(d), 4)), np.empty((room_for(d), 2))
            for wheel in self._wheels:
                w = a + wheel[0] * u + wheel[1] * aside
                track = (float(w[0]), float(w[1]), float(u[0]), float(u[1]), d)
                found, holes, _, _ = wheel_track(*ground, *track, crossed, gaps)
                for at, size, angle, tread in crossed[:found].tolist():
                    body, place = a + at * u, w + at * u
                    h, what = self._face(body, w, u, at, size, angle, 0.0 if back else tread, back)
                    yield Part(move, 0.25 * h, what, *place.tolist())
                for at, width in gaps[:holes].tolist():
                    h = float(self._hazard("gap", width))
                    yield Part(move, 0.25 * h, f"over a {width:.2f} m gap", *(w + at * u).tolist())

    def _face(
        self,
        body: Array,
        wheel: Array,
        u: Array,
        at: float,
        size: float,
        angle: float,
        tread: float,
        back: bool,
    ) -> tuple[float, str]:
        """Hazard of a crossing by all wheels, and what it is in words. `body`: where it is then; the wheel goes from
        `wheel` along `u` and crosses a face `size` [m] high after `at` [m], `angle` [rad] to its normal."""
        slope = math.atan(float(np.hypot(*self._slopes(np.array([[*body, math.atan2(u[1], u[0])]]))[0])))
        sigma = 0.0
        if self._grid.variance is not None:
            x, y = (wheel + np.array([[at - FOOT], [at + FOOT]]) * u).T
            sigma = math.sqrt(float(np.nansum(self._grid.variance[self._at(x, y)])))
        way, height = "up" if size > 0.0 else "down", abs(size)
        if tread > 0.0:
            h = self._hazard(f"stairs_{way}", height, min(tread, 0.35), angle, sigma=sigma)
            what = f"{way} stairs of {height:.2f} m"
        else:
            h = self._hazard(f"{'back_' if back else ''}{way}", height, angle, slope, sigma=sigma)
            what = f"{way} a {height:.2f} m face" + (" backward" if back else "")
        if angle > math.radians(20.0):
            what += f" at {math.degrees(angle):.0f} deg to its normal"
        return float(h), what

    def _slope_and_posts(self) -> Iterator[Part]:
        """What each stretch of a move costs, `SPACING` long."""
        at = np.flatnonzero(self._turn == 0.0)
        pose, move = self._pose[at], self._move[at]
        run = np.hypot(*np.diff(self._way.xy, axis=0).T)
        samples = np.maximum(np.bincount(move, minlength=len(run)), 1)
        length = (run / samples)[move]
        gradient = self._slopes(pose)
        yaw = pose[:, 2] + np.pi * self._way.back[move]
        steep = np.arctan(np.hypot(*gradient.T))
        direction = np.abs(wrap(yaw - np.arctan2(gradient[:, 1], gradient[:, 0])))
        h = self._hazard("slope", steep, direction) * length
        words = np.where(direction < np.pi / 4, "up", np.where(direction > 0.75 * np.pi, "down", "along"))
        field, posts = self._posts(pose)
        g = self._hazard("posts", posts, 0.5) * field * length
        for k in np.flatnonzero(h + g > 1e-6):
            what = (
                f"{words[k]} a slope of {math.degrees(steep[k]):.0f} deg"
                if h[k] >= g[k]
                else f"among posts of {posts[k]:.2f} m"
            )
            yield Part(int(move[k]), float(h[k] + g[k]), what, float(pose[k, 0]), float(pose[k, 1]))

    def _posts(self, poses: Array) -> tuple[Array, Array]:
        """Share of the ground under the body that is a stepfield, and height of its highest posts [m], at each pose."""
        grid = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 9), np.linspace(-0.2, 0.2, 6)), -1).reshape(-1, 2)
        row, col = self._at(*self._under(poses, grid))
        inside = self._cells.flags[row, col] & FIELD != 0
        faces = 0.001 * np.abs(self._cells.faces[row, col]).max(axis=-1)
        posts = np.where(inside & (faces <= HIGHEST_FACE), faces, 0.0).max(axis=1)
        return inside.mean(axis=1), posts

    def _turns(self) -> Iterator[Part]:
        """Each turn by what lies under its wheels and beside them."""
        at = np.flatnonzero(self._turn != 0.0)
        if not len(at):
            return
        pose, turn = self._pose[at], self._turn[at]
        points = np.stack(
            np.meshgrid(np.linspace(-0.39, 0.39, 27), np.linspace(-0.33, 0.33, 23)), -1
        ).reshape(-1, 2)
        row, col = self._at(*self._under(pose, points))
        faces = 0.001 * np.abs(self._cells.faces[row, col]).max(axis=-1)
        faces = np.where((faces >= LEAST_FACE) & (faces <= HIGHEST_FACE), faces, 0.0)
        under = (np.abs(points[:, 0]) <= 0.29) & (np.abs(points[:, 1]) <= 0.23)
        astride, beside = (
            -np.partition(-f, EDGE, axis=1)[:, EDGE] for f in (np.where(under, faces, 0.0), faces)
        )
        slope = np.arctan(np.hypot(*self._slopes(pose).T))
        # A turn is what it adds up to at its place.
        first = np.concatenate([[True], np.diff(at) > 1])
        number = np.cumsum(first) - 1
        sizes = np.bincount(number, np.abs(turn))
        for name, those in (("bend", sizes[number] <= BEND), ("spin", sizes[number] > BEND)):
            h = np.maximum(
                self._hazard(name, astride, slope, 1.0), self._hazard(name, beside, slope, 0.0)
            ) * np.abs(turn)
            if name == "bend":
                h = h * np.maximum(1.0 - ASKEW / sizes[number], 0.0)
            for k in np.flatnonzero(those & (h > 1e-6)):
                size = math.degrees(sizes[number[k]])
                edge = max(astride[k], beside[k])
                where = (
                    f"astride a {astride[k]:.2f} m face"
                    if astride[k] > 0.0
                    else f"beside a {edge:.2f} m face"
                )
                if edge == 0.0:
                    where = f"on a slope of {math.degrees(slope[k]):.0f} deg"
                yield Part(
                    int(self._move[at[k]]),
                    float(h[k]),
                    f"a turn of {size:.0f} deg {where}",
                    *pose[k, :2].tolist(),
                )
