"""The thinned cloud against a dictionary."""

from __future__ import annotations

import numpy as np

from hal.rotation import rotation_rpy
from mapping.thin_cloud import POINT_REACH, ThinCloud


def oracle(points: np.ndarray, voxel: float) -> np.ndarray:
    """Means of the points of each voxel, in the order in which the voxels come."""
    found: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point in points:
        found.setdefault(tuple(np.floor(point / voxel).astype(int)), []).append(point)
    return np.array([np.mean(group, axis=0) for group in found.values()])


def test_each_voxel_keeps_the_mean_of_its_points_also_after_the_table_has_grown() -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-9.0, 9.0, (6000, 3)).astype(np.float32)
    turn, place = rotation_rpy(0.1, -0.2, 2.0), np.array([3.0, -40.0, 1.0])
    cloud = ThinCloud(0.5)
    for part in np.array_split(points, 7):
        cloud.add(part, turn, place)
    expected = oracle(points.astype(np.float64) @ turn.T + place, 0.5)
    assert len(expected) > 5000
    np.testing.assert_allclose(cloud.points, expected, atol=1e-4)


def test_points_that_are_not_finite_or_too_far_and_those_beyond_the_limit_are_left_out() -> None:
    cloud = ThinCloud(1.0, limit=2)
    points = np.array([[0.5, 0, 0], [np.nan, 0, 0], [POINT_REACH + 1.0, 0, 0], [3.5, 0, 0]], np.float32)
    cloud.add(points, np.eye(3), np.zeros(3))
    assert cloud.points.tolist() == [[0.5, 0.0, 0.0], [3.5, 0.0, 0.0]]
    cloud.enter(np.array([[9.5, 0, 0], [0.7, 0, 0]], np.float32))
    np.testing.assert_allclose(cloud.points, [[0.6, 0.0, 0.0], [3.5, 0.0, 0.0]], atol=1e-6)
