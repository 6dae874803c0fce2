"""The two rules of every speed profile."""

from __future__ import annotations

import numpy as np
import pytest

from planning.braking import bend_speed, brake


def test_a_bend_is_driven_at_the_stricter_of_both_limits() -> None:
    np.testing.assert_allclose(bend_speed(np.array([0.25, -4.0]), 1.0, 1.5), [2.0, 0.375])


def test_braking_begins_where_the_deceleration_still_suffices() -> None:
    speed = np.array([1.0, 1.0, 1.0, 0.0, 0.8])
    brake(speed, np.array([0.5, 0.25, 0.25, 1.0]), 0.5)
    assert speed.tolist() == pytest.approx([1.0, np.sqrt(0.5), 0.5, 0.0, 0.8])
