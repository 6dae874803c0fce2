"""The graph of the released TRG-planner, draw by draw: an expanding wavefront of random samples.

Arithmetic is float32 where the released code is, and the random stream is mt19937 with one draw per sample, so that
the same seed gives the same graph.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from hal.kernels import select
from hal.raster import cell_of, cells_of
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.graph import SNAP_DISTANCE, GraphParams, TraversalGraph
from planning.graph.edge_risk import F32, edge_risk, height_near


class NativeParams(GraphParams):
    """Settings of the released planner's disc test beside those of the graph."""

    height_threshold: float = Field(
        default=0.50, gt=0.0, description="a cell this far from the disc's median is an outlier [m]"
    )
    collision_threshold: float = Field(
        default=0.30, ge=0.0, lt=1.0, description="largest share of outliers in the disc"
    )


MAX_BLOCKED_DRAWS = 1000
MAX_ROOT_TRIES = 101


def window_minmax(height: NDArray[np.float32], k: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Least and largest height [m] of the (2k + 1)^2 cells around each: two (rows, cols). NaN and what lies outside do
    not count."""
    size, unknown = 2 * k + 1, np.isnan(height)
    low = np.where(unknown, F32(np.inf), height)
    high = np.where(unknown, F32(-np.inf), height)
    return (
        ndimage.minimum_filter(low, size, mode="constant", cval=np.inf),
        ndimage.maximum_filter(high, size, mode="constant", cval=-np.inf),
    )


@njit(cache=True)
def disc_blocked(height, xs, ys, x0, y0, res, low, high, k, x, y, radius, limit, share, buffer):
    """True if more than `share` of the map points within `radius` of x, y lie over `limit` off their upper median.

    xs, ys: float32 coordinates of columns and rows. `low`, `high`, `k` from `window_minmax`, with k cells covering the
    radius: where the whole square spans no more than `limit`, no cell can be an outlier and the median is not needed.
    No map point at all counts as blocked.
    """
    rows, cols = height.shape
    r_mid = cell_of(y, y0, res)
    c_mid = cell_of(x, x0, res)
    if 0 <= r_mid < rows and 0 <= c_mid < cols and high[r_mid, c_mid] - low[r_mid, c_mid] <= limit:
        known = height[r_mid, c_mid]
        if known == known:
            return False
    r2 = radius * radius
    n = np.int64(0)
    for r in range(max(0, r_mid - k), min(rows, r_mid + k + 1)):
        dy = ys[r] - y
        rest = r2 - dy * dy
        if rest < 0.0:
            continue
        for c in range(max(0, c_mid - k), min(cols, c_mid + k + 1)):
            dx = xs[c] - x
            if dx * dx + dy * dy <= r2:
                z = height[r, c]
                if z == z:
                    buffer[n] = z
                    n += 1
    if n == 0:
        return True
    median = select(buffer, n, n // 2)
    outliers = 0
    for i in range(n):
        if abs(buffer[i] - median) > limit:
            outliers += 1
    return F32(outliers) / F32(n) > share


@njit(cache=True)
def _draw(key, pos):
    """Next float32 in [0, 1] of mt19937; `key` (624,) uint32 and `pos` (1,) are its state."""
    n = pos[0]
    if n >= 624:
        for i in range(624):
            y = (key[i] & np.uint32(0x80000000)) | (key[(i + 1) % 624] & np.uint32(0x7FFFFFFF))
            mixed = key[(i + 397) % 624] ^ (y >> np.uint32(1))
            if y & np.uint32(1):
                mixed ^= np.uint32(0x9908B0DF)
            key[i] = mixed
        n = 0
    y = key[n]
    pos[0] = n + 1
    y ^= y >> np.uint32(11)
    y ^= (y << np.uint32(7)) & np.uint32(0x9D2C5680)
    y ^= (y << np.uint32(15)) & np.uint32(0xEFC60000)
    y ^= y >> np.uint32(18)
    return F32(F32(y) / F32(4294967296.0))


@njit(cache=True)
def _bucket(x, y, bx, by, size, nbx, nby):
    i = min(max(int((x - bx) / size), 0), nbx - 1)
    j = min(max(int((y - by) / size), 0), nby - 1)
    return i, j


@njit(cache=True)
def grow(
    height, xs, ys, x0, y0, res, low, high, k, start_x, start_y, dist, radius, samples, limit, share, key
):
    """Expand the graph from the start. -> status, nodes (n, 3) f32, alive (n,), edges (m, 2), risk (m,).

    status 1: no free root was found. Arguments that are lengths are float32; low, high: `window_minmax` of k cells.
    """
    rows, cols = height.shape
    buffer = np.empty((2 * k + 1) ** 2, np.float32)
    pos = np.array([624])
    share = F32(share)

    # Buckets a little wider than the ring: the node a sample was drawn from is always in the 3x3 around it, so the
    # nearest node is too.
    size = dist * 1.01 + 1e-3
    bx = x0 - 2.0 * radius - res
    by = y0 - 2.0 * radius - res
    nbx = int((cols * res + 4.0 * radius + 2.0 * res) / size) + 2
    nby = int((rows * res + 4.0 * radius + 2.0 * res) / size) + 2
    head = np.full((nby, nbx), -1, np.int64)
    capacity = 1024
    link = np.empty(capacity, np.int64)
    nodes = np.empty((capacity, 3), np.float32)
    alive = np.ones(capacity, np.bool_)
    first = np.full(
        capacity, -1, np.int64
    )  # newest half-edge of each node; half-edges 2e, 2e + 1 belong to edge e
    edge_room = 4096
    edges = np.empty((edge_room, 2), np.int32)
    risks = np.empty(edge_room, np.float32)
    chain = np.empty(2 * edge_room, np.int64)
    n = 0
    m = 0

    # Root: one ring step in x from the start, drifting by random steps while blocked (y drawn first, as gcc does).
    px = F32(start_x) + dist
    py = F32(start_y)
    tries = 0
    while disc_blocked(height, xs, ys, x0, y0, res, low, high, k, px, py, radius, limit, share, buffer):
        tries += 1
        if tries > MAX_ROOT_TRIES:
            return 1, nodes[:0], alive[:0], edges[:0], risks[:0]
        uy = _draw(key, pos)
        ux = _draw(key, pos)
        px = px + dist * ux
        py = py + dist * uy

    max_slope = F32(math.atan2(limit, radius))
    wire_new = float(F32(dist - radius)) < 0.25 * float(dist)
    half = F32(radius * F32(0.5))
    ring_x = np.empty(samples, np.float32)
    ring_y = np.empty(samples, np.float32)
    todo_a = np.empty(64, np.int64)

    nodes[0, 0] = px
    nodes[0, 1] = py
    nodes[0, 2] = height_near(height, x0, y0, res, px, py)
    i, j = _bucket(px, py, bx, by, size, nbx, nby)
    link[0] = -1
    head[j, i] = 0
    n = 1
    queue = np.empty(capacity, np.int64)
    queue[0] = 0
    q_head = 0
    q_tail = 1
    while q_head < q_tail:
        here = queue[q_head]
        q_head += 1
        hx = nodes[here, 0]
        hy = nodes[here, 1]
        count = 0
        blocked_draws = 0
        while count < samples and blocked_draws <= MAX_BLOCKED_DRAWS:
            u = _draw(key, pos)
            angle = F32(float(F32(2.0) * u) * math.pi)
            sx = hx + dist * F32(math.cos(angle))
            sy = hy + dist * F32(math.sin(angle))
            if disc_blocked(height, xs, ys, x0, y0, res, low, high, k, sx, sy, radius, limit, share, buffer):
                blocked_draws += 1
            else:
                ring_x[count] = sx
                ring_y[count] = sy
                count += 1
        for s in range(count):
            sx = ring_x[s]
            sy = ring_y[s]
            si, sj = _bucket(sx, sy, bx, by, size, nbx, nby)
            near = -1
            near_d = F32(np.inf)
            for jj in range(max(0, sj - 1), min(nby, sj + 2)):
                for ii in range(max(0, si - 1), min(nbx, si + 2)):
                    w = head[jj, ii]
                    while w >= 0:
                        ex = nodes[w, 0] - sx
                        ey = nodes[w, 1] - sy
                        dd = ex * ex + ey * ey
                        if dd < near_d or (dd == near_d and w < near):
                            near_d = dd
                            near = w
                        w = link[w]
            if not alive[near]:
                continue
            todo = 0
            created = -1
            if F32(math.sqrt(near_d)) < radius:
                origin = here
                todo_a[0] = near
                todo = 1
            else:
                if n == capacity:
                    capacity *= 2
                    link = _grown(link, capacity, -1)
                    first = _grown(first, capacity, -1)
                    queue = _grown(queue, capacity, -1)
                    alive = _grown(alive, capacity, True)
                    nodes = _longer(nodes, capacity)
                created = n
                nodes[n, 0] = sx
                nodes[n, 1] = sy
                nodes[n, 2] = height_near(height, x0, y0, res, sx, sy)
                link[n] = head[sj, si]
                head[sj, si] = n
                n += 1
                origin = here
                todo_a[0] = created
                todo = 1
                if wire_new:
                    # here -> new first, then new -> every live node on its ring (marked by a negative entry)
                    for jj in range(max(0, sj - 1), min(nby, sj + 2)):
                        for ii in range(max(0, si - 1), min(nbx, si + 2)):
                            w = head[jj, ii]
                            while w >= 0:
                                ex = nodes[w, 0] - sx
                                ey = nodes[w, 1] - sy
                                if (
                                    w != created
                                    and alive[w]
                                    and ex * ex + ey * ey <= dist * dist
                                    and todo < 64
                                ):
                                    todo_a[todo] = w
                                    todo += 1
                                w = link[w]
            for t in range(todo):
                a = origin if t == 0 else created
                b = todo_a[t]
                if a == b:
                    continue
                e = first[a]
                known = False
                while e >= 0:
                    if edges[e >> 1, 1 - (e & 1)] == b:
                        known = True
                        break
                    e = chain[e]
                if known:
                    continue
                xa = nodes[a, 0]
                ya = nodes[a, 1]
                dx = nodes[b, 0] - xa
                dy = nodes[b, 1] - ya
                d = F32(math.sqrt(dx * dx + dy * dy))
                if F32(math.atan2(abs(nodes[a, 2] - nodes[b, 2]), d)) > max_slope:
                    continue
                ux = dx / d
                uy = dy / d
                # t = 0 is node a itself, which was found free when it was made
                along = half
                free = True
                while along < d:
                    if disc_blocked(
                        height, xs, ys, x0, y0, res, low, high, k,
                        xa + along * ux, ya + along * uy, radius, limit, share, buffer,
                    ):  # fmt: skip
                        free = False
                        break
                    along = F32(along + half)
                if not free:
                    continue
                r = edge_risk(height, xs, ys, x0, y0, res, xa, ya, nodes[b, 0], nodes[b, 1], radius, True)
                if r < 0.0:
                    continue
                if m == edge_room:
                    edge_room *= 2
                    chain = _grown(chain, 2 * edge_room, -1)
                    risks = _grown(risks, edge_room, 0.0)
                    edges = _longer(edges, edge_room)
                edges[m, 0] = a
                edges[m, 1] = b
                risks[m] = r
                chain[2 * m] = first[a]
                first[a] = 2 * m
                chain[2 * m + 1] = first[b]
                first[b] = 2 * m + 1
                m += 1
            if created >= 0:
                if first[created] < 0:
                    alive[created] = False
                else:
                    queue[q_tail] = created
                    q_tail += 1
    for v in range(n):
        if first[v] < 0:
            alive[v] = False
    return 0, nodes[:n], alive[:n], edges[:m], risks[:m]


@njit(cache=True)
def _grown(values, size, fill):
    out = np.full(size, fill, values.dtype)
    for k in range(len(values)):
        out[k] = values[k]
    return out


@njit(cache=True)
def _longer(table, size):
    out = np.empty((size, table.shape[1]), table.dtype)
    for row in range(len(table)):
        for column in range(table.shape[1]):
            out[row, column] = table[row, column]
    return out


def native_graph(
    grid: ElevationGrid, start: tuple[float, float], params: NativeParams, seed: int
) -> TraversalGraph:
    """The graph grown from x, y [m]. Raises NoRoute where no free root is found near the start."""
    height, origin, res = grid.height, grid.origin, grid.resolution
    rows, cols = height.shape
    xs = (origin[0] + np.arange(cols) * res).astype(np.float32)
    ys = (origin[1] + np.arange(rows) * res).astype(np.float32)
    key = np.random.RandomState(seed).get_state(legacy=True)[1].astype(np.uint32)  # type: ignore[index]
    k = math.floor(float(F32(params.robot_size)) / res + 0.5) + 1
    status, nodes, alive, edges, risk = grow(
        height, xs, ys, origin[0], origin[1], res, *window_minmax(height, k), k, F32(start[0]), F32(start[1]),
        F32(params.expand_dist), F32(params.robot_size), params.sample_num, F32(params.height_threshold),
        params.collision_threshold, key,
    )  # fmt: skip
    if status:
        raise NoRoute(
            NoRouteReason.START_NOT_ON_GRAPH,
            f"no free ground beside the start {start}: begin on open ground",
        )
    index = np.cumsum(alive) - 1
    graph = TraversalGraph.from_edges(nodes[alive], index[edges].astype(np.int32), risk)
    graph.params = params
    return graph


def snapped(
    graph: TraversalGraph, grid: ElevationGrid, start: tuple[float, float], goal: tuple[float, float]
) -> tuple[int, int]:
    """The nodes nearest to start and goal x, y [m], as the paper has it; on a graph that knows its map (a native one
    does not), that no wall separates from them. Raises NoRoute where there is none within 0.5 m."""
    ends = _nearest(graph, grid, start), _nearest(graph, grid, goal)
    if ends[0] is None or ends[1] is None:
        raise NoRoute(NoRouteReason.START_NOT_ON_GRAPH, "no node within 0.5 m of the start or the goal")
    return ends[0], ends[1]


def _nearest(graph: TraversalGraph, grid: ElevationGrid, xy: tuple[float, float]) -> int | None:
    """A wall is a face above the graph's step limit on the straight line."""
    nearest = graph.nearest_node(xy)
    if nearest is None or graph.cells is None:
        return nearest
    d2 = (graph.nodes[:, 0] - xy[0]) ** 2 + (graph.nodes[:, 1] - xy[1]) ** 2
    near = np.flatnonzero(d2 <= SNAP_DISTANCE**2)
    for k in near[np.argsort(d2[near], kind="stable")].tolist():
        if step_on_line(grid, xy, (graph.nodes[k, 0], graph.nodes[k, 1])) <= graph.params.max_step:
            return int(k)
    return None


def step_on_line(grid: ElevationGrid, a: tuple[float, float], b: tuple[float, float]) -> float:
    """Highest face [m] between successive trusted cells on the straight line a -> b."""
    n = int(np.ceil(np.hypot(b[0] - a[0], b[1] - a[1]) / (0.5 * grid.resolution))) + 1
    t = np.linspace(0.0, 1.0, n)
    col, row = (
        np.clip(cells_of(a[k] + t * (b[k] - a[k]), grid.origin[k], grid.resolution), 0, grid.shape[1 - k] - 1)
        for k in (0, 1)
    )
    ok = grid.trusted[row, col]
    z = grid.height[row, col][ok]
    return float(np.abs(np.diff(z)).max(initial=0.0))
