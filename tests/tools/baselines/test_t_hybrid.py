"""T-Hybrid: its assessment against the released one, and what its search may and may not do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.scenes.readers import read_geometry
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.path import make_path
from planning.risk.body import BodyModel
from planning.search import PlanRequest
from tests.places import TERRAIN, needs_shared
from tools.baselines.t_hybrid import PROFILES, THybridParams, assess, assess_points, plan
from tools.baselines.t_hybrid.reeds_shepp import reeds_shepp
from tools.baselines.t_hybrid.search import collides, distances, risk_at
from tools.baselines.t_hybrid.smooth import smooth
from tools.baselines.t_hybrid.terrain import BLOCKED, NO_RECORD, TRAVERSABLE

pytestmark = pytest.mark.campaign
PAPER = PROFILES["paper"]


@needs_shared
def test_the_assessment_is_the_released_one() -> None:
    points = read_geometry(TERRAIN / "raw_cloud.pcd").vertices
    released = np.loadtxt(TERRAIN / "terrainData.txt")
    found = assess_points(points, (0.0, 0.0), (50, 90), PROFILES["released"])
    row, column = np.divmod(released[:, 0].astype(int), 90)
    assert len(released) == 4054
    assert (found.flag >= BLOCKED).sum() == 4054
    assert (found.flag[row, column] >= BLOCKED).all(), "the same cells have a record"
    assert (found.flag[row, column] == released[:, 1]).mean() >= 0.995
    cosine = (found.normal[row, column] * released[:, 3:]).sum(axis=1)
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 1.5
    both = (found.flag[row, column] == TRAVERSABLE) & (released[:, 1] == 1)
    assert np.abs(found.rough[row, column] - released[:, 2])[both].max() < 0.006


def judged(points: np.ndarray, own: int, max_slope: float) -> tuple[int, float, np.ndarray | None]:
    """One cell in plain numpy: `points` of its window in order, the first `own` of which are looked at."""
    points = points[points[:, 2] <= points[:, 2].min(initial=np.inf) + 1.0]
    if len(points) < 3:
        return NO_RECORD, 0.0, None
    d = points - points.mean(axis=0)
    up = np.linalg.eigh(d.T @ d)[1][:, 0]
    up = up if up[2] >= 0.0 else -up
    if math.acos(min(1.0, up[2])) > max_slope:
        return BLOCKED, 0.0, up
    residual = d @ up
    if (np.abs(np.unique(residual[:own])[2:-2]) > 0.20).any():
        return BLOCKED, 0.0, up
    return TRAVERSABLE, float(np.abs(residual).mean() / 0.05), up


def test_every_cell_is_judged_as_in_plain_numpy() -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(0.0, 2.0, (1500, 2))
    z = 0.3 * np.sin(3.0 * xy[:, 0]) + rng.normal(0.0, 0.02, 1500) + 0.6 * (rng.random(1500) < 0.03)
    points = np.column_stack([xy, z])
    points = points[~((xy[:, 0] > 1.2) & (xy[:, 1] > 1.2))]
    p = THybridParams(cell=0.2)
    found = assess_points(points, (0.0, 0.0), (10, 10), p)
    cell = np.floor(points[:, :2] / 0.2).astype(int)
    seen = set()
    for r in range(10):
        for c in range(10):
            parts = [
                points[(cell[:, 0] == cc) & (cell[:, 1] == rr)]
                for rr in range(max(r - 1, 0), min(r + 2, 10))
                for cc in range(max(c - 1, 0), min(c + 2, 10))
            ]
            own = int(((cell[:, 0] == c) & (cell[:, 1] == r)).sum())
            flag, rough, up = judged(np.concatenate(parts), own, p.max_slope)
            assert found.flag[r, c] == flag, (r, c)
            seen.add(flag)
            if up is not None:
                np.testing.assert_allclose(found.normal[r, c], up, atol=1e-6)
                assert found.rough[r, c] == pytest.approx(rough, abs=1e-6)
    assert seen == {NO_RECORD, BLOCKED, TRAVERSABLE}


def driven(word: list[tuple[float, float]]) -> tuple[float, float, float]:
    """Pose after arcs (curvature -1, 0, 1; signed length) from the origin."""
    x = y = h = 0.0
    for curvature, length in word:
        if curvature == 0.0:
            x, y = x + length * math.cos(h), y + length * math.sin(h)
        else:
            new = h + curvature * length
            x += (math.sin(new) - math.sin(h)) / curvature
            y -= (math.cos(new) - math.cos(h)) / curvature
            h = new
    return x, y, h


def test_no_way_of_a_car_is_shorter_than_reeds_shepp_and_known_ones_are_as_long() -> None:
    rng = np.random.default_rng(2)
    for _ in range(4000):
        word = [
            (float(rng.integers(-1, 2)), float(rng.uniform(-2.0, 2.0))) for _ in range(rng.integers(1, 6))
        ]
        x, y, h = driven(word)
        shortest = reeds_shepp(x, y, h)
        assert shortest <= sum(abs(length) for _, length in word) + 1e-7, word
        assert shortest >= math.hypot(x, y) - 1e-9
        c, s = math.cos(h), math.sin(h)
        assert reeds_shepp(-(c * x + s * y), s * x - c * y, -h) == pytest.approx(shortest, abs=1e-7), (
            "way back"
        )
    assert reeds_shepp(3.0, 0.0, 0.0) == pytest.approx(3.0)
    assert reeds_shepp(-3.0, 0.0, 0.0) == pytest.approx(3.0)
    for length in (0.3, 1.2):
        assert reeds_shepp(*driven([(1.0, length)])) == pytest.approx(length)
    assert reeds_shepp(0.0, 0.0, math.pi) == pytest.approx(math.pi), "three arcs of 60 degrees"


def test_a_pose_is_priced_by_pitch_roll_and_roughness() -> None:
    slope = 0.2
    flag = np.full((3, 3), TRAVERSABLE, np.int8)
    rough = np.full((3, 3), 0.5)
    normal = np.tile([-math.sin(slope), 0.0, math.cos(slope)], (3, 3, 1))
    for heading, pitch, roll in ((0.0, slope, 0.0), (math.pi, slope, 0.0), (0.5 * math.pi, 0.0, slope)):
        risk = risk_at(flag, rough, normal, 1.5, 1.5, heading, 0.42, 0.42, 0.0)
        assert risk == pytest.approx(0.4 * pitch / 0.42 + 0.4 * roll / 0.42 + 0.3 * 0.25, abs=1e-9)
    assert math.isinf(risk_at(flag, rough, normal, 1.5, 1.5, 0.5 * math.pi, 0.42, 0.18, 0.0)), "too much roll"
    assert math.isinf(risk_at(flag, 4.0 * rough, normal, 1.5, 1.5, 0.0, 0.42, 0.42, 0.0)), "too rough"
    flag[1, 1] = NO_RECORD
    assert math.isfinite(risk_at(flag, rough, normal, 1.5, 1.5, 0.0, 0.42, 0.42, 0.0)), (
        "a neighbour has a record"
    )
    flag[1, 0] = BLOCKED
    assert math.isinf(risk_at(flag, rough, normal, 1.5, 1.5, 0.0, 0.42, 0.42, 0.0)), (
        "the first that has one counts"
    )


def test_the_footprint_and_the_way_over_free_cells() -> None:
    occupied = np.zeros((20, 20), np.bool_)
    occupied[10, 5:15] = True
    assert collides(occupied, 10.0, 8.0, 0.5 * math.pi, 3.0, 1.0)
    assert not collides(occupied, 10.0, 8.0, 0.0, 3.0, 1.0)
    way = distances(occupied, 10.5, 15.5)
    assert way[5, 10] > 11.5, "around the bar"
    assert way[15, 3] == pytest.approx(7.0)
    assert math.isinf(way[10, 10])


def ground(step: float = 0.0, noise: float = 0.006) -> ElevationGrid:
    """Rough 6 x 4 m with a wall that leaves a gap of 1.4 m at high y, or a plateau of `step`."""
    rng = np.random.default_rng(1)
    height = rng.normal(0.0, noise, (200, 300)).astype(np.float32)
    if step:
        height[:, 150:] += step
    else:
        height[:130, 145:152] = 0.8
    return ElevationGrid(height, np.ones(height.shape, np.bool_), (0.0, 0.0), 0.02)


def test_it_goes_around_a_wall_and_our_path_follows() -> None:
    grid = ground()
    request = PlanRequest((1.0, 1.0), (5.0, 1.0))
    found = plan(grid, request)
    np.testing.assert_allclose(found.points[0, :2], (1.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(found.points[-1, :2], (5.0, 1.0), atol=1e-9)
    assert 5.0 < found.length < 9.0
    near = found.points[np.abs(found.points[:, 0] - 2.97) < 0.2]
    assert near[:, 1].min() > 2.6 + 0.2, "through the gap"
    gaps = np.hypot(*np.diff(found.points[:, :2], axis=0).T)
    assert np.sort(gaps)[-2] < 0.12, "the last leg leads to the goal itself"
    assert found.points.tolist() == plan(grid, request).points.tolist()
    path = make_path(found, grid, BodyModel())
    np.testing.assert_allclose(path.points[-1, :2], (5.0, 1.0), atol=1e-9)
    fixed = plan(grid, PlanRequest((1.0, 1.0), (5.0, 1.0), start_yaw=math.pi, goal_yaw=0.0))
    first = fixed.points[1, :2] - fixed.points[0, :2]
    assert abs(first[1]) < 0.03, "it begins along its heading, forward or backward"


def test_it_abstains() -> None:
    request = PlanRequest((1.0, 1.0), (5.0, 1.0))
    with pytest.raises(NoRoute, match="used up its 50 pops"):
        plan(ground(), request, PAPER.model_copy(update={"budget": 50}))
    with pytest.raises(NoRoute, match="finds no way") as none:
        plan(ground(step=0.35), request)
    assert none.value.reason is NoRouteReason.NO_ROUTE
    with pytest.raises(NoRoute, match="at the goal"):
        plan(ground(), PlanRequest((1.0, 1.0), (2.97, 1.0)))
    with pytest.raises(NoRoute, match="outside the map"):
        plan(ground(), PlanRequest((1.0, 1.0), (9.0, 1.0)))
    with pytest.raises(PlanningError, match="no nodes"):
        plan(ground(), PlanRequest(0, (5.0, 1.0)))


def test_level_ground_without_noise_needs_the_floor_of_risk() -> None:
    grid = ground(noise=0.0)
    request = PlanRequest((1.0, 1.0), (5.0, 1.0))
    assert plan(grid, request).expanded < 8_000
    with pytest.raises(NoRoute, match="used up its 80000 pops"):
        plan(grid, request, PAPER.model_copy(update={"risk_floor": 0.0}))


def test_the_smoother_keeps_ends_and_moves_off_obstacles() -> None:
    x = np.arange(0.0, 14.0, 0.7) + 3.0
    poses = np.column_stack([x, 10.0 + 0.3 * (-1.0) ** np.arange(20), np.zeros(20)])
    poses[[0, 1, -2, -1], 1] = 10.0
    occupied = np.zeros((20, 20), np.bool_)
    out = smooth(poses, occupied)
    np.testing.assert_array_equal(out[[0, 1, -2, -1]], poses[[0, 1, -2, -1], :2])
    assert np.abs(out[4:-4, 1] - 10.0).max() < 0.1, "the zigzag is gone"
    occupied[9, 9:11] = True
    pushed = smooth(np.column_stack([x, np.full(20, 10.4), np.zeros(20)]), occupied)
    assert pushed[8:11, 1].mean() > 10.6


def test_assessing_a_grid_is_assessing_its_trusted_cells() -> None:
    grid = ground()
    hidden = grid.trusted.copy()
    hidden[:, 250:] = False
    found = assess(ElevationGrid(grid.height, hidden, grid.origin, grid.resolution), PAPER)
    assert found.flag.shape == (40, 60)
    assert (found.flag[:, 52:] == NO_RECORD).all()
    assert (found.flag[5:20, 5:25] == TRAVERSABLE).all()
    assert (found.flag[5:20, 29:31] == BLOCKED).all()
    assert found.occupied[10, 29]
