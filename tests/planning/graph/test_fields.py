"""Stepfields: what is one, and that no way leads through one with too high posts."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.faces import update_faces
from planning.graph.fields import mark_fields, sums
from planning.graph.flags import FIELD, POSTS
from planning.graph.graph import GraphParams, TraversalGraph
from planning.search.plan import PlanRequest, plan

RES = 0.04
Y, X = np.mgrid[0:60, 0:100] * RES
"""A lane 2.4 m wide; what is tried begins at x = 1.4 m."""


def posts(high: float, seed: int) -> np.ndarray:
    """Posts of 0.12 m and four heights over 1.2 m, across the whole lane."""
    random = np.random.default_rng(seed)
    heights = random.choice(4, (20, 10), p=[0.4, 0.3, 0.2, 0.1]) * high / 3.0
    inside = (X >= 1.4) & (X < 2.6)
    z = heights[(Y / 0.12).astype(int), np.clip(((X - 1.4) / 0.12).astype(int), 0, 9)]
    return np.where(inside, z, 0.0) + 0.004 * random.standard_normal(X.shape)


def marked(z: np.ndarray, max_posts: float = 0.05) -> int:
    faces = np.zeros((*z.shape, 2), np.int16)
    update_faces(faces, z.astype(np.float32), np.ones(z.shape, bool), RES, 0, 0, *z.shape)
    flags = np.zeros(z.shape, np.uint16)
    mark_fields(flags, faces, np.ones(z.shape, bool), RES, (0, 0, *z.shape), max_posts)
    return int(np.count_nonzero(flags & POSTS))


def test_posts_above_the_limit_are_a_field_and_lower_ones_are_not() -> None:
    low, high = ([marked(posts(h, seed)) for seed in range(6)] for h in (0.04, 0.08))
    assert max(low) == 0
    assert min(high) > 200
    assert max(marked(posts(0.08, seed), 0.10) for seed in range(6)) == 0, "a limit above them"


def test_bars_kerbs_walls_and_rough_ground_are_no_fields() -> None:
    random = np.random.default_rng(3)
    bar = np.where(np.abs((X - 2.0) * 0.7 + (Y - 1.2) * 0.7) < 0.05, 0.10, 0.0)
    crossed = np.maximum(bar, np.where(np.abs((X - 2.0) * 0.7 - (Y - 1.2) * 0.7) < 0.05, 0.10, 0.0))
    kerb = np.where((np.abs(X - 2.0) < 0.4) & (Y < 1.2), 0.10, 0.0)
    wall = np.where((np.abs(X - 2.0) < 0.3) & (np.abs(Y - 1.2) < 0.3), 0.5, 0.0)
    knots = random.uniform(-0.05, 0.05, (20, 30))
    rough = knots[np.minimum((Y / 0.15).astype(int), 19), (X / 0.15).astype(int)]
    for _ in range(2):  # linear between the knots, nearly
        rough = sum(np.roll(np.roll(rough, i, 0), j, 1) for i in (-1, 0, 1) for j in (-1, 0, 1)) / 9.0
    noise = 0.004 * random.standard_normal(X.shape)
    assert [marked(z + noise) for z in (bar, crossed, kerb, wall, rough)] == [0] * 5


def test_crossing_ramps_have_no_price_of_a_field() -> None:
    """Half ramps of 15 deg and 0.6 m in two columns, out of step."""
    along = np.where(Y < 1.2, X, X + 0.6)
    z = 0.6 * np.tan(np.radians(15.0)) * (1.0 - np.abs(along % 1.2 - 0.6) / 0.6)
    z = z + 0.004 * np.random.default_rng(5).standard_normal(z.shape)
    assert not flagged(z, np.ones(z.shape, bool), 0.12).any()


def test_sums_over_squares_are_those_of_a_loop() -> None:
    values = np.random.default_rng(0).integers(-50, 50, (9, 7)).astype(np.int32)
    want = [[values[max(0, r - 2) : r + 3, max(0, c - 2) : c + 3].sum() for c in range(7)] for r in range(9)]
    np.testing.assert_array_equal(sums(values, 2), want)


@pytest.mark.parametrize("limit", [None, 0.05])
def test_no_way_leads_through_a_field_of_too_high_posts(limit: float | None) -> None:
    z = posts(0.08, 1).astype(np.float32)
    grid = ElevationGrid(z, np.ones(z.shape, bool), (0.0, 0.0), RES)
    params = GraphParams(max_posts=limit, blind_radius=0.0)
    graph = TraversalGraph.build(grid, (0.7, 1.2), params)
    request = PlanRequest((0.7, 1.2), (3.3, 1.2))
    if limit is None:
        assert plan(graph, grid, request).reaches_goal
    else:
        with pytest.raises(NoRoute):
            plan(graph, grid, request)


def test_a_way_around_a_field_is_taken_where_its_posts_are_above_a_third_of_the_limit() -> None:
    z = np.where(Y < 1.3, posts(0.08, 1), 0.004 * np.random.default_rng(2).standard_normal(X.shape))
    grid = ElevationGrid(z.astype(np.float32), np.ones(z.shape, bool), (0.0, 0.0), RES)

    def highest(limit: float | None) -> float:
        graph = TraversalGraph.build(
            grid, (0.7, 0.6), GraphParams(max_posts=limit, controller="vmc", blind_radius=0.0)
        )
        found = plan(graph, grid, PlanRequest((0.7, 0.6), (3.3, 0.6)))
        middle = np.linspace(1.5, 2.5, 20)
        return float(np.interp(middle, *found.points.T[:2]).max())

    assert highest(0.10) > 1.5, "around"
    assert highest(0.30) < 1.0, "through: a third of it is above the posts"
    assert highest(None) < 1.0


def test_what_may_lead_around_a_field_is_looked_at_before_the_field_is_entered() -> None:
    z = np.where(Y < 1.3, posts(0.08, 1), 0.004 * np.random.default_rng(2).standard_normal(X.shape))
    z[(X < 0.1) | (X > 3.86) | (Y < 0.1) | (Y > 2.26)] = 0.6
    hidden = (Y > 1.3) & (np.abs(X - 2.0) < 0.7)
    params = GraphParams(max_posts=0.10, controller="vmc", blind_radius=0.0)
    request = PlanRequest((0.7, 0.6), (3.3, 0.6), allow_frontier=True)
    for seen in (np.ones(z.shape, bool), ~hidden):
        grid = ElevationGrid(z.astype(np.float32), seen, (0.0, 0.0), RES)
        found = plan(TraversalGraph.build(grid, (0.7, 0.6), params), grid, request)
        assert found.reaches_goal is bool(seen.all())
        assert found.frontier is None or (found.frontier[0] < 1.4 and found.frontier[1] > 0.8)
    walled = np.where(hidden, 0.6, z).astype(np.float32)
    grid = ElevationGrid(walled, np.ones(z.shape, bool), (0.0, 0.0), RES)
    assert plan(TraversalGraph.build(grid, (0.7, 0.6), params), grid, request).reaches_goal, "there is none"


def test_a_field_of_which_half_was_seen_has_its_price_but_is_not_out() -> None:
    z = posts(0.15, 3)
    faces = np.zeros((*z.shape, 2), np.int16)
    trusted = np.random.default_rng(4).random((15, 25)).repeat(4, 0).repeat(4, 1) < 0.6
    update_faces(faces, z.astype(np.float32), trusted, RES, 0, 0, *z.shape)
    flags = np.zeros(z.shape, np.uint16)
    mark_fields(flags, faces, trusted, RES, (0, 0, *z.shape), 0.10)
    inside = (X > 1.6) & (X < 2.4)
    assert (flags[inside] & FIELD > 0).mean() > 0.6
    assert (flags & POSTS > 0).mean() < 0.02


def flagged(z: np.ndarray, trusted: np.ndarray, max_posts: float) -> np.ndarray:
    """(rows, cols) what has the price of a field."""
    faces = np.zeros((*z.shape, 2), np.int16)
    update_faces(faces, z.astype(np.float32), trusted, RES, 0, 0, *z.shape)
    flags = np.zeros(z.shape, np.uint16)
    mark_fields(flags, faces, trusted, RES, (0, 0, *z.shape), max_posts)
    return flags & FIELD > 0


@pytest.mark.parametrize("seed", range(3))
def test_a_field_goes_on_where_only_the_tops_of_its_posts_were_seen(seed: int) -> None:
    z = posts(0.15, seed)
    tops, seen = 0.10 + 0.35 * (z - 0.075), X < 2.6
    inside = (X > 2.0) & (X < 2.4) & (Y > 0.3) & (Y < 2.1)
    assert flagged(np.where(X > 1.9, tops, z), seen, 0.20)[inside].mean() > 0.5
    assert flagged(np.where(X > 1.4, tops, 0.0), seen, 0.20)[inside].mean() < 0.05, "no rim"


def test_a_lane_between_a_field_and_a_wall_is_none() -> None:
    z = np.where(Y < 1.3, posts(0.15, 1), 0.004 * np.random.default_rng(2).standard_normal(X.shape))
    z[Y > 1.9] = 0.6
    found = flagged(z, np.ones(z.shape, bool), 0.12)
    assert found[(X > 1.6) & (X < 2.4) & (Y > 0.3) & (Y < 1.2)].mean() > 0.8
    assert found[(X > 1.5) & (X < 2.5) & (Y > 1.36)].mean() < 0.02


def test_a_part_that_is_computed_again_is_what_a_full_build_gives() -> None:
    z = posts(0.08, 2).astype(np.float32)
    flat = z.copy()
    flat[20:45, 40:60] = 0.0
    params = GraphParams(max_posts=0.05, blind_radius=0.0)
    trusted = np.ones(z.shape, bool)
    graph = TraversalGraph.build(ElevationGrid(flat, trusted, (0.0, 0.0), RES), (0.7, 1.2), params)
    whole = TraversalGraph.build(ElevationGrid(z, trusted, (0.0, 0.0), RES), (0.7, 1.2), params)
    graph.update(ElevationGrid(z, trusted, (0.0, 0.0), RES), [(20, 40, 45, 60)], (0.7, 1.2))
    assert graph.cells is not None
    assert whole.cells is not None
    np.testing.assert_array_equal(graph.cells.flags, whole.cells.flags)
    np.testing.assert_array_equal(graph.edges, whole.edges)
    assert np.count_nonzero(whole.cells.flags & POSTS) > 200
