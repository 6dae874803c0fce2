"""The static study's statistics on made-up instances, and its yardstick on a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search.plan import VARIANTS, PlanRequest, plan
from tools.bench.static.floor import edge_peaks, least_maxima
from tools.bench.static.study import SCENES, Instance, changed, interval, macro, measure, values
from tools.bench.static.table import markdown


def made_up():
    rng = np.random.default_rng(1)
    out = []
    for scene, count in zip(SCENES, (20, 10, 5, 5), strict=True):
        for k in range(count):
            base = float(rng.uniform(4, 6))
            for v in VARIANTS:
                share = {"native": 1.0, "full": 0.8}.get(v, 0.9)
                nodes = (0, k, 9) if v == "native" or k % 2 else (0, 8, 9)
                least = (0.7 * base, 24.0, 0.48)
                out.append(
                    Instance(
                        scene,
                        "native",
                        k % 2,
                        k // 2,
                        v,
                        nodes,
                        base,
                        base * share,
                        30 * share,
                        0.5,
                        0.1,
                        base,
                        least,
                    )
                )
    return out


def test_macro_means_weigh_scenes_equally_and_changes_are_paired():
    instances = made_up()
    native, full = values(instances, "native", "native"), values(instances, "native", "full")
    assert macro(native)[2] == pytest.approx(30.0)
    np.testing.assert_allclose(macro(full) / macro(native), [1.0, 0.8, 0.8, 1.0, 1.0])
    np.testing.assert_allclose(
        interval(full, native), np.tile([0.0, -0.2, -0.2, 0.0, 0.0], (2, 1)), atol=1e-9
    )
    per_scene = np.mean([native[s][:, 0].mean() for s in SCENES])
    assert macro(native)[0] == pytest.approx(per_scene)
    assert changed(instances, "native", "native") == 0.0
    assert changed(instances, "native", "full") == pytest.approx((9 + 4 + 3 + 3) / 40), (
        "even k, but for k = 8"
    )


def test_more_graphs_of_the_same_queries_do_not_narrow_an_interval():
    once = made_up()
    more = [replace(i, seed=i.seed + 10 * k) for k in range(4) for i in once]
    found = []
    for instances in (once, more):
        native = values(instances, "native", "native")
        assert [len(v) for v in native.values()] == [10, 5, 3, 3], "queries"
        full = values(instances, "native", "full")
        varied = {s: v * np.linspace(0.7, 1.0, len(v))[:, None] for s, v in full.items()}
        found.append(interval(varied, native))
    assert (np.diff(found[0], axis=0)[0, :4] > 0.02).all()
    np.testing.assert_allclose(found[0], found[1])


def test_the_table_says_what_is_reached_and_what_is_not():
    text = markdown(made_up(), ["rescue_steps, native, seed 3, pair 1: no node"])
    assert "d_fb -20.0 % for -10.0 %: reached" in text
    assert "p_int +0.0 % for -14.9 %: MISSED" in text
    assert "No instance had a route." in text
    assert "seed 3, pair 1: no node" in text
    assert (
        "30.0 % below native; a_lr 24.000 deg, 20.0 % below native; p_int 0.480 m, 4.0 % below native" in text
    )
    assert "(full: 0.0 %; the paper's 14.9 % are more than there is)" in text


def test_native_routes_through_walls_are_counted_and_left_out():
    instances = [
        replace(i, p_int=0.9, length=0.5 * i.length)
        if i.scene == SCENES[0] and i.variant == "native" and 2 * i.pair + i.seed < 5
        else i
        for i in made_up()
    ]
    text = markdown(instances, [])
    assert "On 5 of 40 instances the native route has something over 0.5 m high under the body" in text
    assert "On the other instances full against native: length +0.0 %, d_fb -20.0 %" in text
    assert "On 0 of 40 instances" in markdown(made_up(), [])


def test_the_floor_is_the_best_bottleneck_of_each_feature():
    edges = np.array([[0, 1], [1, 3], [0, 2], [2, 3], [4, 5]])
    peaks = np.array([[0.1, 9.0, 0.0], [0.5, 1.0, 0.2], [0.3, 4.0, 0.1], [0.4, 5.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(least_maxima(edges, peaks, 6, 0, 3), [0.4, 5.0, 0.1])
    height = np.zeros((41, 121), np.float32)
    height[:, 60:] = 0.2
    grid = ElevationGrid(height, np.ones(height.shape, bool), (0.0, 0.0), 0.05)
    nodes = np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [4.0, 1.0, 0.2]])
    graph = TraversalGraph.from_edges(nodes, np.array([[0, 1], [1, 2]]), np.zeros(2))
    found = edge_peaks(RiskTable(graph, grid, BodyModel()), BodyModel())
    np.testing.assert_allclose(found[0], 0.0, atol=1e-6)
    assert found[1, 0] == pytest.approx(0.2, abs=0.01)


def test_the_yardstick_sees_a_step_on_the_route_and_unseen_ground():
    height = np.zeros((41, 121), np.float32)
    height[:, 60:] = 0.12
    trusted = np.ones_like(height, bool)
    trusted[:, :20] = False
    grid = ElevationGrid(height, trusted, (0.0, 0.0), 0.05)
    graph = TraversalGraph.from_edges(
        np.array([[1.0, 1.0, 0], [5.0, 1.0, 0]]), np.array([[0, 1]]), np.zeros(1)
    )
    length, d_fb, a_lr, p_int, untrusted = measure(plan(graph, grid, PlanRequest(0, 1, variant="native")))
    assert length == pytest.approx(4.0)
    assert d_fb == pytest.approx(0.12, abs=1e-4)
    assert a_lr == pytest.approx(0.0, abs=1e-6)
    assert 0.06 < p_int < 0.12, "while the front band is only partly on the step"
    assert 0.01 < untrusted < 0.1


def test_the_pictures_show_routes_between_nodes(tmp_path, monkeypatch):
    from tools.bench.static.pictures import draw  # with matplotlib, which no other test needs

    monkeypatch.setattr("tools.bench.static.pictures.MODES", ("native",))
    graph = TraversalGraph.from_edges(
        np.array([[1.0, 1.0, 0], [5.0, 1.0, 0]]), np.array([[0, 1]]), np.zeros(1)
    )
    grid = ElevationGrid(np.zeros((41, 121), np.float32), np.ones((41, 121), bool), (0.0, 0.0), 0.05)
    route = plan(graph, grid, PlanRequest(0, 1, variant="native"))
    draw(tmp_path, made_up(), {f"{SCENES[0]}.native": {"native": route}})
    assert (tmp_path / f"{SCENES[0]}_native.png").stat().st_size > 1000
