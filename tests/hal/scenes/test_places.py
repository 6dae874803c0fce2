"""Ordinary places: dimensions, and a start and a goal that a robot can stand on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.scenes import SceneError, load_scene
from hal.scenes.places import GRID_RESOLUTION, PLACES, STAIR_WIDTH, bounds, named, place
from hal.scenes.shortest import shortest


@pytest.mark.parametrize("kind", PLACES)
def test_start_and_goal_are_level_and_a_way_leads_between_the_walls(kind: str) -> None:
    for seed in range(4):
        one = place(kind, seed)
        scene = one.scene
        x, y = (
            v - o
            for v, o in zip(
                np.meshgrid(*(np.arange(n) for n in scene.height.shape[::-1])), (0, 0), strict=True
            )
        )
        x, y = scene.origin[0] + GRID_RESOLUTION * x, scene.origin[1] + GRID_RESOLUTION * y
        for at in (scene.start[:2], scene.goals["end"][:2]):
            under = np.hypot(x - at[0], y - at[1]) < 0.4
            assert np.ptp(scene.height[under]) < 0.03, (seed, at)
        way = shortest(bounds(one), scene.start[:2], scene.goals["end"][:2], 0.215)
        assert math.dist(scene.start[:2], scene.goals["end"][:2]) <= way + 1e-6 < 20.0
        assert np.array_equal(scene.height, load_scene(f"places:{kind},{seed}").height)


@pytest.mark.parametrize(
    ("kind", "riser", "tread"), [("stairs_17_28_up", 0.17, 0.28), ("stairs_18_26_down", 0.18, 0.26)]
)
def test_stairs_have_their_risers_and_treads_between_walls(kind: str, riser: float, tread: float) -> None:
    one = place(kind, 1)
    (_, left, *_), (_, right, *_) = one.walls[:2]
    assert left - right == pytest.approx(STAIR_WIDTH, abs=0.1)
    row = round((0.5 * (left + right) - one.scene.origin[1]) / GRID_RESOLUTION)
    rises = np.flatnonzero(np.diff(one.scene.height[row, 50:-50]) > 0.5 * riser)
    np.testing.assert_allclose(np.diff(rises) * GRID_RESOLUTION, tread, atol=GRID_RESOLUTION)
    high = abs(one.scene.z(*one.goal) - one.scene.z(*one.start))
    assert high == pytest.approx(riser * len(rises), abs=0.01)


def test_where_nothing_leads_to_the_goal_it_is_told_what_must_not_be_entered() -> None:
    closed = {kind for kind in PLACES if place(kind, 0).beyond is not None}
    assert closed == {"steep_up", "steep_down", "moat", "pit"}
    one = place("steep_down", 2)
    assert one.beyond is not None
    x0, x1, y0, y1 = one.beyond
    assert x0 < x1
    assert y1 - y0 == pytest.approx(STAIR_WIDTH, abs=0.1)


@pytest.mark.parametrize("name", ["places:cellar", "places:house,x"])
def test_a_wrong_name_is_refused(name: str) -> None:
    with pytest.raises(SceneError):
        named(name)
