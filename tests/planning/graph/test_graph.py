"""The graph's container: CSR, snapping, files, typed errors."""

from __future__ import annotations

import json

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


def test_save_and_load_give_the_same_graph(tmp_path) -> None:
    graph = TraversalGraph.from_edges(NODES, EDGES, RISK, frontier=np.array([False, True, False, False]))
    graph.save(tmp_path / "g.npz")
    again = TraversalGraph.load(tmp_path / "g.npz")
    for name in ("nodes", "indptr", "indices", "risk", "frontier", "turn_price", "node_ids", "edge_revision"):
        np.testing.assert_array_equal(getattr(again, name), getattr(graph, name))
        assert getattr(again, name).dtype == getattr(graph, name).dtype
    assert again.params == graph.params
    assert again.version == graph.version


def test_load_refuses_other_files(tmp_path) -> None:
    np.savez(tmp_path / "x.npz", a=1)
    with pytest.raises(PlanningError, match="not a traversal graph"):
        TraversalGraph.load(tmp_path / "x.npz")
    for junk in (b"", b"PK\x03\x04 cut off", b"not a zip at all"):
        (tmp_path / "j.npz").write_bytes(junk)
        with pytest.raises(PlanningError, match="not a traversal graph"):
            TraversalGraph.load(tmp_path / "j.npz")
    with pytest.raises(PlanningError, match=r"missing\.npz"):
        TraversalGraph.load(tmp_path / "missing.npz")


def test_load_refuses_a_file_of_another_version_or_with_arrays_that_do_not_fit(tmp_path) -> None:
    graph = TraversalGraph.from_edges(NODES, EDGES, RISK)
    graph.save(tmp_path / "g.npz")
    with np.load(tmp_path / "g.npz") as data:
        arrays = dict(data)

    def write(**changed: object) -> None:
        np.savez(tmp_path / "h.npz", **(arrays | changed))  # type: ignore[arg-type]

    header = json.loads(str(arrays["header"]))
    write(header=np.array(json.dumps(header | {"format": 99})))
    with pytest.raises(PlanningError, match="format 99, this program reads 4"):
        TraversalGraph.load(tmp_path / "h.npz")
    write(header=np.array(json.dumps(header | {"params": {"mode": "best"}})))
    with pytest.raises(PlanningError, match="mode"):
        TraversalGraph.load(tmp_path / "h.npz")
    for changed in (
        {"indices": np.array([1, 0, 9, 1], np.int32)},
        {"indptr": arrays["indptr"][:-1]},
        {"risk": arrays["risk"][:2]},
        {"nodes": arrays["nodes"][:, :2]},
        {"node_ids": arrays["node_ids"].astype(float)},
    ):
        write(**changed)
        with pytest.raises(PlanningError, match="do not fit"):
            TraversalGraph.load(tmp_path / "h.npz")


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
