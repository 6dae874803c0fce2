"""The Traversal Risk Graph: where the robot may stand and which straight moves connect those places.

After Lee et al., "TRG-planner" (RA-L 2025). The graph as that planner was released, its defects included, is in
`tools/baselines/native.py`, for comparison with published figures.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.cells import Cells
from planning.graph.describe import ALL_HEADINGS
from planning.graph.lattice import Lattice
from planning.graph.params import GraphParams, Window, changed_windows, checked_start

__all__ = ["GraphParams", "TraversalGraph"]

SNAP_DISTANCE = 0.50
"""Endpoints farther than this from every node [m] are not on the graph."""


class TraversalGraph:
    """Nodes on the ground and undirected edges with a native risk, as CSR over both directions.

    Arrays are replaced, never written to, when the graph changes; `version` rises with each change.

    Attributes:
        nodes: (n, 3) float64 x, y, z in the grid's frame [m].
        indptr: (n + 1,) int64; the edges that leave node i are `indptr[i]:indptr[i + 1]`, targets ascending.
        indices: (nnz,) int32 target nodes.
        risk: (nnz,) float32 native risk.
        price: (nnz, 2) float32 [m] what driving the edge forward and backward costs beyond eq. 5, by the controller's
            envelope (`planning.graph.prices`).
        frontier: (n,) bool, terrain not seen yet begins within about one `expand_dist` of the robot's front there.
        turn_price: (n, 2) float32 [m/rad] of a bend and of a turn on the spot at the node, by the envelope; 0 where not
            known (`from_edges`).
        free_headings: (n,) uint64, bit h set where the footprint at heading h * 5 deg (the same turned by 180 deg) is
            clear of obstacles at the node; `planning.graph.describe.turn_is_free` reads it. All set where not known.
        node_ids: (n,) int64, the same place keeps its id over updates; never reused for another place.
        version: int, 1 after a build.
    """

    nodes: NDArray[np.float64]
    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    risk: NDArray[np.float32]
    price: NDArray[np.float32]
    frontier: NDArray[np.bool_]
    turn_price: NDArray[np.float32]
    free_headings: NDArray[np.uint64]
    node_ids: NDArray[np.int64]

    def __init__(
        self,
        params: GraphParams,
        seed: int,
        start_xy: tuple[float, float] | None,
        first_xy: tuple[float, float] | None = None,
    ) -> None:
        self.params = params
        self.seed = int(seed)
        self.start_xy = start_xy
        self.first_xy = start_xy if first_xy is None else first_xy
        self.version = 0
        self._lattice: Lattice | None = None
        self.cells: Cells | None = None
        """What the graph knows of the map it was built on; None for those not built here."""
        self._discs = np.empty((0, 3))

    # -- making one ---------------------------------------------------------------------------------------------

    @classmethod
    def build(
        cls,
        grid: ElevationGrid,
        start_xy: tuple[float, float],
        params: GraphParams | None = None,
        seed: int = 0,
        first_xy: tuple[float, float] | None = None,
    ) -> TraversalGraph:
        """The graph of all terrain reachable from within one move of `start_xy` [m]. Same arguments, same graph.

        Unseen ground within `blind_radius` of `first_xy` counts as seen if no step separates it from there. `first_xy`
        is where the robot stood first (None: at `start_xy`). A graph that replaces another gets the place of the first.

        Raises:
            NoRoute: the grid has no trusted cell, or the start is off the map or on no valid ground.
            PlanningError: an argument has the wrong type or is not finite.
        """
        params = params or GraphParams()
        start = checked_start(grid, start_xy)
        graph = cls(params, seed, start, first_xy)
        if not graph._refresh(grid, ()):
            raise NoRoute(
                NoRouteReason.START_NOT_ON_GRAPH,
                f"no drivable ground within one move of {start}: drive the robot by hand, slowly, onto open ground "
                "that it sees",
            )
        return graph

    @classmethod
    def from_edges(
        cls,
        nodes: NDArray[np.floating],
        edges: NDArray[np.integer],
        risk: NDArray[np.floating],
        frontier: NDArray[np.bool_] | None = None,
    ) -> TraversalGraph:
        """A graph from arrays: nodes (n, 3) [m], undirected edges (m, 2), risk (m,), the same there and back. It cannot
        be updated."""
        nodes = np.ascontiguousarray(nodes, dtype=np.float64)
        edges = np.asarray(edges)
        risk = np.asarray(risk, dtype=np.float32)
        if nodes.ndim != 2 or nodes.shape[1] != 3 or not np.isfinite(nodes).all():
            raise PlanningError(f"nodes must be finite with shape (n, 3), got shape {nodes.shape}")
        if edges.shape != (len(risk), 2) or not np.issubdtype(edges.dtype, np.integer):
            raise PlanningError(
                f"edges must be integers of shape ({len(risk)}, 2), got {edges.dtype} {edges.shape}"
            )
        if len(edges) and (edges.min() < 0 or edges.max() >= len(nodes)):
            raise PlanningError(f"edges name nodes outside 0..{len(nodes) - 1}")
        graph = cls(GraphParams(), 0, None)
        n = len(nodes)
        graph._publish(nodes, edges, risk, None, frontier, None, None, np.arange(n))
        return graph

    def _refresh(self, grid: ElevationGrid, windows: Sequence[Window], force: bool = False) -> bool:
        """Recompute the lattice in `windows` and publish what is reachable; False if nothing was there to do."""
        assert self.start_xy is not None
        assert self.first_xy is not None
        if self._lattice is None:
            self._lattice = Lattice(self.params, self.seed, self.first_xy)
        before = self.node_ids if self.version else np.empty(0, dtype=np.int64)
        if not self._lattice.refresh(grid, windows) and not force:
            return False
        self.cells = self._lattice.cells
        built = self._lattice.reachable(grid, self.start_xy, before)
        self._publish(*built)
        return len(self.nodes) > 0

    def _publish(
        self,
        nodes: NDArray[np.floating],
        edges: NDArray[np.integer],
        risk: NDArray[np.floating],
        price: NDArray[np.float32] | None,
        frontier: NDArray[np.bool_] | None,
        turn_price: NDArray[np.float32] | None,
        free_headings: NDArray[np.uint64] | None,
        ids: NDArray[np.integer],
    ) -> None:
        """Set all public arrays from an undirected edge list (m, 2), its price (m, 2, 2) there and back, and raise
        `version`."""
        n = len(nodes)
        source = np.concatenate([edges[:, 0], edges[:, 1]]).astype(np.int64)
        target = np.concatenate([edges[:, 1], edges[:, 0]]).astype(np.int64)
        order = np.argsort(source * max(n, 1) + target, kind="stable")
        self.nodes = np.ascontiguousarray(nodes, dtype=np.float64)
        self.indptr = np.concatenate([[0], np.cumsum(np.bincount(source, minlength=n))]).astype(np.int64)
        self.indices = target[order].astype(np.int32)
        self.risk = np.tile(np.asarray(risk, dtype=np.float32), 2)[order]
        if price is None:
            price = np.zeros((len(edges), 2, 2), np.float32)
        self.price = np.ascontiguousarray(price.transpose(1, 0, 2).reshape(-1, 2)[order])
        self.node_ids = np.asarray(ids, dtype=np.int64)
        self.frontier = (
            np.zeros(n, dtype=np.bool_) if frontier is None else np.asarray(frontier, dtype=np.bool_)
        )
        self.turn_price = (
            np.zeros((n, 2), np.float32) if turn_price is None else np.asarray(turn_price, np.float32)
        )
        self.free_headings = np.full(n, ALL_HEADINGS) if free_headings is None else free_headings
        self.version += 1

    # -- asking it ----------------------------------------------------------------------------------------------

    @property
    def edges(self) -> NDArray[np.int64]:
        """(m, 2) undirected edges, lower index first, in CSR order."""
        source = np.repeat(np.arange(len(self.nodes)), np.diff(self.indptr))
        keep = source < self.indices
        return np.stack([source[keep], self.indices[keep].astype(np.int64)], axis=1)

    def costs(self, sigma: float, *, back: bool = False) -> NDArray[np.float64]:
        """(nnz,) [m] of each edge without the body's risk, driven forward: l (1 + sigma r) and its price; `back`: of
        the same edge from its target to its source."""
        source = np.repeat(np.arange(len(self.nodes)), np.diff(self.indptr))
        length = np.hypot(*(self.nodes[source, :2] - self.nodes[self.indices, :2]).T)
        price = self.price[:, 0]
        if back:
            price = price[np.lexsort((source, self.indices))]  # slot of the opposite direction of each slot
        return length * (1.0 + sigma * self.risk) + price

    def ways(self, cost: NDArray[np.float64], node: int) -> NDArray[np.float64]:
        """(n,) least sum of `cost` (nnz,) [m] over the edges from a node to each; infinite where no way leads."""
        edges = csr_array((cost, self.indices, self.indptr), shape=(len(self.nodes), len(self.nodes)))
        return np.asarray(dijkstra(edges, indices=node))

    def nearest_node(self, xy: tuple[float, float], max_distance: float = SNAP_DISTANCE) -> int | None:
        """Index of the node nearest to x, y [m] (lowest index on a tie), None if farther than `max_distance`."""
        x, y = float(xy[0]), float(xy[1])
        if not (np.isfinite(x) and np.isfinite(y)):
            raise NoRoute(
                NoRouteReason.BAD_INPUT, f"the position ({x}, {y}) is not finite: give x, y in metres"
            )
        if not len(self.nodes):
            return None
        d2 = (self.nodes[:, 0] - x) ** 2 + (self.nodes[:, 1] - y) ** 2
        best = int(np.argmin(d2))
        return best if d2[best] <= max_distance**2 else None

    def knows(self, grid: ElevationGrid) -> bool:
        """Whether the graph was last built on this map (its extent) and can test moves on it."""
        c = self.cells
        return c is not None and (c.shape, c.origin, c.res) == (grid.shape, grid.origin, grid.resolution)

    def avoiding(self, discs: NDArray[np.floating]) -> TraversalGraph:
        """This graph, for a query, without the edges that touch any of the discs (k, 3): x, y, radius [m]."""
        source = np.repeat(np.arange(len(self.nodes)), np.diff(self.indptr))
        a, b = self.nodes[source, :2], self.nodes[self.indices, :2]
        keep = np.ones(len(source), dtype=np.bool_)
        for disc in discs:
            keep &= _clear(a, b, disc)
        out = copy.copy(self)
        out._lattice, out._discs = None, np.asarray(discs, np.float64)
        out.indptr = np.concatenate([[0], np.cumsum(np.bincount(source[keep], minlength=len(self.nodes)))])
        out.indices, out.risk, out.price = self.indices[keep], self.risk[keep], self.price[keep]
        return out

    def allows(self, places: NDArray[np.float64]) -> bool:
        """Whether the straight moves between places (n, 2) touch no disc that is to be avoided."""
        return all(_clear(places[:-1], places[1:], disc).all() for disc in self._discs)

    def redrawn(
        self, grid: ElevationGrid, places: NDArray[np.floating], reach: float, sample: int
    ) -> TraversalGraph:
        """This graph with nodes from another `sample` (0: those of the build) within `reach` [m] along x and y of each
        of the `places` (n, 2), on the map that it was last built on; nothing of this one changes. A passage hardly
        wider than the robot may hold no edge of one sample.
        """
        if self._lattice is None or self.start_xy is None or not self.knows(grid):
            raise PlanningError("only a graph that was built on this map can be drawn anew in places")
        out = copy.copy(self)
        out._lattice = copy.copy(self._lattice)
        out.cells = out._lattice.cells = self._lattice.cells.copy()
        out._lattice.redraw(grid, np.hstack([places - reach, places + reach]), sample)
        out._publish(*out._lattice.reachable(grid, checked_start(grid, self.start_xy), self.node_ids))
        return out

    # -- keeping it up to date ----------------------------------------------------------------------------------

    def update(
        self, grid: ElevationGrid, changed: Sequence[Window], start_xy: tuple[float, float] | None = None
    ) -> bool:
        """Rebuild the part of the graph whose terrain changed; True if the graph is not the same as before.

        `grid` is the whole map as it is now; it may have grown since the last call (same resolution, cells aligned).
        `changed` tells where it differs: windows (row0, col0, row1, col1), ends exclusive. Cells that the previous grid
        did not have count as changed by themselves. `start_xy` is where the robot is now [m]: the graph holds what is
        reachable from there (None: from where it was).
        """
        if self.start_xy is None:
            raise PlanningError("a graph made from edges has no map to update it from")
        start = checked_start(grid, self.start_xy if start_xy is None else start_xy)
        windows = changed_windows(grid, changed)
        before = (self.node_ids, self.indices)
        moved = start != self.start_xy
        self.start_xy = start
        if not self._refresh(grid, windows) and moved and self.nearest_node(start) is None:
            self._refresh(grid, (), force=True)
        return not (np.array_equal(before[0], self.node_ids) and np.array_equal(before[1], self.indices))


def _clear(a: NDArray[np.float64], b: NDArray[np.float64], disc: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(n,) whether the straight lines a -> b (n, 2) stay out of a disc x, y, radius [m]."""
    ab, ac = b - a, np.asarray(disc[:2]) - a
    along = np.clip((ac * ab).sum(1) / np.maximum((ab * ab).sum(1), 1e-12), 0.0, 1.0)
    away: NDArray[np.bool_] = np.hypot(*(ac - along[:, None] * ab).T) > disc[2]
    return away
