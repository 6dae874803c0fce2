"""From a route over the graph to a path the robot can follow: smooth, re-checked on the map, with a speed for each
point."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.braking import FOLD_ANGLE
from planning.path.speed import speeds
from planning.path.spline import rounded
from planning.path.types import Path, PathLimits
from planning.path.watch import terrain_around
from planning.risk.body import (
    BodyModel,
    edge_poses,
    moments_of,
    sweep_poses,
    terrain_features,
)
from planning.risk.pose_sets import turn_angle
from planning.risk.steps import steps_under
from planning.risk.terrain import Terrain, heights_at
from planning.search.plan import Plan
from planning.search.straight import CHORD_SLACK

Array = NDArray[np.float64]


def make_path(
    plan: Plan,
    grid: ElevationGrid,
    body: BodyModel,
    limits: PathLimits | None = None,
    terrain: Terrain | None = None,
) -> Path:
    """Smooth `plan` into a path.

    `terrain` is that of the whole grid where it has been made already (`RiskTable.terrain`); without it, that around
    the route is made. Each corner is rounded as far as the corridor allows, less where the body's risk on the curve
    would be above the route's, not at all where even that fails.
    """
    limits = limits or PathLimits()
    if terrain is None:
        terrain = terrain_around(grid, plan.points[:, :2], body)
    vertices, back = _vertices(plan)
    start_yaw, goal_yaw = plan.request.start_yaw, plan.request.goal_yaw if plan.reaches_goal else None
    if len(vertices) == 1:
        stand = start_yaw if start_yaw is not None else (goal_yaw or 0.0)
        pieces = [np.array([[*vertices[0], stand]])]
    else:
        pieces = _pieces(vertices, back, terrain, body, limits)
    # Where the direction changes the last point of one piece is the first of the next, which tells the heading from
    # there on.
    poses = np.concatenate([*(piece[:-1] for piece in pieces[:-1]), pieces[-1]])
    speed, least = _profile(poses, terrain, body, limits)
    xy, yaw = poses[:, :2], poses[:, 2]
    sparse = _thin(poses, 0.05)
    features = terrain_features(terrain, poses[sparse], body)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    worst = features[:, :3].max(axis=0).tolist()
    return Path(
        np.column_stack([xy, heights_at(terrain, xy)]),
        yaw,
        speed,
        least,
        s,
        vertices,
        back,
        None if start_yaw is None else turn_angle(start_yaw, float(yaw[0])),
        goal_yaw,
        (worst[0], worst[1], worst[2]),
        poses[sparse],
        steps_under(terrain, poses[sparse], body.length, body.width),
        limits,
    )


def _pieces(
    vertices: Array, back: NDArray[np.bool_], terrain: Terrain, body: BodyModel, limits: PathLimits
) -> list[Array]:
    """Smoothed poses x, y, yaw of the body, one (n, 3) for each stretch in one direction."""
    out, first = [], 0
    for last in range(1, len(vertices)):
        if last < len(back) and back[last] == back[first]:
            continue
        xy = _smooth(vertices[first : last + 1], terrain, body, limits)
        out.append(np.column_stack([xy, wrap(_headings(xy) + np.pi * back[first])]))
        first = last
    return out


def rest_of(
    path: Path,
    pose: tuple[float, float, float],
    grid: ElevationGrid,
    body: BodyModel,
    terrain: Terrain | None = None,
) -> Path:
    """What is left of `path` for a robot at `pose` x, y [m], yaw [rad] on it: the same way, with the speeds of the map
    of now. `terrain` as in `make_path`."""
    x, y, yaw = pose
    k, w = (int(np.argmin(np.hypot(*(p[:, :2] - (x, y)).T))) for p in (path.points, path.watched))
    ahead = path.ahead(x, y)
    assert ahead is not None, "the robot is on the path"
    near = path.s <= path.s[k] + 2.0 * path.limits.corridor
    folds = np.flatnonzero(near[1:] & (np.abs(wrap(np.diff(path.yaw))) > FOLD_ANGLE))
    k = max(k, int(folds[0]) + 1) if len(folds) else k
    poses = np.column_stack([path.points[k:, :2], path.yaw[k:]])
    if terrain is None:
        terrain = terrain_around(grid, poses[:, :2], body)
    speed, least = _profile(poses, terrain, body, path.limits)
    return replace(
        path,
        points=path.points[k:],
        yaw=path.yaw[k:],
        speed=speed,
        least=least,
        s=path.s[k:] - path.s[k],
        route=np.concatenate([[(x, y)], ahead[0]]),
        back=ahead[1],
        initial_turn=float(turn_angle(yaw, float(path.yaw[k]))),
        watched=path.watched[w:],
        faces=path.faces[w:],
    )


def _profile(poses: Array, terrain: Terrain, body: BodyModel, limits: PathLimits) -> tuple[Array, Array]:
    """(n,) speed and least speed along poses x, y, yaw of the body; 0 where it turns from forward to backward or
    back."""
    chord = np.diff(poses[:, :2], axis=0)
    back = np.cos(poses[:-1, 2] - np.arctan2(chord[:, 1], chord[:, 0])) < 0.0
    ends = [0, *(np.flatnonzero(back[1:] != back[:-1]) + 1).tolist(), max(len(poses) - 1, 1)]
    speed, least = np.zeros(len(poses)), np.zeros(len(poses))
    for first, last in pairwise(ends):
        piece = poses[first : last + 1].copy()
        if last < len(poses) - 1:
            piece[-1, 2] = piece[-2, 2]
        speed[first : last + 1], least[first : last + 1] = _one_way(piece, terrain, body, limits)
    speed[ends[1:-1]] = least[ends[1:-1]] = 0.0
    return speed, least


def _one_way(poses: Array, terrain: Terrain, body: BodyModel, limits: PathLimits) -> tuple[Array, Array]:
    """Speed and least speed of a stretch in one direction."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    sparse = _thin(poses, 0.05)
    features = terrain_features(terrain, poses[sparse], body)
    faces = steps_under(terrain, poses[sparse], body.length, body.width)
    return speeds(s, poses[:, 2], s[sparse], features, faces, body, limits)


def _vertices(plan: Plan) -> tuple[Array, NDArray[np.bool_]]:
    """(n, 2) corners of the route and (n - 1,) whether the way between two of them is driven backward."""
    xy = plan.points[:, :2]
    # The route of a baseline has no transitions: it is driven forward.
    back = [t.backward for t in plan.transitions] or [False] * (len(xy) - 1)
    keep, ways = [xy[0]], []
    for p, way in zip(xy[1:], back, strict=True):
        if np.hypot(*(p - keep[-1])) > 1e-3:
            keep.append(p)
            ways.append(way)
    return np.array(keep), np.array(ways, np.bool_)


def _leg(a: Array, b: Array, body: BodyModel) -> Array:
    return edge_poses(a, b, body) if np.hypot(*(b - a)) > 1e-6 else np.empty((0, 3))


def _dense(body: BodyModel, limits: PathLimits) -> BodyModel:
    """`body` with pose sets as dense as the path's samples, so that maxima compare like with like."""
    return body.model_copy(update={"edge_step": limits.spacing})


PEAK_SLACK = 0.005
"""Share of a feature's scale by which the path's maximum may exceed the route's: what sampling alone makes of it."""


def _rise(mine: Array, other: Array, body: BodyModel) -> float:
    """How much riskier one pose set is than another, in scaled risk, by their moments (3, 4): the worst of
    mean-and-tail risk and each core maximum."""
    more = mine - other
    rise = body.weight_mean * more[0] + body.weight_tail * more[1]
    return float(max(rise[:3].sum(), rise[3], (more[2] / body.scales).max()))


def _smooth(vertices: Array, terrain: Terrain, body: BodyModel, limits: PathLimits) -> Array:
    """Samples (n, 2) of the rounded route."""
    raw = _corner_poses(vertices, _dense(body, limits))
    ends = np.cumsum([len(poses) for poses in raw])
    along = terrain_features(terrain, np.concatenate(raw), body)
    peak = along[:, :3].max(axis=0)
    sharp = moments_of(along, np.column_stack([np.append(0, ends[:-1]), ends]), body)

    def steps(poses: Array) -> Array:
        return steps_under(terrain, poses, body.length, body.width)

    def riskier(xy: Array, corners: list[tuple[int, slice]]) -> list[int]:
        """Corners whose rounding is riskier than the route."""
        poses = np.column_stack([xy, _headings(xy)])
        parts = np.array([(part.start, part.stop) for _, part in corners], np.int64).reshape(-1, 2)
        mine, face = moments_of(terrain_features(terrain, poses, body), parts, body), steps(poses)
        out = []
        for k, (i, part) in enumerate(corners):
            higher = (mine[k, 2, :3] - peak > PEAK_SLACK * body.scales[:3]).any()
            if higher or (len(raw[i]) and _rise(mine[k], sharp[i], body) > CHORD_SLACK):
                out.append(i)
            elif len(raw[i]):
                step = face[part].max()
                # The rounding may meet a face that the sharp corner does not.
                if step > limits.max_step and step > steps(raw[i]).max() + 1e-6:
                    out.append(i)
        return out

    return rounded(vertices, limits.corridor, limits.spacing, riskier)


def _corner_poses(vertices: Array, body: BodyModel) -> list[Array]:
    """Per vertex the poses of the sharp route around it: half a leg, the turn, half a leg."""
    middle = 0.5 * (vertices[1:] + vertices[:-1])
    out = []
    for i in range(len(vertices)):
        v = vertices[i]
        before = _leg(middle[i - 1], v, body) if i > 0 else np.empty((0, 3))
        after = _leg(v, middle[i], body) if i < len(middle) else np.empty((0, 3))
        turn = np.empty((0, 3))
        if len(before) and len(after):
            turn = sweep_poses(v[0], v[1], before[0, 2], after[0, 2], body)
        out.append(np.concatenate([before, turn, after]))
    return out


def _headings(xy: Array) -> Array:
    """(n,) direction of travel [rad]: mean of the chords before and after; the chord after at a sharp corner."""
    chord = np.arctan2(*np.diff(xy, axis=0).T[::-1])
    yaw = np.append(chord, chord[-1])
    bend = wrap(np.diff(chord))
    smooth = np.abs(bend) < np.radians(15.0)
    yaw[1:-1] = np.where(smooth, chord[:-1] + 0.5 * bend, chord[1:])
    return wrap(yaw)


def _thin(rows: Array, spacing: float) -> NDArray[np.int64]:
    """Indices of rows (x, y, ...) about `spacing` apart, both ends in."""
    if len(rows) < 3:
        return np.arange(len(rows))
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0).T))])
    count = max(2, int(np.ceil(s[-1] / spacing)) + 1)
    return np.unique(np.searchsorted(s, np.linspace(0.0, s[-1], count) - 1e-9))
