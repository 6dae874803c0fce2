"""The built-in scenes: what the docs promise about them holds in the height array."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hal.scenes import Scene, SceneError, load_scene, scene_names
from hal.scenes.picture import render_scene_png

FOOTPRINT = 0.42
"""Circumradius of the robot [m]."""


def spread(scene: Scene, x: float, y: float, radius: float = FOOTPRINT) -> float:
    """Height range under a disc [m]."""
    rows, cols = scene.height.shape
    yy, xx = np.mgrid[:rows, :cols] * scene.resolution
    disc = np.hypot(xx + scene.origin[0] - x, yy + scene.origin[1] - y) <= radius
    return float(np.ptp(scene.height[disc]))


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_loads_with_a_start_on_level_ground_and_named_goals(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.goals
    assert scene.description
    assert spread(scene, *scene.start[:2]) < 0.06


@pytest.mark.parametrize("name", scene_names())
def test_a_scene_is_the_same_every_time(name: str) -> None:
    a, b = load_scene(name), load_scene(name)
    assert a.height.tobytes() == b.height.tobytes()
    assert a.goals == b.goals
    assert a.pairs == b.pairs


@pytest.mark.parametrize("name", ["flat", "yard"])
def test_goals_of_the_everyday_scenes_can_be_stood_on(name: str) -> None:
    scene = load_scene(name)
    for goal, (x, y, _) in scene.goals.items():
        assert spread(scene, x, y) < 0.08, goal


def test_the_yard_has_its_ramp_platform_and_steps() -> None:
    yard = load_scene("yard")
    assert yard.z(*yard.goals["platform"][:2]) == pytest.approx(0.40, abs=1e-6)
    slope = (yard.z(2.4, 3.5) - yard.z(1.6, 3.5)) / 0.8
    assert np.degrees(np.arctan(slope)) == pytest.approx(15.0, abs=0.2)
    assert [round(yard.z(x, -1.0), 3) for x in (-0.6, -0.2, 0.4, 1.0, 1.4)] == [0.0, 0.05, 0.15, 0.05, 0.0]
    assert 0.01 < np.std([yard.z(x, -0.9) for x in np.arange(2.0, 4.6, 0.05)]) < 0.03


def test_the_wall_in_the_yard_is_not_seen_from_the_start() -> None:
    yard = load_scene("yard")
    caster = yard.caster()
    angle = np.linspace(-np.pi, np.pi, 4000)
    rays = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1).astype(np.float32)
    origin = np.tile(np.array([*yard.start[:2], 0.55], np.float32), (len(rays), 1))
    hits = origin + rays * caster.cast(origin, rays)[:, None]
    on_wall = (np.abs(hits[:, 1] - 1.6) < 0.1) & (hits[:, 0] < -1.3) & (hits[:, 0] > -5.8)
    assert not on_wall.any()
    assert yard.z(-3.0, 1.6) == pytest.approx(1.0, abs=1e-6)


def test_an_unknown_scene_names_the_known_ones() -> None:
    with pytest.raises(SceneError, match="yard"):
        load_scene("nowhere")


def test_a_start_outside_the_terrain_is_refused() -> None:
    with pytest.raises(SceneError, match="outside"):
        Scene("x", np.zeros((5, 5), np.float32), 0.1, (0.0, 0.0), (3.0, 0.0, 0.0), {})


def test_heights_between_cells_are_bilinear() -> None:
    scene = Scene("x", np.array([[0, 1], [2, 5]], np.float32), 1.0, (10.0, 20.0), (10.0, 20.0, 0.0), {})
    assert scene.z(10.5, 20.5) == pytest.approx(2.0)
    assert scene.z(99.0, 20.0) == pytest.approx(1.0)
    assert scene.extent == (10.0, 20.0, 11.0, 21.0)


def test_the_picture_shows_north_up(tmp_path: Path) -> None:
    height = np.zeros((40, 60), np.float32)
    height[35:] = 1.0
    scene = Scene("x", height, 0.1, (0.0, 0.0), (1.0, 1.0, 0.0), {"g": (2.0, 1.0, None)})
    render_scene_png(scene, tmp_path / "s.png", size=300)
    image = np.asarray(Image.open(tmp_path / "s.png")).astype(int)
    assert image.shape == (200, 300, 3)
    assert image[5, 150].sum() > image[150, 200].sum() + 200


def test_an_apron_is_level_unseen_and_leaves_the_scene_where_it_is():
    scene = load_scene("rescue_platform")
    wide = scene.with_apron(0.5)
    assert wide.extent == pytest.approx(np.add(scene.extent, (-0.5, -0.5, 0.5, 0.5)))
    for x, y in ((1.0, 1.0), (3.5, 3.6), (6.2, 1.0)):
        assert wide.z(x, y) == pytest.approx(scene.z(x, y), abs=1e-5)
    assert wide.z(scene.extent[0] - 0.3, 1.0) == 0.0
    assert wide.trusted.sum() == scene.trusted.sum()
