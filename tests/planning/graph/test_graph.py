"""The graph's container: CSR, the nearest node, typed errors."""

from __future__ import annotations

import numpy as np
import pytest

from planning import NoRoute, PlanningError
from planning.graph.graph import TraversalGraph

NODES = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.2], [1.0, 1.0, 0.3], [5.0, 5.0, 0.0]])
EDGES = np.array([[1, 0], [1, 2]])
RISK = np.array([0.25, 0.5])


def test_csr_holds_both_directions_with_the_same_risk() -> None:
    graph = TraversalGraph.from_edges(NODES, EDGES, RISK)
    assert graph.indptr.tolist() == [0, 1, 3, 4, 4]
    assert graph.indices.tolist() == [1, 0, 2, 1]
    assert graph.risk.tolist() == [0.25, 0.25, 0.5, 0.5]
    assert graph.edges.tolist() == [[0, 1], [1, 2]]
    assert graph.version == 1
    assert graph.node_ids.tolist() == [0, 1, 2, 3]


def test_nearest_node_keeps_the_snap_distance() -> None:
    graph = TraversalGraph.from_edges(NODES, EDGES, RISK)
    assert graph.nearest_node((1.2, 0.9)) == 2
    assert graph.nearest_node((0.5, 0.0)) == 0, "the lower index wins a tie"
    assert graph.nearest_node((3.0, 3.0)) is None
    assert graph.nearest_node((3.0, 3.0), max_distance=3.0) == 2
    with pytest.raises(NoRoute) as caught:
        graph.nearest_node((np.nan, 0.0))
    assert caught.value.reason == "bad_input"


def test_edges_in_a_place_to_avoid_are_left_out_and_the_rest_stays_as_it_is() -> None:
    graph = TraversalGraph.from_edges(NODES, EDGES, RISK)
    around = graph.avoiding(np.array([[1.05, 0.6, 0.1]]))
    assert around.edges.tolist() == [[0, 1]]
    assert around.risk.tolist() == [0.25, 0.25]
    assert around.indptr.tolist() == [0, 1, 2, 2, 2]
    assert graph.edges.tolist() == [[0, 1], [1, 2]]
    assert graph.avoiding(np.array([[1.05, 0.6, 0.04]])).edges.tolist() == [[0, 1], [1, 2]]
    np.testing.assert_array_equal(around.free_headings, graph.free_headings)


@pytest.mark.parametrize(
    ("nodes", "edges", "risk", "words"),
    [
        (NODES[:, :2], EDGES, RISK, "shape"),
        (NODES * np.nan, EDGES, RISK, "finite"),
        (NODES, EDGES.astype(float), RISK, "integers"),
        (NODES, EDGES, RISK[:1], "edges must"),
        (NODES, EDGES + 3, RISK, "outside"),
    ],
)
def test_from_edges_refuses_arrays_that_do_not_fit(nodes, edges, risk, words) -> None:
    with pytest.raises(PlanningError, match=words):
        TraversalGraph.from_edges(nodes, edges, risk)


def test_an_edge_costs_its_length_its_risk_and_its_price_and_back_what_the_other_way_costs() -> None:
    graph = TraversalGraph.from_edges(NODES, EDGES, RISK)
    graph.price = np.random.default_rng(0).random(graph.price.shape).astype(np.float32)
    slots = {}
    for i in range(len(NODES)):
        for slot in range(graph.indptr[i], graph.indptr[i + 1]):
            slots[i, int(graph.indices[slot])] = slot
    there, back = graph.costs(3.0), graph.costs(3.0, back=True)
    for (i, k), slot in slots.items():
        length = float(np.hypot(*(NODES[k, :2] - NODES[i, :2])))
        assert there[slot] == pytest.approx(length * (1 + 3 * graph.risk[slot]) + graph.price[slot, 0])
        assert back[slot] == pytest.approx(there[slots[k, i]])
