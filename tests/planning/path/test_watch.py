"""Is something in the way of a path: new faces are seen wherever they stand, old ones and noise are not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path import face_in_the_way, in_fields, make_path, new_field, still_safe
from planning.risk.body import BodyModel, terrain_of
from planning.risk.steps import steps_under
from planning.search.plan import PlanRequest, plan
from tests.planning.worlds import flat, rough

BODY = BodyModel()


def straight(grid: ElevationGrid):
    """A path along y = 2 from x = 1 to x = 6."""
    graph = TraversalGraph.from_edges(
        np.array([[1.0, 2.0, 0.0], [3.5, 2.0, 0.0], [6.0, 2.0, 0.0]]),
        np.array([[0, 1], [1, 2]]),
        np.zeros(2),
    )
    return graph, make_path(plan(graph, grid, PlanRequest(0, 2)), grid, BODY)


def with_box(grid: ElevationGrid, xs: tuple[float, float], ys: tuple[float, float], height: float):
    """The grid with a box on it."""
    rows, cols = grid.shape
    x = grid.origin[0] + np.arange(cols) * grid.resolution
    y = (grid.origin[1] + np.arange(rows) * grid.resolution)[:, None]
    on = (x >= xs[0]) & (x <= xs[1]) & (y >= ys[0]) & (y <= ys[1])
    tall = np.where(on, grid.height + np.float32(height), grid.height)
    return ElevationGrid(tall, grid.trusted, grid.origin, grid.resolution)


def plain_step(grid: ElevationGrid, pose: np.ndarray) -> float:
    """Highest face between trusted neighbours of which one lies under the body, cell by cell."""
    rows, cols = grid.shape
    nx, ny = (math.ceil(round(side / grid.resolution, 9)) + 1 for side in (BODY.length, BODY.width))
    best = 0.0
    for u in np.linspace(-BODY.length / 2, BODY.length / 2, nx):
        for v in np.linspace(-BODY.width / 2, BODY.width / 2, ny):
            x = pose[0] + u * math.cos(pose[2]) - v * math.sin(pose[2])
            y = pose[1] + u * math.sin(pose[2]) + v * math.cos(pose[2])
            c = math.floor((x - grid.origin[0]) / grid.resolution + 0.5)
            r = math.floor((y - grid.origin[1]) / grid.resolution + 0.5)
            for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                cells = ((r, c), (r + dr, c + dc))
                if all(0 <= a < rows and 0 <= b < cols and grid.trusted[a, b] for a, b in cells):
                    a, b = (float(grid.height[cell]) for cell in cells)
                    best = max(best, abs(a - b))
    return best


@pytest.mark.parametrize("seed", range(3))
def test_faces_under_the_body_equal_the_plain_reading_and_do_not_depend_on_the_side(seed):
    grid = rough(seed, untrusted=0.25)
    x0, y0, x1, y1 = grid.extent
    rng = np.random.default_rng(seed)
    poses = np.column_stack(
        [rng.uniform(x0 - 0.5, x1 + 0.5, 40), rng.uniform(y0 - 0.5, y1 + 0.5, 40), rng.uniform(-4, 4, 40)]
    )
    got = steps_under(terrain_of(grid, BODY), poses, BODY.length, BODY.width)
    np.testing.assert_allclose(got, [plain_step(grid, p) for p in poses], atol=1e-6)
    assert got.max() > 0.2
    turned = ElevationGrid(grid.height[::-1, ::-1], grid.trusted[::-1, ::-1], (-x1, -y1), grid.resolution)
    opposite = poses * (-1.0, -1.0, 1.0) + (0.0, 0.0, np.pi)
    again = steps_under(terrain_of(turned, BODY), opposite, BODY.length, BODY.width)
    np.testing.assert_allclose(again, got, atol=1e-6)


def test_what_the_robot_has_passed_is_not_in_its_way():
    grid = flat(7, 4)
    graph, path = straight(grid)
    behind, ahead = (with_box(grid, (x, x + 0.2), (1.9, 2.1), 0.3) for x in (1.6, 5.0))
    assert face_in_the_way(path, behind, BODY)
    for x in np.arange(1.0, 3.61, 0.1):
        path = path.beyond(x, 2.0)
    assert path.watched[0, 0] == pytest.approx(3.6, abs=0.03)
    assert not face_in_the_way(path, behind, BODY)
    assert face_in_the_way(path, ahead, BODY)
    np.testing.assert_allclose(path.route, [(6.0, 2.0)])
    assert still_safe(path, graph, behind, BODY) == (True, "")


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_box_is_seen_on_a_path_that_passes_a_wall_elsewhere(side):
    wall = with_box(flat(7, 4), (1.5, 2.0), (2.0 + side * 0.45 - 0.25, 2.0 + side * 0.45 + 0.25), 1.0)
    graph, path = straight(wall)
    assert path.faces.max() == pytest.approx(1.0), "the body's rim touches the wall"
    assert face_in_the_way(path, wall, BODY) == ""
    boxed = with_box(wall, (4.5, 4.8), (1.8, 2.1), 0.45)
    assert "0.45 m face" in face_in_the_way(path, boxed, BODY)
    assert not still_safe(path, graph, boxed, BODY)[0]


@pytest.mark.parametrize("ys", [(1.5, 1.82), (2.18, 2.5)])
def test_a_box_that_reaches_under_either_rim_is_seen(ys):
    _, path = straight(flat(7, 4))
    assert "0.30 m face" in face_in_the_way(path, with_box(flat(7, 4), (4.0, 4.3), ys, 0.3), BODY)


def test_noise_of_a_map_is_no_face():
    rng = np.random.default_rng(0)
    wall = with_box(flat(7, 4), (1.5, 2.0), (2.2, 2.7), 1.0)

    def noisy(grid: ElevationGrid) -> ElevationGrid:
        height = grid.height + rng.normal(0.0, 0.005, grid.shape)
        return ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)

    _, path = straight(noisy(wall))
    assert [face_in_the_way(path, noisy(wall), BODY) for _ in range(20)] == [""] * 20


def test_a_face_off_the_grid_is_not_looked_for():
    grid = flat(7, 4)
    _, path = straight(grid)
    part = ElevationGrid(grid.height[:, :40] + 0.0, grid.trusted[:, :40], grid.origin, grid.resolution)
    assert face_in_the_way(path, part, BODY) == ""
    away = ElevationGrid(grid.height, grid.trusted, (50.0, 50.0), grid.resolution)
    assert face_in_the_way(path, away, BODY) == ""


def test_a_stepfield_that_was_not_known_is_told_to_a_robot_before_it() -> None:
    grid = flat(8, 4)
    _, path = straight(grid)
    posts = np.random.default_rng(0).choice(4, (40, 80), p=[0.4, 0.3, 0.2, 0.1]) * 0.05
    y, x = np.mgrid[0 : grid.shape[0], 0 : grid.shape[1]] * grid.resolution
    posts = posts[np.minimum((y / 0.12).astype(int), 39), np.minimum((x / 0.12).astype(int), 79)]
    height = np.where((x > 3.0) & (x < 5.0), posts, 0.0).astype(np.float32)
    grown = ElevationGrid(height, np.ones(grid.shape, bool), grid.origin, grid.resolution)
    params = GraphParams(max_step=0.25, max_posts=0.20, blind_radius=0.0)
    before, after = (TraversalGraph.build(g, (1.0, 2.0), params) for g in (grid, grown))
    known = in_fields(path, before)
    assert not known.any()
    assert new_field(path, before, known) == ""
    told = new_field(path, after, known)
    assert told.startswith("a stepfield begins at (")
    assert 2.7 < float(told.partition("(")[2].partition(",")[0]) < 3.6
    assert new_field(path, after, in_fields(path, after)) == "", "the path was made through it"
    nearer = path.beyond(1.9, 2.0).beyond(2.5, 2.0)
    assert new_field(nearer, after, known) == told
    inside = nearer.beyond(3.4, 2.0).beyond(4.0, 2.0)
    assert new_field(inside, after, known) == "", "it does not turn there"
