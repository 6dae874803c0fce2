"""Angles and rotations against plain formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.rotation import cross, rotation, rotation_rpy, rotation_vector, rotation_vectors, rotations, wrap


def test_a_wrapped_angle_is_the_same_direction_and_half_a_turn_is_positive() -> None:
    angles = np.random.default_rng(0).uniform(-20.0, 20.0, 200)
    wrapped = wrap(angles)
    np.testing.assert_allclose(wrapped, [math.remainder(a, 2.0 * math.pi) for a in angles], atol=1e-12)
    assert wrap(-math.pi) == wrap(math.pi) == math.pi
    assert [wrap(float(a)) for a in angles] == pytest.approx(wrapped.tolist(), abs=1e-12)


@pytest.mark.parametrize("largest", [1e-10, 0.02, 3.0])
def test_many_rotation_vectors_equal_one_by_one(largest: float) -> None:
    rng = np.random.default_rng(3)
    matrices = rotation_rpy(*rng.uniform(-largest, largest, (3, 40)))
    expected = np.array([rotation_vector(matrix) for matrix in matrices])
    assert np.abs(expected).max() > 0.5 * largest
    np.testing.assert_allclose(rotation_vectors(matrices), expected, rtol=1e-12, atol=1e-22)


def test_many_quaternions_give_the_matrices_of_one_by_one() -> None:
    q = np.random.default_rng(3).standard_normal((50, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    np.testing.assert_array_equal(rotations(q), np.array([rotation(one) for one in q]))


def test_the_cross_product_is_numpys_bit_for_bit() -> None:
    a, b = np.random.default_rng(4).standard_normal((2, 200, 3))
    np.testing.assert_array_equal([cross(u, v) for u, v in zip(a, b, strict=True)], np.cross(a, b))
    assert cross([1, 0, 0], (0, 1, 0)).tolist() == [0.0, 0.0, 1.0]
