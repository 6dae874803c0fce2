"""Graphs whose truth is known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from hal.rotation import wrap
from hal.types import Array
from mapping.closing.graph import CAUCHY_WIDTH, HELD_SIGMA, Edges, PoseGraph, after, back, between, jacobians

SIGMA = np.array([0.02, 0.02, 0.03, 0.001])
LOOP = np.array([0.04, 0.04, 0.04, 0.005])


def poses(rng: np.random.Generator, n: int) -> Array:
    return rng.uniform((-20, -20, -2, -3), (20, 20, 2, 3), (n, 4))


def circle(n: int, rounds: float) -> Array:
    """(n, 4) a way round a circle of 20 m, up and down."""
    angle = np.linspace(0.0, rounds * 2.0 * np.pi, n)
    return np.column_stack(
        [20 * np.cos(angle), 20 * np.sin(angle), np.sin(3 * angle), wrap(angle + np.pi / 2)]
    )


def graph_of(truth: Array, rng: np.random.Generator) -> PoseGraph:
    """Odometry along the truth with its noise."""
    graph = PoseGraph()
    graph.begin(truth[0])
    for a, b in pairwise(truth):
        graph.drive(between(a, b) + SIGMA * rng.standard_normal(4), SIGMA)
    return graph


def off(nodes: Array, truth: Array) -> float:
    return float(np.abs(between(truth, nodes)[:, :3]).max())


@pytest.mark.parametrize("seed", range(5))
def test_relative_poses_are_a_group(seed: int) -> None:
    a, b = poses(np.random.default_rng(seed), 40).reshape(2, 20, 4)
    np.testing.assert_allclose(between(a, after(a, between(a, b))), between(a, b), atol=1e-12)
    np.testing.assert_allclose(after(b, back(between(a, b)))[:, :3], a[:, :3], atol=1e-12)


def test_jacobians_are_the_differences() -> None:
    a, b = poses(np.random.default_rng(1), 20).reshape(2, 10, 4)
    by_a, by_b = jacobians(a, b)
    for k in range(4):
        h = np.zeros(4)
        h[k] = 1e-6
        np.testing.assert_allclose(
            by_a[:, :, k], wrap(between(a + h, b) - between(a - h, b)) / 2e-6, atol=1e-6
        )
        np.testing.assert_allclose(
            by_b[:, :, k], wrap(between(a, b + h) - between(a, b - h)) / 2e-6, atol=1e-6
        )


def test_without_loops_the_nodes_are_those_of_odometry() -> None:
    graph = graph_of(circle(30, 1.0), np.random.default_rng(2))
    driven = graph.nodes.copy()
    assert len(graph.solve()) == 0
    np.testing.assert_allclose(graph.nodes, driven, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_wrong_loops_lose_their_say_and_right_ones_take_the_drift_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = circle(150, 2.5)
    graph = graph_of(truth, rng)
    drift = off(graph.nodes, truth)
    right = [(k, k + 60) for k in range(0, 88, 4)]
    order = [
        *[(*pair, True) for pair in right],
        *[(int(a), int(b), False) for a, b in rng.integers(0, 150, (6, 2)) if abs(a - b) > 5],
    ]
    rng.shuffle(order)
    for first, second, true in order:
        wrong = (
            np.zeros(4) if true else rng.choice((-1.0, 1.0), 4) * rng.uniform((2, 2, 0.5, 0.1), (8, 8, 2, 1))
        )
        relative = between(truth[first], truth[second]) + LOOP * rng.standard_normal(4) + wrong
        graph.close(int(first), int(second), relative, LOOP)
    weights = graph.solve()
    kept = np.array([bool(true) for *_, true in order])
    assert weights[kept].min() > 0.3
    assert weights[~kept].max() < 0.2
    assert off(graph.nodes, truth) < drift
    for k in range(1, 150, 10):
        said, covariance = graph.apart(0, k)
        error = said - between(truth[0], truth[k])
        error[3] = wrap(error[3])
        assert error @ np.linalg.solve(covariance, error) < 25.0, k
    graph.drop(set(np.flatnonzero(~kept).tolist()))
    np.testing.assert_allclose(np.delete(weights, np.flatnonzero(~kept)), graph.solve(), atol=0.2)


def test_the_gradient_is_zero_where_it_ends() -> None:
    rng = np.random.default_rng(3)
    truth = circle(40, 1.5)
    graph = graph_of(truth, rng)
    graph.close(0, 26, between(truth[0], truth[26]), LOOP)
    graph.solve()

    def cost(nodes: Array) -> float:
        loops = (graph.loops.errors(nodes) ** 2).sum(axis=1)
        held = (nodes[0] - truth[0]) / (1e-4, 1e-4, 1e-4, 1e-5)
        return float(
            (graph.odometry.errors(nodes) ** 2).sum() + 9.0 * np.log1p(loops / 9.0).sum() + held @ held
        )

    best = cost(graph.nodes)
    for _ in range(100):
        assert cost(graph.nodes + 1e-3 * rng.standard_normal(graph.nodes.shape)) > best


def test_the_covariance_is_that_of_the_dense_equations() -> None:
    rng = np.random.default_rng(4)
    truth = circle(12, 1.0)
    graph = graph_of(truth, rng)
    graph.close(0, 11, between(truth[0], truth[11]), LOOP)
    weight = graph.solve()
    said, covariance = graph.apart(3, 8)
    rows = []
    for edges, share in ((graph.odometry, 1.0), (graph.loops, np.sqrt(weight[0]))):
        for m, (i, j) in enumerate(zip(edges.first, edges.second, strict=True)):
            by_i, by_j = jacobians(graph.nodes[[i]], graph.nodes[[j]])
            row = np.zeros((4, 48))
            row[:, 4 * i : 4 * i + 4], row[:, 4 * j : 4 * j + 4] = by_i[0], by_j[0]
            rows.append(share * row / edges.sigma[m][:, None])
    held = np.zeros((4, 48))
    held[:, :4] = np.diag([1e4, 1e4, 1e4, 1e5])
    dense = np.concatenate([*rows, held])
    by_i, by_j = jacobians(graph.nodes[[3]], graph.nodes[[8]])
    side = np.zeros((4, 48))
    side[:, 12:16], side[:, 32:36] = by_i[0], by_j[0]
    expected = side @ np.linalg.inv(dense.T @ dense) @ side.T
    np.testing.assert_allclose(said, between(graph.nodes[3], graph.nodes[8]))
    np.testing.assert_allclose(covariance, expected, rtol=1e-3, atol=1e-8)


def test_a_second_run_is_free_until_a_loop_holds_it() -> None:
    truth = circle(10, 0.5)
    graph = graph_of(truth, np.random.default_rng(5))
    first = graph.begin(np.zeros(4))
    graph.drive(between(truth[2], truth[3]), SIGMA)
    assert graph.apart(0, first)[1][0, 0] > 1e5
    graph.close(2, first, np.array([0.5, 0.0, 0.0, 0.2]), LOOP)
    graph.solve()
    np.testing.assert_allclose(between(graph.nodes[2], graph.nodes[first]), [0.5, 0.0, 0.0, 0.2], atol=1e-3)
    assert graph.apart(0, first)[1][0, 0] < 1.0


STEADY = np.array([1e-6, 1e-6, 0.0005, 0.00006])


def bent(truth: Array, wrong: Array, loops: list[tuple[int, int]]) -> PoseGraph:
    """Odometry that is wrong by the same all along, and exact loops."""
    graph = PoseGraph()
    graph.begin(truth[0])
    for a, b in pairwise(truth):
        way = float(np.linalg.norm(b[:2] - a[:2]))
        graph.drive(between(a, b) + wrong * way, SIGMA, way)
    for first, second in loops:
        graph.close(first, second, between(truth[first], truth[second]), LOOP)
    return graph


@pytest.mark.parametrize("seed", range(4))
def test_what_odometry_is_wrong_by_all_along_is_told_from_what_it_is_wrong_by_now_and_then(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wrong = STEADY * (0.0, 0.0, *rng.choice((-2.0, 2.0), 2))
    truth = 4.0 * circle(150, 1.2)
    truth[:, 3] /= 4.0
    loops = [(k, k + 125) for k in range(0, 24, 4)]
    plain, told = bent(truth, wrong, loops), bent(truth, wrong, loops)
    plain.solve()
    weights = told.solve(STEADY)
    assert off(told.nodes, truth) < 0.25 * off(plain.nodes, truth)
    assert weights.min() > 0.9


def test_a_graph_with_steady_errors_is_the_least_squares_of_a_plain_oracle() -> None:
    rng = np.random.default_rng(5)
    truth = circle(9, 1.1)
    loops = [(0, 8), (1, 8)]
    graph = bent(truth, 30.0 * STEADY, loops)
    ways = np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1)
    measured = graph.odometry
    for first, second, relative, _ in graph._loops:
        relative += 0.02 * rng.standard_normal(4) * (first == 1 and second == 8)

    def errors(x: Array) -> Array:
        nodes, wrong = x[:-4].reshape(-1, 4), x[-4:]
        odometry = Edges(
            measured.first, measured.second, measured.relative + ways[:, None] * wrong, measured.sigma
        ).errors(nodes)
        closed = graph.loops.errors(nodes)
        robust = np.sqrt(CAUCHY_WIDTH**2 * np.log1p((closed**2).sum(axis=1) / CAUCHY_WIDTH**2))
        return np.concatenate([odometry.ravel(), robust, (nodes[0] - truth[0]) / HELD_SIGMA, wrong / STEADY])

    want = least_squares(errors, np.concatenate([graph.nodes.ravel(), np.zeros(4)]), xtol=1e-14, ftol=1e-14)
    graph.solve(STEADY)
    np.testing.assert_allclose(graph.nodes, want.x[:-4].reshape(-1, 4), atol=1e-4)
