"""The bounds that guide the search: equal to plain searches, and tight enough to leave little to evaluate."""

from __future__ import annotations

import numpy as np
import pytest

from planning.graph.describe import turn_is_free
from planning.risk.body import BodyModel, weights_of
from planning.risk.pose_sets import turn_angle
from planning.risk.table import RiskTable
from planning.risk.turns import may_turn_to, turn_cost
from planning.search.bounds import Asked, begin_to_go, cost_to_come, cost_to_go
from planning.search.plan import DriveRules, PlanRequest, plan
from tests.planning.worlds import lattice, rough

BODY = BodyModel()
W = weights_of(BODY)
YAWS = (-2.4, 0.8)
RULES = DriveRules(backward=1.2, turning=0.3)


@pytest.fixture(scope="module")
def world():
    grid = rough(5, size=3.0, resolution=0.1)
    graph = lattice(grid, 0.55, seed=2)
    rng = np.random.default_rng(4)
    graph.price = rng.exponential(0.2, graph.price.shape).astype(np.float32)
    graph.turn_price = rng.exponential(1.0, graph.turn_price.shape).astype(np.float32)
    return grid, graph


def table_of(world):
    """A table with every edge evaluated, a start, and two ends with what is left beyond them."""
    grid, graph = world
    table = RiskTable(graph, grid, BODY)
    table.evaluate_edges()
    last = len(graph.nodes) - 1
    is_end = np.zeros(last + 1, np.bool_)
    is_end[[last, last - 4]] = True
    beyond = np.hypot(*(graph.nodes[:, :2] - graph.nodes[last, :2]).T)
    return table, 0, is_end, beyond


def steps_of(a, edge, least=False):
    """(slots, 2) cost of each edge, forward and backward, without turns; (slots,) a bound of both."""
    ahead = a.length * (
        1.0 + W.native * a.risk.astype(np.float64) + W.body * edge[:, 0] + W.unknown * edge[:, 1]
    )
    if least:
        return ahead + a.price.min(axis=1)
    return np.column_stack([ahead, ahead * RULES.backward]) + a.price


def plain_cost(a, start, step):
    """(nodes,) least cost from `start` over edges that cost `step` (slots,)."""
    want, before = np.full(len(a.x), np.inf), np.zeros(len(a.x))
    want[start] = 0.0
    while not np.array_equal(before, want):
        before = want.copy()
        np.minimum.at(want, a.target, want[a.source] + step)
    return want


def test_cost_to_come_is_plain_dijkstra_where_it_settled_and_a_bound_elsewhere(world):
    table, start, is_end, beyond = table_of(world)
    want = plain_cost(table.arcs, start, steps_of(table.arcs, table.tables.edge, least=True))
    a = table.arcs
    goal = table.graph.nodes[-1, :2]
    total, got = cost_to_come(
        table.sampler, W, a, table.tables, start, is_end, beyond, float(goal[0]), float(goal[1])
    )
    assert total == pytest.approx((want + beyond)[is_end].min())
    assert (got <= want + 1e-9).all()
    settled = want + beyond < total - 1e-9
    np.testing.assert_allclose(got[settled], want[settled], atol=1e-9)


@pytest.mark.parametrize("start", [0, 3, 6, 9])
def test_cost_to_go_is_exact_on_all_states_that_may_be_on_the_best_route(world, start):
    table, _, is_end, beyond = table_of(world)
    a, step = table.arcs, steps_of(table.arcs, table.tables.edge)
    states = 2 * len(a.target)
    heading = np.column_stack([a.heading, a.heading + np.pi]).ravel()
    own = step.ravel().copy()
    for s in range(states):
        k = a.target[s // 2]
        if is_end[k]:
            d = turn_angle(heading[s], YAWS[1])
            own[s] += (
                turn_cost(*a.turn_price[k], d, RULES.turning)
                if may_turn_to(a.room[k], heading[s], d)
                else np.inf
            )

    def turned(node, before, after):
        d = turn_angle(before, after)
        free = turn_is_free(a.room[node], before, d)
        return turn_cost(*a.turn_price[node], d, RULES.turning) if free else np.inf

    pairs = np.array([
        (s, 2 * o + way)
        for s in range(states)
        for o in range(a.indptr[a.target[s // 2]], a.indptr[a.target[s // 2] + 1])
        for way in (0, 1)
    ])  # fmt: skip
    turns = np.array([turned(a.target[s // 2], heading[s], heading[o]) for s, o in pairs])
    ends = a.target[np.arange(states) // 2]
    want, before = np.where(is_end[ends], beyond[ends], np.inf), np.zeros(states)
    while not np.array_equal(before, want):
        before = want.copy()
        np.minimum.at(want, pairs[:, 0], turns + own[pairs[:, 1]] + before[pairs[:, 1]])
    tables, come = table.tables, np.zeros(len(a.x))
    asked = Asked(start, is_end, beyond, *YAWS, True, False, RULES.backward, RULES.turning)
    go, heap = begin_to_go(W, a, tables, is_end, beyond, come, RULES.backward)
    least, heap = cost_to_go(table.sampler, W, a, tables, asked, come, go, heap, np.inf)
    for limit in (least, 1.1 * least):
        if limit > least:
            _, heap = cost_to_go(table.sampler, W, a, tables, asked, come, go, heap, limit)
        np.testing.assert_allclose(go.h[go.settled], want[go.settled], atol=1e-9)
        assert go.settled[want + own < limit - 1e-9].all()
        assert not go.settled[want + step.ravel() > limit + 1e-9].any(), "the last turn is not in its bound"
    first = [s for s in range(states) if a.source[s // 2] == start]
    assert least == pytest.approx(min(turned(start, YAWS[0], heading[s]) + own[s] + want[s] for s in first))


def test_the_search_expands_little_where_turns_cost_much(world):
    grid, graph = world
    rules = DriveRules(backward=1.2, turning=1.0)
    got = plan(graph, grid, PlanRequest(0, len(graph.nodes) - 1, *YAWS, rules=rules), BODY)
    assert got.expanded <= 3 * len(got.nodes), "the bound knows what turns cost"
