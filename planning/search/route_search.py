"""The cheapest route between the ends of a query, again and again while turns are taken out of the graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planning.risk.body import BodyModel, weights_of
from planning.risk.cost import cost_of
from planning.risk.tables import no_tables
from planning.search.bounds import Asked
from planning.search.endpoints import Endpoints, is_node
from planning.search.explain import Route
from planning.search.pairs import Guide, guide_to, search_pairs
from planning.search.request import PlanRequest


class RouteSearch:
    """What the searches of one query share. Turns that are missing in `at.table.arcs` since the last one only make
    routes dearer, so the bounds of the first lead them all."""

    def __init__(
        self,
        at: Endpoints,
        request: PlanRequest,
        body: BodyModel,
        ends: NDArray[np.bool_],
        exit_cost: NDArray[np.float64],
        xy: tuple[float, float],
        start_yaw: float,
        goal_yaw: float,
    ) -> None:
        """To the end node (nodes,) with the least cost plus `exit_cost` (nodes,), none of which is less than the way to
        `xy` is long. Weighed as `body` does."""
        self.expanded = 0
        """States that the last search looked at."""
        self._at, self._request, self._body, self._xy = at, request, body, xy
        sweeps = request.variant != "edge-only"
        self._asked = Asked(
            at.start,
            ends,
            exit_cost,
            start_yaw,
            goal_yaw,
            sweeps,
            not is_node(request.start),
            request.rules.backward if sweeps else np.inf,
            request.rules.turning,
        )
        self._guide: Guide | None = None
        self._shared = body == at.table.body
        """Other weights than those of the table are for this query alone."""
        self._tables = at.table.tables if self._shared else no_tables(at.table.arcs.target.size)

    def cheapest(self) -> Route | None:
        """The route over the turns that there are now."""
        asked, table = self._asked, self._at.table
        if asked.is_end[asked.start]:
            cost, route, self.expanded = 0.0, np.empty(0, np.int64), 0
        elif self._request.variant == "native":
            cost, route, self.expanded = self._over_nodes()
        else:
            cost, route = self._over_pairs()
        if not np.isfinite(cost):
            return None
        rules = self._request.rules
        return Route.along(table, asked.start, route, asked.start_yaw, asked.goal_yaw, rules)

    def _over_pairs(self) -> tuple[float, NDArray[np.int64]]:
        """Cost and states of the best route over pairs of nodes."""
        asked, table, old = self._asked, self._at.table, self._guide is not None
        while True:
            on = table.sampler, weights_of(self._body), table.arcs, self._tables
            guide = self._guide or guide_to(*on, asked, *self._xy)
            cost, route, self.expanded, turns, self._guide = search_pairs(*on, asked, guide)
            self._tables = self._tables._replace(turns=turns)
            if np.isfinite(cost) or not old:
                break
            self._guide, old = None, False  # there may be one over states that the old one did not settle
        if self._shared:
            table.tables = self._tables
        return cost, route

    def _over_nodes(self) -> tuple[float, NDArray[np.int64], int]:
        """Cost, states and number of reached nodes of the best route over nodes: the native cost l (1 + sigma r) knows
        no headings."""
        asked, arcs = self._asked, self._at.table.arcs
        cost = cost_of(weights_of(self._body), arcs.length, arcs.risk, 0.0, 0.0) + arcs.price[:, 0]
        edges = csr_array((cost, arcs.target, arcs.indptr), shape=(len(arcs.x), len(arcs.x)))
        way, before = dijkstra(edges, indices=asked.start, return_predecessors=True)
        whole = np.where(asked.is_end, way + asked.exit_cost, np.inf)
        node = int(np.argmin(whole))
        slots: list[int] = []
        while np.isfinite(way[node]) and node != asked.start:
            first, last = arcs.indptr[before[node]], arcs.indptr[before[node] + 1]
            slots.insert(0, int(first) + int(np.flatnonzero(arcs.target[first:last] == node)[0]))
            node = int(before[node])
        return float(whole.min()), 2 * np.array(slots, np.int64), int(np.isfinite(way).sum())
