"""The cells under the wheels: the kernel says what a plain reading of the rules says."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.elevation.wheels_ground import WHEEL_SPOT, support_patch

HALF, SIGMA, RES = (0.45, 0.25), 0.03, 0.04


@pytest.mark.parametrize("radius", [None, 0.6])
@pytest.mark.parametrize("rough", [False, True])
def test_cells_under_the_wheels_equal_numpy(radius: float | None, rough: bool) -> None:
    wheels = np.array([[0.2, 0.15, 0.0], [0.2, -0.15, 0.01], [-0.2, 0.15, 0.02], [-0.2, -0.15, 0.0]])
    wheels[0, 2] = 0.3 if rough else 0.02
    centre, yaw = np.array([1.23, -0.71]), 0.7
    c, s = np.cos(yaw), np.sin(yaw)
    contacts = wheels @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + (*centre, 0.5)
    got = support_patch(contacts, centre, yaw, HALF, radius, SIGMA, RES)

    i, j = (
        a.ravel() for a in np.meshgrid(np.arange(-60, 30), np.arange(0, 70), indexing="ij")
    )  # all that may count
    x, y = j * RES - centre[0], i * RES - centre[1]
    under = (np.abs(c * x + s * y) <= HALF[0]) & (np.abs(-s * x + c * y) <= HALF[1])
    away = np.hypot(j[:, None] * RES - contacts[:, 0], i[:, None] * RES - contacts[:, 1])
    inside = under if radius is None else x * x + y * y <= radius * radius
    inside = inside & (away.min(axis=1) <= WHEEL_SPOT) if rough else inside
    plane = np.linalg.lstsq(np.column_stack([contacts[:, :2], np.ones(4)]), contacts[:, 2], rcond=None)[0]
    height = contacts[away.argmin(axis=1), 2] if rough else j * RES * plane[0] + i * RES * plane[1] + plane[2]
    variance = (SIGMA + 0.05 * away.min(axis=1)) ** 2

    assert inside.sum() > 50
    np.testing.assert_array_equal([got.i, got.j, got.under], [i[inside], j[inside], under[inside]])
    np.testing.assert_allclose(got.height, height[inside], atol=1e-6)
    np.testing.assert_allclose(got.variance, variance[inside], rtol=1e-5)
