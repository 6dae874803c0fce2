"""Endpoint-preserving uniform cubic B-spline along a polyline, held near it by control points around each corner."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPLINE_BLEND = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
"""Uniform cubic B-spline: powers of t (rows) times control points (columns)."""


def reach_limits(vertices: Array, corridor: float) -> Array:
    """(n,) farthest distance [m] from each vertex at which its two side control points may sit.

    With controls P - h u, P, P + h v the curve passes P at h |v - u| / 6, so h bounds the distance to the polyline.
    Ends and near-reversals (the robot turns in place there) get 0.
    """
    leg = np.diff(vertices, axis=0)
    length = np.hypot(leg[:, 0], leg[:, 1])
    unit = leg / length[:, None]
    out = np.zeros(len(vertices))
    bend = np.hypot(*(unit[1:] - unit[:-1]).T)
    room = 0.5 * np.minimum(length[1:], length[:-1])
    out[1:-1] = np.minimum(room, 6.0 * 0.98 * corridor / np.maximum(bend, 1e-9))
    out[1:-1][bend > 2.0 * np.sin(np.radians(75.0))] = 0.0
    return out


def controls(vertices: Array, reach: Array) -> tuple[Array, NDArray[np.int64]]:
    """Control points (m, 2) and the vertex each belongs to; reach 0 keeps the corner sharp (triple point)."""
    leg = np.diff(vertices, axis=0)
    unit = leg / np.hypot(leg[:, 0], leg[:, 1])[:, None]
    points, owner = [vertices[0]] * 3, [0] * 3
    for i in range(1, len(vertices) - 1):
        sides = (vertices[i] - reach[i] * unit[i - 1], vertices[i], vertices[i] + reach[i] * unit[i])
        for k, p in enumerate(sides):
            # Where two corners share the middle of a leg the second control would only slow the curve down.
            if k == 0 and reach[i] > 0.0 and np.hypot(*(p - points[-1])) < 1e-9:
                continue
            points.append(p)
            owner.append(i)
    points += [vertices[-1]] * 3
    owner += [len(vertices) - 1] * 3
    return np.array(points), np.array(owner)


def curve(vertices: Array, reach: Array, step: float) -> tuple[Array, NDArray[np.int64]]:
    """The spline sampled every `step` [m] or a little less, both ends and every sharp corner in.

    Returns points (n, 2) and the vertex each sample belongs to (n,).
    """
    control, owner = controls(vertices, reach)
    xy, own, corner = _sampled(control, owner, step)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    corner[-1] = True
    stops = np.flatnonzero(corner)
    s = [np.zeros(1)]
    before = 0.0
    for stop in stops:
        if arc[stop] - before > 1e-9:
            count = max(1, int(np.ceil((arc[stop] - before) / step - 1e-9)))
            s.append(np.linspace(before, arc[stop], count + 1)[1:])
            before = arc[stop]
    at = np.concatenate(s)
    out = np.column_stack([np.interp(at, arc, xy[:, 0]), np.interp(at, arc, xy[:, 1])])
    out[0], out[-1] = vertices[0], vertices[-1]
    return out, own[np.minimum(np.searchsorted(arc, at - 1e-12), len(own) - 1)]


def _sampled(
    control: Array, owner: NDArray[np.int64], step: float
) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Points (n, 2) of the spline, at least four on each span and closer than a quarter of `step` [m], the vertex (n,)
    each belongs to, and (n,) which stand on a sharp corner. All spans with as many points are worked out at once."""
    leg = np.hypot(*np.diff(control, axis=0).T)
    chord = leg[:-2] + leg[1:-1] + leg[2:]
    spans = np.flatnonzero(chord >= 1e-12)
    count = np.maximum(4, np.ceil(chord[spans] / (0.25 * step)).astype(np.int64))
    first = np.concatenate([[1], 1 + np.cumsum(count)])
    xy, own = np.empty((first[-1], 2)), np.empty(first[-1], np.int64)
    corner = np.zeros(first[-1], np.bool_)
    xy[0], own[0] = control[0], owner[0]
    for n in np.unique(count).tolist():
        mine = np.flatnonzero(count == n)
        at = spans[mine]
        t = np.linspace(0.0, 1.0, n + 1)[1:]
        powers = np.broadcast_to(np.vander(t, 4, increasing=True), (len(at), n, 4))
        where = first[mine][:, None] + np.arange(n)
        xy[where] = powers @ (SPLINE_BLEND @ control[at[:, None] + np.arange(4)])
        own[where] = np.where(t < 0.5, owner[at + 1][:, None], owner[at + 2][:, None])
    corner[first[1:] - 1] = (control[spans + 1] == control[spans + 3]).all(axis=1)
    return xy, own, corner


def smooth_route(vertices: Array, corridor: float = 0.08, spacing: float = 0.02) -> Array:
    """A polyline (n, 2) [m] as a smooth line (m, 2) from its first to its last point.

    It stays within `corridor` [m] of the polyline and has a sample every `spacing` [m] or a little less. It looks at no
    map: a corner is rounded as far as the corridor allows (`planning.path.make_path` looks at the body's risk too).
    Successive vertices must differ.
    """
    return rounded(np.asarray(vertices, np.float64), corridor, spacing)


def rounded(
    vertices: Array,
    corridor: float,
    spacing: float,
    refused: Callable[[Array, list[tuple[int, slice]]], list[int]] | None = None,
) -> Array:
    """Samples (m, 2) of the rounded polyline.

    Each corner is rounded less until its samples lie within the corridor and `refused` does not name it. `refused` gets
    all samples and, per rounded corner, its vertex and which samples are its own; it returns the vertices whose
    rounding it refuses.
    """
    reach = reach_limits(vertices, corridor)
    while True:
        xy, owner = curve(vertices, reach, spacing)
        away = distance_along(xy, owner, vertices, corridor)
        # Samples come in the order of their corners.
        first = np.searchsorted(owner, np.arange(len(vertices) + 1))
        corners = [(i, slice(first[i], first[i + 1])) for i in np.flatnonzero(reach > 0.0).tolist()]
        shrink = {i for i, part in corners if away[part].max(initial=0.0) > corridor}
        if refused is not None:
            shrink.update(refused(xy, corners))
        if not shrink:
            return xy
        for i in shrink:
            reach[i] = 0.5 * reach[i] if reach[i] > 0.06 else 0.0


@njit(cache=True)
def distance_along(points: Array, owner: NDArray[np.int64], vertices: Array, window: float) -> Array:
    """(n,) distance [m] of each point of a rounded route from the route, looked for where the point belongs.

    points (n, 2); owner (n,) vertex that each belongs to; vertices (m, 2); only legs that begin within `window` [m] of
    that vertex along the route are looked at: the cost grows with the length, not with its square, and a
    route that comes back to a place is near itself there without having been left.
    """
    last = vertices.shape[0] - 1
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        best = np.inf
        for way in (1, -1):
            gone = 0.0
            leg = owner[i] if way == 1 else owner[i] - 1
            while 0 <= leg < last and gone <= window:
                ax, ay = vertices[leg, 0], vertices[leg, 1]
                dx, dy = vertices[leg + 1, 0] - ax, vertices[leg + 1, 1] - ay
                squared = dx * dx + dy * dy
                px, py = points[i, 0] - ax, points[i, 1] - ay
                t = min(max((px * dx + py * dy) / max(squared, 1e-18), 0.0), 1.0)
                best = min(best, np.hypot(px - t * dx, py - t * dy))
                gone += np.sqrt(squared)
                leg += way
        out[i] = best
    return out
