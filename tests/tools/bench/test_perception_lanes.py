"""The perception bench on lanes: what a crest hides is told apart from what the robot could have seen."""

import numpy as np
import pytest

from hal.scenes import Scene
from tools.bench.perception.lanes import in_view


def ridge() -> Scene:
    """Level ground with a ridge 0.3 m high from x = 1.0 to 1.1 m."""
    height = np.zeros((41, 201), np.float32)
    height[:, 100:111] = 0.3
    return Scene(
        name="ridge", height=height, resolution=0.01, origin=(0.0, -0.2), start=(0.2, 0.0, 0.0), goals={}
    )


def test_a_ridge_hides_the_ground_in_its_shadow() -> None:
    eye = np.array([0.5, 0.0, 0.6])
    x = np.array([0.7, 0.95, 1.05, 1.2, 1.6, 1.75, 1.9])
    # The shadow of the ridge's far edge at x = 1.10 ends where the line from 0.6 m over 0.3 m meets the ground: 1.70.
    assert in_view(ridge(), eye, x, np.zeros(7)).tolist() == [True, True, True, False, False, True, True]


def test_ground_outside_the_terrain_is_not_in_view() -> None:
    assert in_view(ridge(), np.array([0.5, 0.0, 0.6]), np.array([2.5]), np.zeros(1)).tolist() == [False]


@pytest.mark.parametrize(("height", "seen"), [(0.31, False), (3.0, True)])
def test_a_higher_eye_sees_behind(height: float, seen: bool) -> None:
    assert bool(in_view(ridge(), np.array([0.5, 0.0, height]), np.array([1.3]), np.zeros(1))[0]) is seen
