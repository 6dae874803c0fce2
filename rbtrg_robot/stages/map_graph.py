"""The map of now and the one graph on it, as the planner keeps them: a changed block of the map rebuilds only what it
touches."""

from __future__ import annotations

import numpy as np

from hal.safety.geofence import NO_FENCE, Fence
from mapping.elevation.exchange import MapError, MapPatch
from mapping.elevation.mirror import MapMirror, window_of
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.risk.terrain import Terrain
from planning.search.plan import Plan, PlanRequest, plan
from planning.search.to_go import way_to_go
from rbtrg_robot.stages.walls import wall_up, windows

WHOLE_CELLS = 500_000
"""Cells of a map on which a whole graph is drawn anew: up to 0.4 s. On larger ones other nodes are drawn in places."""
REDRAWN_AROUND = 5.0
"""[m] around such a place."""
MANY_TILES = 100
"""Tiles, 650 m^2: a graph on so much new ground takes half a second."""
Box = tuple[int, int, int, int]
"""Lattice cells: first row, first column, row and column after the last."""


class MapGraph:
    """Patches in, `sync`, routes out."""

    def __init__(self, params: GraphParams, body: BodyModel, seed: int) -> None:
        """`seed` of the graph's samples."""
        self.params = params
        self.seed = seed
        self.mirror = MapMirror()
        self.window: MapPatch | None = None
        """The newest surroundings of the robot, while they are newer than the mirror and block the path."""
        self.graph: TraversalGraph | None = None
        self.grid: ElevationGrid | None = None
        self.table: RiskTable | None = None
        self.body = body
        self.fence: Fence = NO_FENCE
        """Walls in the grid; see `enclose`."""
        self._overlaid: Box | None = None
        """Part of the newest grid where the window lies over the mirror."""
        self._changed: list[Box] = []
        self._synced = -1, 0
        """Epoch and tiles of the mirror at the last `sync`."""
        self._first: tuple[float, float] | None = None
        """Start of the first graph: only around it unseen ground is assumed drivable."""

    @property
    def known(self) -> bool:
        """A map was received."""
        return self.mirror.known

    @property
    def stale(self) -> bool:
        """The map has changed since `sync`."""
        return bool(self._changed)

    @property
    def much_is_new(self) -> bool:
        """An answer would take long: `sync` and `prepare` do most of it before one is asked for."""
        epoch, tiles = self._synced
        followed = self.graph is not None and epoch == self.mirror.epoch
        return len(self.mirror) > (tiles if followed else 0) + MANY_TILES

    def apply(self, patch: MapPatch) -> None:
        """Take a block. Raises MapError."""
        window = self.mirror.apply(patch)
        if window.rows and window.cols:
            self._changed.append((window.row, window.col, window.row + window.rows, window.col + window.cols))
        if self.window is not None and self.mirror.stamp >= self.window.stamp:
            self.window = None

    def enclose(self, fence: Fence) -> None:
        """From the next `sync` on this fence stands around what is planned on, in place of the one before."""
        if self.known and fence != self.fence:
            for one in (self.fence, fence):
                self._changed += windows(one, self.mirror.resolution)
        self.fence = fence

    def sync(self, start: tuple[float, float]) -> bool:
        """Bring grid and graph to the newest map. False where the window does not lie on it; it is dropped then."""
        if not self.known:
            return True
        changed = self._changed
        if self._overlaid is not None:
            changed.append(self._overlaid)
            self._overlaid = None
        fits = True
        if self.window is not None and self.window.epoch < self.mirror.epoch:
            self.window = None
        if self.window is not None:
            try:
                if abs(self.window.resolution - self.mirror.resolution) > 1e-9:
                    raise MapError("the window has cells of another size than the map")
                over = window_of(self.window)
                self._overlaid = (over.row, over.col, over.row + over.rows, over.col + over.cols)
                changed.append(self._overlaid)
            except MapError:
                self.window, fits = None, False
        view = self.mirror.view(start, self.window)
        self.mirror.stay_within(view)
        self._changed, self._synced = [], (self.mirror.epoch, len(self.mirror))
        if not (view.rows and view.cols):  # the robot stands far from all that was seen
            self.graph = self.grid = None
            return fits
        grid = self.mirror.grid(view, self.window)
        wall_up(grid, self.fence)
        self.refresh(
            start,
            grid,
            [(r0 - view.row, c0 - view.col, r1 - view.row, c1 - view.col) for r0, c0, r1, c1 in changed],
        )
        return fits

    def refresh(self, start: tuple[float, float], grid: ElevationGrid, windows: list[Box]) -> None:
        """Bring the graph to a grid that differs in `windows` from the one before."""
        self.grid = grid
        try:
            if self.graph is None:
                self.graph = TraversalGraph.build(grid, start, self.params, self.seed, self._first)
                self._first = self.graph.first_xy
            else:
                self.graph.update(grid, windows, start)
        except PlanningError:
            # No ground under the robot in this map (yet), or its cells moved: the next update or request begins anew.
            self.graph = None

    @property
    def sampled(self) -> int:
        """Cells of the map on which `sample_anew` draws other nodes, at most."""
        grid = self.ground()
        size, place = grid.height.size, (2.0 * REDRAWN_AROUND / grid.resolution) ** 2
        return size if size <= WHOLE_CELLS else min(size, 3 * round(place))

    def sample_anew(self, start: tuple[float, float], goal: tuple[float, float]) -> None:
        """A passage hardly wider than the robot may hold no edge of this graph: another one from other samples takes
        its place. On a large map these are other ones
        around the robot at `start`, around the node that is nearest to the goal on the way that walls leave open, and
        around the `goal` x, y [m] alone."""
        grid, graph = self.ground(), self.graph
        self.seed += 1
        if graph is None or grid.height.size <= WHOLE_CELLS:
            self.graph = None
            self.sync(start)
            return
        nodes = graph.nodes[:, :2]
        line = np.hypot(*(nodes - goal).T)
        end = nodes[np.lexsort((line, way_to_go(grid, nodes, goal)))[:1]]
        self.graph = graph.redrawn(
            grid, np.vstack([start, end, goal]), REDRAWN_AROUND, self.seed - graph.seed
        )

    def ground(self) -> ElevationGrid:
        """The grid of the graph. Raises NoRoute."""
        if self.graph is None or self.grid is None:
            raise NoRoute(
                NoRouteReason.NO_TERRAIN,
                "no ground around the robot is known yet: wait for the LiDAR, or drive it by hand, slowly, "
                "onto ground that it sees",
            )
        return self.grid

    def terrain(self) -> Terrain | None:
        """That of the grid, where a search has made it."""
        return self.table.terrain if self.table is not None and self.table.grid is self.grid else None

    def search(self, request: PlanRequest, avoid: np.ndarray | None = None) -> Plan:
        """The route of RB-TRG. `avoid`: (n, 3) x, y, radius [m]; where the robot stands in one of them already, it
        counts no more: no way would lead out
        of it. Raises PlanningError."""
        grid = self.ground()
        assert self.graph is not None
        discs = np.empty((0, 3)) if avoid is None else avoid
        discs = discs[np.hypot(*(discs[:, :2] - request.start).T) > discs[:, 2]]
        graph = self.graph.avoiding(discs) if len(discs) else self.graph
        return plan(graph, grid, request, self.body, self._table_on(graph, grid))

    def prepare(self) -> None:
        """Evaluate all edges of the graph: on 100 x 100 m most of what a first search takes. It changes no result."""
        if self.graph is not None and self.grid is not None:
            self._table_on(self.graph, self.grid).evaluate_edges()

    def _table_on(self, graph: TraversalGraph, grid: ElevationGrid) -> RiskTable:
        if self.table is None or not self.table.fits(graph, grid, self.body):
            self.table = RiskTable(graph, grid, self.body, self.table)
        return self.table
