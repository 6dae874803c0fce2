"""Pose features and pose-set risk against the plain reading and the reference results."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid
from planning.errors import PlanningError
from planning.risk.body import BodyModel, edge_poses, moments_of, pose_features, sweep_poses
from planning.risk.pose_sets import turn_angle
from tests.places import needs_shared
from tests.planning.worlds import flat, golden_world, rough
from tools.bench.planning import reference

BODY = BodyModel()


@pytest.mark.parametrize(("seed", "resolution"), [(0, 0.05), (1, 0.02), (2, 0.1), (3, 0.03)])
def test_features_equal_the_plain_reading_inside_and_outside_the_grid(seed, resolution):
    grid = rough(seed, resolution=resolution, untrusted=0.25)
    rng = np.random.default_rng(seed)
    x0, y0, x1, y1 = grid.extent
    poses = np.column_stack(
        [rng.uniform(x0 - 0.8, x1 + 0.8, 120), rng.uniform(y0 - 0.8, y1 + 0.8, 120), rng.uniform(-7, 7, 120)]
    )
    want = np.array([reference.features(grid, p, BODY) for p in poses])
    np.testing.assert_allclose(pose_features(grid, poses, BODY), want, atol=1e-4, rtol=0)
    assert want[:, 3].max() > 0.9
    assert want[:, 2].max() > 0.05


def test_a_body_across_a_step_reads_the_step():
    height = np.zeros((61, 61), np.float32)
    height[:, 31:] = 0.2
    grid = ElevationGrid(height, np.ones_like(height, bool), (-1.5, -1.5), 0.05)
    along, across = pose_features(grid, np.array([[0.025, 0.0, 0.0], [0.025, 0.0, np.pi / 2]]), BODY)
    assert along[0] == pytest.approx(0.2, abs=1e-6)
    assert along[1] == pytest.approx(0.0, abs=1e-6)
    assert across[0] == pytest.approx(0.0, abs=1e-6)
    assert across[1] == pytest.approx(np.degrees(np.arctan2(0.2, 0.43)), abs=1e-4)
    np.testing.assert_allclose([along[2], across[2]], 0.0, atol=1e-6)


def test_a_post_under_the_belly_is_interference_only():
    height = np.zeros((61, 61), np.float32)
    height[30, 30] = 0.15
    grid = ElevationGrid(height, np.ones_like(height, bool), (-1.5, -1.5), 0.05)
    np.testing.assert_allclose(
        pose_features(grid, np.zeros((1, 3)), BODY)[0],
        reference.features(grid, (0.0, 0.0, 0.0), BODY),
        atol=1e-6,
    )
    d_fb, a_lr, p_int, u = pose_features(grid, np.zeros((1, 3)), BODY)[0]
    assert d_fb == a_lr == u == 0.0
    assert 0.05 < p_int <= 0.15


def test_nothing_trusted_is_all_unknown():
    grid = ElevationGrid(np.full((40, 40), np.nan, np.float32), np.zeros((40, 40), bool), (0.0, 0.0), 0.05)
    np.testing.assert_array_equal(pose_features(grid, np.array([[1.0, 1.0, 0.3]]), BODY), [[0, 0, 0, 1]])


def test_a_nan_cell_marked_trusted_is_not_trusted():
    height = np.zeros((60, 60), np.float32)
    height[20:40, 20:40] = np.nan
    f = pose_features(
        ElevationGrid(height, np.ones((60, 60), bool), (0.0, 0.0), 0.05), np.array([[1.5, 1.5, 0.0]]), BODY
    )
    assert f[0, 3] > 0.9


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 25), st.integers(1, 25), st.floats(0.02, 0.9))
def test_fill_takes_the_nearest_known_cell(seed, rows, cols, share):
    rng = np.random.default_rng(seed)
    height = rng.normal(size=(rows, cols)).astype(np.float32)
    height[rng.uniform(size=(rows, cols)) > share] = np.nan
    filled = fill_unknown(height)
    known = np.argwhere(np.isfinite(height))
    if not len(known):
        assert (filled == 0).all()
        return
    for r in range(rows):
        for c in range(cols):
            d = ((known - [r, c]) ** 2).sum(1)
            assert filled[r, c] in height[tuple(known[d == d.min()].T)]


def test_half_turns_go_the_positive_way():
    assert turn_angle(0.0, np.pi) == pytest.approx(np.pi)
    assert turn_angle(np.pi / 2, -np.pi / 2) == pytest.approx(np.pi)
    assert turn_angle(3.0, -3.0) == pytest.approx(2 * np.pi - 6.0)


def test_pose_sets_have_the_stated_spacing_and_ends():
    poses = edge_poses(np.array([0.0, 0.0]), np.array([0.3, 0.4]), BODY)
    assert len(poses) == 11
    np.testing.assert_allclose(poses[[0, -1], :2], [[0, 0], [0.3, 0.4]])
    assert len(edge_poses(np.zeros(2), np.array([0.01, 0.0]), BODY)) == 2
    sweep = sweep_poses(1.0, 2.0, 0.1, 0.1 - np.radians(12), BODY)
    assert len(sweep) == 4
    np.testing.assert_allclose(sweep[[0, -1], 2], [0.1, 0.1 - np.radians(12)])
    assert len(sweep_poses(1.0, 2.0, 0.1, 0.1, BODY)) == 1


def test_the_tail_is_the_largest_tenth_of_each_feature():
    features = np.zeros((11, 4))
    features[0, 0], features[3, 0], features[5, 1] = 0.3, 0.15, 900.0
    (mean, tail, peak), none = moments_of(features, np.array([[0, 11], [4, 4]]), BODY)
    np.testing.assert_allclose(mean, [1.5 / 11, 3.0 / 11, 0, 0])
    np.testing.assert_allclose(tail, [0.75, 1.5, 0, 0])
    np.testing.assert_allclose(peak, [0.3, 900.0, 0, 0])
    assert np.isnan(none).all(), "no pose"


@pytest.mark.parametrize(
    "poses", [np.zeros(3), np.zeros((2, 4)), np.array([[0.0, np.nan, 0.0]]), np.array([[0.0, 0.0, np.inf]])]
)
def test_bad_poses_are_refused(poses):
    with pytest.raises(PlanningError, match="poses must"):
        pose_features(flat(2, 2), poses, BODY)


@needs_shared
def test_features_equal_the_reference():
    grid, _, want = golden_world()
    got = pose_features(grid, want["poses"], BODY)
    np.testing.assert_allclose(got, want["features"], atol=1e-4, rtol=0)
