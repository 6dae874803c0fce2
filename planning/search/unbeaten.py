"""Whether what is left of the route that is driven can be kept without a search: no route of the graph can be clearly better.

The last search to the goal knows what it costs at least to come to each node, and from there to the goal (`planning.search.bounds`). A route
of now that touches nothing that has changed since costs what it did then, so those costs bound it. One that touches something comes to the first such
node, and goes on from the last, over what has not changed, and in between it is at least as long as the straight line. What has become dearer makes no other
route better. So a search that could not find anything the robot would change to (`planning.search.frontier.worth_keeping`) is
left out. Making a route straight is taken to win no greater share of its cost than it won on the route that the last search found.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.graph import SNAP_DISTANCE, TraversalGraph
from planning.risk.arcs import Arcs
from planning.risk.body import weights_of
from planning.risk.cost import Weights, transition_cost
from planning.risk.table import RiskTable
from planning.search.again import Found, Search, key_of
from planning.search.attach import XY, Ground, with_places
from planning.search.bounds import ToGo, drive_cost
from planning.search.endpoints import is_node, on_map, position
from planning.search.explain import describe
from planning.search.frontier import SWITCH_LEAST, SWITCH_SHARE, in_doubt
from planning.search.keep import Left, rest
from planning.search.request import Plan, PlanRequest

PAIRS = 1_000_000
"""So many pairs of changed nodes are looked at; where more has changed the search is made."""


def unbeaten(
    table: RiskTable, request: PlanRequest, start_yaw: float, goal_yaw: float
) -> tuple[Plan | None, Left | None]:
    """The rest of `request.driven`, if it leads to the goal, can be driven, and no route of the graph can be clearly better; None: search. And what is known of
    that rest for the search, if anything."""
    graph, grid, body, rules = table.graph, table.grid, table.body, request.rules
    search = table.searched
    if request.driven is None or request.variant != "full" or is_node(request.start) or is_node(request.goal):
        return None, None
    if not isinstance(search, Search) or (known := search.found) is None or known.graph is not graph:
        return None, None
    start, goal = position(graph, request.start, "start"), position(graph, request.goal, "goal")
    if not (graph.knows(grid) and on_map(grid, start) and on_map(grid, goal)):
        return None, None
    ground = Ground(graph, grid, (*start, start_yaw), request.held)
    end = ground.end_near(goal, SNAP_DISTANCE)
    if end is None or (search.arcs.x[-1], search.arcs.y[-1]) != end:
        return None, None
    if search.key != key_of(body, *end, 0.0, goal_yaw, True, True, rules.backward, rules.turning):
        return None, None
    changed = changed_nodes(graph, known.version)
    here = np.hypot(*(graph.nodes[changed, :2] - end).T)
    if math.dist(start, end) <= 2.0 * ground.reach or (here <= 2.0 * ground.reach).any():
        return None, None  # the last leg may have changed
    nodes = with_places(graph, grid, [start, end])
    route = rest(
        ground, table.sampler, body, nodes, request, (len(nodes) - 2, len(nodes) - 1), (start, end), start_yaw, goal_yaw,
        ground.back_cost(start, start_yaw),
    )  # fmt: skip
    if route is None:
        return None, None
    found = describe(nodes, request, body, route, 0)
    left = Left(ground, route, found)
    if in_doubt(graph, found):
        return None, left
    better = (found.cost - max(SWITCH_LEAST, SWITCH_SHARE * found.cost)) / known.straight
    if not all_cost_more(better, ground, start, changed, search, weights_of(body), rules.backward):
        return None, left
    return replace(found, exact=True, short=math.dist(end, goal), kept=True), left


def all_cost_more(
    limit: float,
    ground: Ground,
    start: XY,
    changed: NDArray[np.int64],
    search: Search,
    w: Weights,
    backward: float,
) -> bool:
    """Whether each route of the graph from `start` costs more than `limit` [m]."""
    known, graph, legs = search.found, ground.graph, ground.spot(start)
    if known is None or not len(legs.nodes):
        return False
    xy = graph.nodes[:, :2]
    leg = [
        transition_cost(w, math.dist(start, xy[k]), float(r), 0.0, 0.0)
        for k, r in zip(legs.nodes, legs.risk[:, 0], strict=True)
    ]
    then = _node_of(search.ids, graph.node_ids[legs.nodes])
    if (np.array(leg) + _least_on(w, search, known, backward, then)).min() <= limit:
        return False
    # A way from here to a node costs no less than from where the robot was then, but for what it has come nearer.
    nearer = np.inf
    was = then[then >= 0]
    if len(was) and _come_is_known(search, known, was).all():
        nearer = float((known.come[was] - np.array(leg)[then >= 0]).max())
    then = _node_of(search.ids, graph.node_ids[changed])
    first = np.hypot(*(xy[changed] - start).T)
    first = np.maximum(first, np.where(then >= 0, known.come[then] - nearer, 0.0))
    # A node that is new is reached and left over changed ones, but for a leg.
    begins = (then >= 0) | np.isin(changed, legs.nodes)
    last = _least_on(w, search, known, backward, then)
    return bool(_pairs_cost_more(xy[changed], np.where(begins, first, np.inf), last, limit, PAIRS))


def _node_of(ids: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) index of each of the `wanted` ids in `ids`; -1: none."""
    order = np.argsort(ids, kind="stable")
    at = order[np.searchsorted(ids, wanted, sorter=order).clip(max=len(ids) - 1)]
    return np.where(ids[at] == wanted, at, -1)


def _come_is_known(search: Search, known: Found, nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n,) whether `Found.come` is what it cost to come to each of the nodes, and not a bound (`cost_to_come`)."""
    x, y = search.arcs.x, search.arcs.y
    bound = known.come[-1] - np.hypot(x[nodes] - x[-1], y[nodes] - y[-1])
    return known.come[nodes] < bound - 1e-6


def _least_on(
    w: Weights, search: Search, known: Found, backward: float, nodes: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(n,) what it cost at least to go on to the goal from each of the nodes; inf of one that was not there (-1)."""
    return _least_of(w, search.arcs, search.edge, search.go, known.come, known.beyond, backward, nodes)


@njit(cache=True)
def _least_of(
    w: Weights,
    arcs: Arcs,
    edge: np.ndarray,
    go: ToGo,
    come: np.ndarray,
    beyond: float,
    backward: float,
    nodes: np.ndarray,
) -> np.ndarray:
    _, _, indptr, source, target, _, length, _, risk, _, _, forward_only = arcs
    h, settled = go.h, go.settled
    ways = 1 if np.isinf(backward) else 2
    out = np.full(nodes.size, np.inf)
    for k in range(nodes.size):
        at = nodes[k]
        if at < 0:
            continue
        rest = max(beyond - come[at], 0.0)  # over a state that was not settled
        for slot in range(indptr[at], indptr[at + 1]):
            for way in range(ways):
                state = 2 * slot + way
                cost = rest
                if settled[state]:
                    cost = h[state] + drive_cost(
                        w, length, risk, source, target, forward_only, edge, slot, way, backward
                    )
                out[k] = min(out[k], cost)
    return out


@njit(cache=True)
def _pairs_cost_more(xy: np.ndarray, first: np.ndarray, last: np.ndarray, limit: float, most: int) -> bool:
    """Whether coming to one node, a straight line to another (or the same), and going on from there costs more than `limit` for all of them.

    False where that is to be asked of more than `most` pairs.
    """
    if first.size == 0:
        return True
    begin = np.flatnonzero(first + last.min() <= limit)
    end = np.flatnonzero(last + first.min() <= limit)
    if begin.size * end.size > most:
        return False
    for i in begin:
        for j in end:
            if first[i] + np.hypot(xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]) + last[j] <= limit:
                return False
    return True


def changed_nodes(graph: TraversalGraph, version: int) -> NDArray[np.int64]:
    """Nodes whose ground has changed since `version`, and both ends of edges under which it has."""
    nodes: NDArray[np.int64] = _changed(
        graph.node_revision, graph.edge_revision, graph.indptr, graph.indices, version
    )
    return nodes


@njit(cache=True)
def _changed(
    node_revision: np.ndarray, edge_revision: np.ndarray, indptr: np.ndarray, target: np.ndarray, version: int
) -> np.ndarray:
    changed = node_revision > version
    for i in range(indptr.size - 1):
        for slot in range(indptr[i], indptr[i + 1]):
            if edge_revision[slot] > version:
                changed[i] = changed[target[slot]] = True
    return np.flatnonzero(changed)
