"""The rescue scenes have the dimensions of the lanes they copy; mazes can be walked."""

import numpy as np
import pytest

from hal.lidar.caster import Surface
from hal.scenes import Scene, load_scene
from hal.scenes.survey import relief, survey

RESCUE = ("rescue_slopes", "rescue_platform", "rescue_steps", "rescue_elevated")


def profile(scene: Scene, x: np.ndarray, y: float) -> np.ndarray:
    return np.array([scene.z(float(a), y) for a in x])


def untrusted_along(scene: Scene) -> float:
    """Mean share of unseen cells under a strip 0.4 m wide along the straight lines of the pairs."""
    shares = []
    for start, goal in scene.pairs[:10]:
        a, b = np.array(start), np.array(goal)
        u = (b - a) / np.linalg.norm(b - a)
        s, w = np.meshgrid(np.arange(0, np.linalg.norm(b - a), 0.02), np.arange(-0.2, 0.21, 0.02))
        p = a + s[..., None] * u + w[..., None] * np.array([-u[1], u[0]])
        cell = np.round((p - scene.origin) / scene.resolution).astype(int)
        cell = np.clip(cell, 0, np.array(scene.height.shape)[::-1] - 1)
        shares.append(1.0 - scene.trusted[cell[..., 1], cell[..., 0]].mean())
    return float(np.mean(shares))


@pytest.mark.parametrize("name", RESCUE)
def test_rescue_scenes_have_forty_pairs_and_about_a_tenth_unseen(name: str) -> None:
    scene = load_scene(name)
    assert scene.resolution == 0.02
    assert len(scene.pairs) == len(set(scene.pairs)) == 40
    length = [np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in scene.pairs]
    assert min(length) >= 4.2
    assert max(length) <= 6.2
    assert all(scene.contains(*p) for pair in scene.pairs for p in pair)
    assert 0.08 <= untrusted_along(scene) <= 0.12
    seen = scene.trusted
    assert scene.survey is not None
    assert np.std((scene.survey - scene.height)[seen]) == pytest.approx(0.007, rel=0.05)


def test_slopes_are_15_degrees_with_a_period_of_1_2_m() -> None:
    scene = load_scene("rescue_slopes")
    lane = profile(scene, np.arange(1.3, 7.1, 0.02), 1.2)
    assert lane.min() == pytest.approx(0.02, abs=0.006)
    assert lane.max() == pytest.approx(0.181, abs=0.006)
    up = profile(scene, np.array([1.3, 1.7]), 1.2)
    assert np.degrees(np.arctan(np.diff(up)[0] / 0.4)) == pytest.approx(15.0, abs=0.1)
    assert profile(scene, np.array([1.5]), 1.2) == pytest.approx(
        profile(scene, np.array([2.7]), 1.2), abs=1e-6
    )
    assert scene.z(4.2, 1.8) == pytest.approx(0.5, abs=1e-6)


def test_the_platform_has_its_ramp_and_curbs() -> None:
    scene = load_scene("rescue_platform")
    assert scene.z(4.2, 3.6) == pytest.approx(0.40, abs=1e-6)
    rise = scene.z(2.9, 3.6) - scene.z(2.3, 3.6)
    assert np.degrees(np.arctan(rise / 0.6)) == pytest.approx(20.0, abs=0.1)
    assert [scene.z(x, 1.0) for x in (2.6, 6.2)] == pytest.approx([0.05, 0.10], abs=1e-6)
    assert scene.z(4.4, 1.3) == pytest.approx(0.095, abs=1e-6)
    assert any(2.2 < a[0] < 3.0 and 3.3 < a[1] < 3.9 for a, _ in scene.pairs[:10])


def test_the_stepfield_has_its_hill_and_the_detour_is_flat() -> None:
    scene = load_scene("rescue_steps")
    field = scene.height[round(1.3 / 0.02) : round(2.5 / 0.02), round(2.7 / 0.02) : round(3.9 / 0.02)]
    assert field.max() == pytest.approx(0.45, abs=1e-6)
    assert np.ptp([scene.z(x, y) for x in np.arange(1.0, 7.6, 0.05) for y in (3.78, 4.0, 4.24)]) < 1e-6


def test_the_elevated_scene_has_stairs_bridge_and_ramps() -> None:
    scene = load_scene("rescue_elevated")
    stairs = profile(scene, 1.4 + 0.23 * (np.arange(5) + 0.5), 3.6)
    assert stairs == pytest.approx([0.23, 0.43, 0.63, 0.83, 1.03], abs=1e-6)
    bridge = profile(scene, np.full(3, 4.2), 3.6)
    assert bridge == pytest.approx(1.03, abs=1e-6)
    assert [scene.z(4.2, y) for y in (3.2, 4.0)] == pytest.approx([0.0, 0.0], abs=1e-6)
    rise = scene.z(5.5, 3.6) - scene.z(6.5, 3.6)
    assert np.degrees(np.arctan(rise)) == pytest.approx(27.0, abs=0.1)


def test_relief_is_the_height_range_in_a_window() -> None:
    random = np.random.default_rng(0)
    height = random.normal(size=(20, 30)).astype(np.float32)
    padded = np.pad(height, 2, mode="edge")
    want = [[np.ptp(padded[r : r + 5, c : c + 5]) for c in range(30)] for r in range(20)]
    assert relief(height, 2) == pytest.approx(np.array(want))


def test_a_survey_does_not_see_behind_a_wall() -> None:
    height = np.zeros((50, 100), np.float32)
    height[:, 50:52] = 1.0
    seen = np.isfinite(
        survey(Surface(height, 0.1, (0.0, 0.0)), ((2.0, 2.5, 0.7),), 0, noise=0.0, grazing=0.0, looks=1)
    )
    assert seen[:, 5:50].mean() > 0.99
    assert not seen[:, 54:].any()


def test_every_maze_is_different_and_all_its_rooms_are_reached() -> None:
    first, second = load_scene("maze", seed=1), load_scene("maze", seed=2)
    assert first.height.tobytes() != second.height.tobytes()
    for scene in (first, second):
        free = relief(scene.height, round(0.45 / scene.resolution)) < 0.1
        reached = np.zeros_like(free)
        x, y, _ = scene.start
        reached[round(y / scene.resolution), round(x / scene.resolution)] = True
        while True:
            grown = reached.copy()
            for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
                grown |= np.roll(reached, step, axis)
            grown &= free
            if (grown == reached).all():
                break
            reached = grown
        for gx, gy, _ in scene.goals.values():
            assert reached[round(gy / scene.resolution), round(gx / scene.resolution)]
