"""The kernels that read the map out: which cells to believe, which gaps to bridge, what to fill."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.elevation.bridging import OVER, bridge, bridge_rule, trust
from mapping.elevation.tiles import CONTACT, LIDAR, UNKNOWN
from mapping.filling import fill_unknown, slope_and_step


def test_trust_equals_numpy() -> None:
    rng = np.random.default_rng(4)
    shape = (40, 30)
    source = rng.choice([UNKNOWN, CONTACT, LIDAR], shape, p=[0.3, 0.1, 0.6]).astype(np.uint8)
    height = np.where(source > 0, rng.normal(0, 0.03, shape), np.nan).astype(np.float32)
    variance = rng.uniform(0, 2e-3, shape).astype(np.float32)
    count = np.where(source == LIDAR, rng.integers(1, 6, shape), 0).astype(np.uint8)
    upper = np.where(rng.random(shape) < 0.3, height - rng.uniform(0.0, 0.1, shape), np.inf).astype(
        np.float32
    )
    like, sure, reach, low, loose, lower = np.zeros((6, *shape), int)
    padded_h, padded_n = np.pad(height, 1, constant_values=np.nan), np.pad(count, 1)
    for a in range(3):
        for b in range(3):
            h, n = padded_h[a : a + 40, b : b + 30], padded_n[a : a + 40, b : b + 30]
            level, not_below = np.abs(h - height) <= 0.05, h - height >= -0.05
            like += (n >= 3) & level
            sure += (n >= 6) & level
            reach += (n >= 3) & not_below
            loose += (n < 3) & not_below
            lower += h - height < -0.05
            low += (n >= 3) & (h - height < -0.05)
    # heights differ by less than a wall: nothing lies before one
    few = (count < 3) & ((like < 2) | (like < lower))
    lonely = (count >= 3) & (count < 6) & (reach < 2) & ((low > 0) | (loose == 0))
    stray = (source == LIDAR) & (few | lonely)
    assert (few & (like >= 2)).sum() > 3
    assert (lonely & (source == LIDAR)).sum() > 3
    under = (source == CONTACT) & (upper < height - np.float32(0.04))
    want = ((source == CONTACT) & ~under) | ((source == LIDAR) & ~stray & (variance < 1e-3))
    want_bound = np.where(stray | under, np.fmin(upper, height + 3.0 * np.sqrt(variance)), upper)
    got = trust(height, variance, upper, count, source, 1e-3, 3, 6, 0.05, 0.04, bound := np.empty_like(upper))
    assert np.array_equal(got, want)
    np.testing.assert_allclose(bound, want_bound, rtol=1e-6)
    for gone in (stray, under):
        assert np.isnan(height[gone]).all()
        assert (source[gone] == UNKNOWN).all()
        assert gone.sum() > 10


def believed(height, count):
    """Heights after `trust`, of LiDAR cells certain to 1 cm; NaN unknown."""
    height = np.array(height, np.float32)
    known = np.isfinite(height)
    count = np.where(known, count, 0).astype(np.uint8)
    source, variance = np.where(known, LIDAR, UNKNOWN).astype(np.uint8), np.full_like(height, 1e-4)
    open_ = np.full_like(height, np.inf)
    trust(height, variance, open_, count, source, 3.6e-3, 3, 6, 0.05, 0.04, np.empty_like(height))
    return height


@pytest.mark.parametrize(
    ("points", "ground", "stays"), [(3, 9, False), (5, 9, False), (6, 9, True), (3, 0, False)]
)
def test_a_cell_alone_above_the_ground_needs_six_points(points: int, ground: int, stays: bool) -> None:
    """Mixed pixels came one by one into a cell 0.11 m above level ground, over seconds."""
    height, count = np.full((5, 5), 0.0 if ground else np.nan), np.full((5, 5), ground)
    height[2, 2], count[2, 2] = 0.11, points
    assert np.isfinite(believed(height, count)[2, 2]) == stays
    height[2, 3], count[2, 3] = 0.12, 3
    assert np.isfinite(believed(height, count)[2, 2]), "an edge goes on"


@pytest.mark.parametrize(("support", "stays"), [(3, False), (6, True)])
def test_a_single_point_before_a_wall_needs_neighbours_of_six_points(support: int, stays: bool) -> None:
    height, count = np.full((5, 6), np.nan), np.full((5, 6), 9)
    height[0], height[1] = 0.5, 0.14
    height[2, 3], count[2, 3], count[1] = 0.14, 1, support
    assert np.isfinite(believed(height, count)[2, 3]) == stays
    height[0] = 0.14
    assert np.isfinite(believed(height, count)[2, 3]), "no wall"


def test_a_single_point_is_not_ground_where_more_neighbours_lie_lower() -> None:
    height, count = np.zeros((5, 5)), np.full((5, 5), 9)
    height[2, 2], height[1, 1:3], count[2, 2] = 0.14, 0.14, 1
    assert np.isnan(believed(height, count)[2, 2])


def bridged(height, upper, *, source=None):
    """Bridge a map whose finite cells are trusted LiDAR cells, 0.04 m."""
    height = np.asarray(height, np.float32)
    known = np.isfinite(height)
    source = np.where(known, LIDAR, UNKNOWN).astype(np.uint8) if source is None else source
    rule = bridge_rule(0.04, 0.64, 0.03, 0.47, 0.12, 0.04, 1.4, 0.3)
    filled, kind = height.copy(), source.copy()
    scratch = np.empty((2, *height.shape), np.float32), np.empty((3, *height.shape), np.uint8)
    bridge(filled, kind, known.copy(), np.asarray(upper, np.float32), rule, *scratch[0], scratch[1])
    assert np.array_equal(filled[known], height[known])
    return np.where(kind >= OVER, filled, np.nan)


def strips(profile, gaps, rows=20):
    """A map constant along y with the height `profile` along x, unknown in the column ranges `gaps`."""
    height = np.tile(np.asarray(profile, np.float32), (rows, 1))
    for a, b in gaps:
        height[:, a:b] = np.nan
    return height


def test_a_gap_in_level_ground_is_bridged_where_rays_passed_low() -> None:
    height = strips(np.zeros(30), [(10, 20)])
    out = bridged(height, np.full_like(height, 0.05))
    assert np.array_equal(np.isfinite(out), np.isnan(height))
    np.testing.assert_allclose(out[np.isfinite(out)], 0.0, atol=1e-6)
    assert np.isnan(
        bridged(height, np.full_like(height, 0.3))
    ).all()  # something lower than the rays may stand there
    assert np.isnan(bridged(height, np.full_like(height, np.inf))).all()  # a shadow
    assert np.isnan(bridged(height, np.full_like(height, -0.1))).all()  # a ray went below: a hole


def test_a_ramp_is_bridged_and_a_step_is_not() -> None:
    x = np.arange(40) * 0.04
    gaps = [(8, 15), (17, 24)]
    ramp = strips(0.3 * x, gaps)
    out = bridged(ramp, np.tile(0.3 * x + 0.05, (20, 1)))
    np.testing.assert_allclose(out[5:15, 8:15], np.tile(0.3 * x[8:15], (10, 1)), atol=1e-5)
    step = strips(np.where(x > 0.78, 0.10, 0.0), gaps)
    out = bridged(step, np.full_like(step, 0.11))
    assert np.isfinite(out[5:15, 8:15]).all()
    assert np.isnan(out[:, 17:24]).all()


@pytest.mark.parametrize(("cells", "bridge"), [(2, True), (3, False), (6, False)])
def test_two_cells_at_most_are_bridged_without_a_low_ray(cells: int, bridge: bool) -> None:
    height = strips(np.zeros(30), [(10, 10 + cells)])
    out = bridged(height, np.full_like(height, np.inf))
    assert np.isfinite(out[:, 10 : 10 + cells]).any() == bridge


def test_the_rim_of_a_hole_stays_unknown() -> None:
    height = np.zeros((60, 60), np.float32)
    height[20:40, 20:40] = np.nan
    upper = np.full_like(height, 0.05)
    upper[:, 24:] = -0.10  # behind the near edge the rays go below the ground
    out = bridged(height, upper)
    assert np.isnan(out[22:38, 20:40]).all()


def test_no_bridge_leads_over_a_single_point_on_the_floor_of_a_pit() -> None:
    height = strips(np.zeros(30), [(13, 17)])
    upper = np.full_like(height, 0.05)
    count = np.where(np.isfinite(height), 9, 0).astype(np.uint8)
    source = np.where(np.isfinite(height), LIDAR, UNKNOWN).astype(np.uint8)
    variance = np.where(np.isfinite(height), 1e-4, np.nan).astype(np.float32)
    floor = 10, 15
    height[floor], count[floor], source[floor], variance[floor] = -0.12, 1, LIDAR, 1e-4
    trust(height, variance, upper, count, source, 3.6e-3, 3, 6, 0.05, 0.04, bound := np.empty_like(upper))
    assert bound[floor] == pytest.approx(-0.09, abs=1e-6)
    assert np.isnan(bridged(height, bound)[7:14, 13:17]).all()
    assert np.isfinite(bridged(height, np.full_like(height, 0.05))[7:14, 13:17]).all()


@pytest.mark.parametrize(("wall", "floor"), [(0.4, False), (0.14, True)])
def test_in_a_corner_of_walls_the_points_before_both_make_no_floor(wall: float, floor: bool) -> None:
    """At 6.6 m one ring of the XT16 met both walls of a lane at 0.14 m: the cells before them, then those between."""
    height = np.full((12, 12), np.nan, np.float32)
    height[:2], height[:, 10:] = wall, wall
    height[2, :10] = height[2:, 9] = 0.14
    out = bridged(height, np.full_like(height, 0.15))
    assert np.isfinite(out[3:8, 4:9]).any() == floor
    one_wall = height[:, :10]
    assert np.isfinite(bridged(one_wall, np.full_like(one_wall, 0.15))[3:8, 4:9]).any(), "up to a wall it is"


def test_nothing_wider_than_the_limit_is_bridged() -> None:
    height = strips(np.zeros(60), [(10, 40)], rows=60)
    assert np.isnan(bridged(height, np.full_like(height, 0.05))).all()


def test_fill_takes_the_nearest_known_cell_and_the_lower_bound() -> None:
    rng = np.random.default_rng(5)
    height = np.where(rng.random((50, 37)) < 0.03, rng.normal(size=(50, 37)), np.nan).astype(np.float32)
    out = fill_unknown(height)
    r, c = np.nonzero(np.isfinite(height))
    rows, cols = np.indices(height.shape)
    d = (rows[..., None] - r) ** 2 + (cols[..., None] - c) ** 2
    nearest = height[r, c]
    for a, b in np.ndindex(height.shape):
        assert out[a, b] in nearest[d[a, b] == d[a, b].min()]
    bound = np.full_like(height, np.nan)
    bound[0] = -9.0
    lowered = fill_unknown(height, bound)
    assert (lowered[0][np.isnan(height[0])] == -9.0).all()
    assert np.array_equal(lowered[1:], out[1:])
    assert (fill_unknown(np.full((3, 3), np.nan, np.float32)) == 0.0).all()


def test_slope_and_step_of_a_plane_with_an_edge() -> None:
    x = np.arange(30) * 0.05
    height = np.tile(0.2 * x + np.where(x > 0.72, 0.15, 0.0), (20, 1)).astype(np.float32)
    height[3, 3] = np.nan
    slope, step = slope_and_step(height, 0.05)
    assert slope[10, 8] == pytest.approx(np.arctan(0.2), abs=1e-4)
    assert step[10, 14] == pytest.approx(0.16, abs=1e-4)
    assert step[10, 8] == pytest.approx(0.01, abs=1e-4)
    assert np.isnan(slope[3, 3])
    assert np.isnan(step[3, 3])
    assert np.isfinite(slope[3, 4])
