"""Places to look from: what they show, how they are ordered, and what is told of ground that no way leads to."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.search import sight
from planning.search import viewpoints as v
from planning.search.frontier import worth_keeping

RES = 0.05


def room(door: bool, step: float = 0.0) -> tuple[ElevationGrid, TraversalGraph]:
    """A hall of 8 x 6 m seen up to a wall at x 4 m; a door of 1.2 m in it leads on to ground `step` [m] higher, of
    which a strip was seen."""
    height = np.zeros((120, 160), np.float32)
    seen = np.zeros(height.shape, np.bool_)
    seen[:, :84] = True
    height[:, 80:84] = 1.5
    if door:
        height[48:72, 80:84] = 0.0
        seen[44:76, 84:100] = True
        height[:, 84:] = step
    rim = np.ones(height.shape, np.bool_)
    rim[3:-3, 3:-3] = False
    height[rim] = 1.5
    filled = fill_unknown(np.where(seen, height, np.float32(np.nan)))
    grid = ElevationGrid(filled, seen, (0.0, 0.0), RES)
    return grid, TraversalGraph.build(grid, (1.0, 3.0))


def survey(door: bool, step: float = 0.0, **fields: object) -> v.Viewpoints:
    grid, graph = room(door, step)
    return v.viewpoints(graph, grid, v.Survey((1.0, 3.0), **fields), 3.0)  # type: ignore[arg-type]


def test_what_lies_behind_a_door_is_looked_at_and_what_a_wall_hides_is_not() -> None:
    area = np.array([(0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0)])
    open_ = survey(True, area=area, home=(1.0, 3.0))
    assert len(open_.xy)
    assert (np.abs(open_.xy[:, 1] - 3.0) < 1.0).all()
    assert (open_.xy[:, 0] > 3.0).all()
    assert 10.0 < open_.hidden < 24.0  # 8 x 6 m less what was seen, rim included
    assert 0.0 < open_.home < 0.8
    closed = survey(False, area=area)
    assert (len(closed.xy), closed.hidden, closed.coverage) == (0, 0.0, 1.0)


def test_an_area_ends_what_is_looked_at() -> None:
    here = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 6.0), (0.0, 6.0)])
    assert len(survey(True, area=here).xy) == 0


def test_a_place_given_up_is_left_out() -> None:
    first = survey(True)
    others = survey(True, barred=first.xy)
    for place in others.xy:
        assert np.hypot(*(first.xy - place).T).min() > v.BARRED_RADIUS


def test_seen_ground_behind_a_step_that_is_too_high_is_told() -> None:
    found = survey(True, step=0.3)
    assert len(found.xy) == 0
    assert any(4.0 < x < 5.2 and 2.0 < y < 4.0 for x, y in found.unreachable)


@pytest.mark.parametrize("seed", range(6))
def test_the_order_is_about_the_shortest_way_and_the_target_is_kept_where_little_is_lost(seed: int) -> None:
    random = np.random.default_rng(seed)
    xy = random.uniform(0.0, 20.0, (7, 2))
    between = np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1))
    first, last = np.hypot(*xy.T), np.hypot(*xy.T)

    def length(order: tuple[int, ...]) -> float:
        return float(
            first[order[0]] + last[order[-1]] + sum(between[a, b] for a, b in itertools.pairwise(order))
        )

    best = min(map(length, itertools.permutations(range(7))))
    free = tuple(v._ordered(first, between, last, -1))
    assert sorted(free) == list(range(7))
    assert length(free) <= 1.03 * best
    for kept in range(7):
        order = tuple(v._ordered(first, between, last, kept))
        assert order == free or worth_keeping(length(order), length(free))
        assert sorted(order) == list(range(7))


def test_what_a_place_shows_is_what_a_plain_count_says() -> None:
    random = np.random.default_rng(3)
    unseen = random.random((40, 40)) < 0.5
    taken = unseen & (random.random((40, 40)) < 0.2)
    top = np.where(random.random((40, 40)) < 0.05, 1.0, -np.inf).astype(np.float32)
    place = np.array([[4.1, 3.7, 0.0]])
    total, step = 0.0, 0.5 * sight.WAY_CELL
    for a in range(sight.SIGHT_RAYS):
        for s in range(1, int(sight.SIGHT_RANGE / step) + 1):
            x, y = (
                place[0, k] + s * step * f(2.0 * math.pi * a / sight.SIGHT_RAYS)
                for k, f in ((0, math.cos), (1, math.sin))
            )
            r, c = math.floor(y / sight.WAY_CELL), math.floor(x / sight.WAY_CELL)
            if not (0 <= r < 40 and 0 <= c < 40):
                continue
            if top[r, c] > sight.HIDING_HEIGHT:
                break
            total += s * step * step * 2.0 * math.pi / sight.SIGHT_RAYS * (unseen[r, c] and not taken[r, c])
    assert sight._shown(place, unseen, taken, top, 0.0, 0.0)[0] == pytest.approx(total, rel=1e-9)


def test_ground_that_rays_only_passed_over_is_looked_at() -> None:
    height = np.zeros((120, 160), np.float32)
    rim = np.ones(height.shape, np.bool_)
    rim[3:-3, 3:-3] = False
    height[rim] = 1.5
    passed_over = np.zeros(height.shape, np.bool_)
    passed_over[3:-3, 100:140] = True
    grid = ElevationGrid(height, ~passed_over, (0.0, 0.0), RES, virtual=passed_over)
    graph = TraversalGraph.build(grid, (1.0, 3.0))
    found = v.viewpoints(graph, grid, v.Survey((1.0, 3.0)), 3.0)
    assert len(found.xy)
    assert (found.xy[:, 0] > 3.5).all(), "beside it"
    assert found.hidden == pytest.approx(11.0, abs=2.0)  # 2 x 5.7 m
    assert found.coverage < 0.9
