"""Rescue lanes from seeds: dimensions, levels, and a way through every one that may be driven. Seeds below 200 only."""

from math import degrees

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hal.robots import describe
from hal.scenes import SceneError, load_scene
from hal.scenes.elements import BAR_WIDTH, MAPS, PIT_DEPTH, TRACK_WIDTH
from hal.scenes.lanes import GRID_RESOLUTION, LAYOUTS, WALL_HEIGHT, Lane, lane, named
from hal.scenes.shortest import shortest

BODY = (0.35, 0.215)
"""Half length and half width of the body [m]."""
HOLD = 0.02
"""A robot that holds its line this well touches nothing [m]."""
KINDS = (*MAPS, "mixed")
SEEDS = st.integers(0, 199)
CONTROLLER = st.sampled_from(["vmc", "policy"])


def z(one: Lane, points: np.ndarray) -> np.ndarray:
    """Heights at (..., 2) points, nearest cell."""
    cell = np.round((points - one.scene.origin) / GRID_RESOLUTION).astype(int)
    return one.scene.height[cell[..., 1], cell[..., 0]].astype(float)


def poses(one: Lane) -> np.ndarray:
    """(n, 3) x, y, yaw every 2 cm along the way."""
    out = []
    for a, b in zip(one.line[:-1], one.line[1:], strict=True):
        length = float(np.hypot(*(b - a)))
        if length < 1e-6:
            continue
        s = np.arange(0.0, length, 0.02)[:, None] / length
        out.append(np.column_stack([a + s * (b - a), np.full(len(s), np.arctan2(*(b - a)[::-1]))]))
    return np.vstack(out)


def placed(pose: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(n, ..., 2) points of the body in the world."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    shape = (-1,) + (1,) * np.ndim(along)
    x = pose[:, 0].reshape(shape) + c.reshape(shape) * along - s.reshape(shape) * across
    y = pose[:, 1].reshape(shape) + s.reshape(shape) * along + c.reshape(shape) * across
    return np.stack([x, y], axis=-1)


def distance_to_walls(one: Lane, points: np.ndarray) -> np.ndarray:
    """(n,) from each point to the nearest wall's surface [m]."""
    a, b = one.walls[:, :2], one.walls[:, 2:4]
    d = b - a
    share = np.clip(((points[:, None] - a) * d).sum(-1) / (d * d).sum(-1), 0.0, 1.0)
    gap = np.linalg.norm(points[:, None] - (a + share[..., None] * d), axis=-1) - 0.5 * one.walls[:, 4]
    return gap.min(axis=1)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 5), CONTROLLER)
def test_a_lane_is_between_1_1_and_1_2_m_wide_with_walls_of_half_a_metre(seed, level, controller) -> None:
    one = lane(seed, level=level, controller=controller)
    assert 1.10 <= one.width <= 1.20
    column = np.arange(-1.0, 1.0, 0.005)
    for x, y in (one.line[0], one.line[-1]):
        gap = distance_to_walls(one, np.column_stack([np.full_like(column, x), y + column]))
        free = gap[np.abs(column) < 0.5 * one.width] > 0.0
        assert 0.005 * free.sum() == pytest.approx(one.width - 0.04, abs=0.011)
        tall = z(one, np.column_stack([np.full_like(column, x), y + column])) > 0.4
        assert np.abs(column[tall]).min() == pytest.approx(0.5 * one.width, abs=0.04)
    for ax, ay, bx, by, _ in one.walls:
        middle = np.array([0.5 * (ax + bx), 0.5 * (ay + by)])
        beside = middle + 0.12 * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
        ground = z(one, beside[distance_to_walls(one, beside) > 0.05])
        assert z(one, middle) >= WALL_HEIGHT + ground.max() - 1e-6


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(1, 4), CONTROLLER)
@example(185, 2, "vmc")  # two pairs of gaps one behind the other
def test_up_to_level_4_a_body_can_drive_the_way_within_the_capabilities(seed, level, controller) -> None:
    one = lane(seed, level=level, controller=controller)
    able = describe().capabilities(controller)
    line = poses(one)
    # Nothing of the body comes near a wall, nor at corners, where it turns on the spot.
    for along in np.linspace(-BODY[0], BODY[0], 9):
        for across in np.linspace(-BODY[1], BODY[1], 5):
            points = placed(line, np.array(along), np.array(across))
            assert distance_to_walls(one, points).min() > HOLD
    for corner, before, after in zip(one.line[1:-1], one.line[:-2], one.line[2:], strict=True):
        (ux, uy), (vx, vy) = corner - before, after - corner
        if ux * vx + uy * vy < 0.5 * np.hypot(ux, uy) * np.hypot(vx, vy) and np.hypot(vx, vy) > 1e-6:
            ring = corner + 0.41 * np.array([[np.cos(u), np.sin(u)] for u in np.linspace(0, 6.28, 24)])
            assert distance_to_walls(one, ring).min() > HOLD
            assert np.ptp(z(one, ring)) < 0.02, "turns are on level ground"
    # Under each wheel: no face above the robot's, no gap wider than it crosses; trunk and housings between stay off the
    # ground.
    for across in (-0.5 * TRACK_WIDTH, 0.5 * TRACK_WIDTH):
        track = z(one, placed(line, np.array(0.0), np.array(across)))
        floor = track > 0.5 * PIT_DEPTH
        assert np.abs(np.diff(track[floor])).max() <= able.max_step + 0.02
        edges = np.flatnonzero(np.diff(np.concatenate([[True], floor, [True]]).astype(int)))
        assert all(
            0.02 * (b - a) <= able.max_gap + 0.021 for a, b in zip(edges[::2], edges[1::2], strict=True)
        )
    # The plane under the wheels is no steeper than the robot may stand.
    wheels = placed(line, np.array([0.21, 0.21, -0.21, -0.21]), TRACK_WIDTH / 2 * np.array([1, -1, 1, -1]))
    height = z(one, wheels)
    height = np.where(height < 0.5 * PIT_DEPTH, 0.0, height)
    pitch = (height[:, :2].mean(1) - height[:, 2:].mean(1)) / 0.42
    roll = (height[:, ::2].mean(1) - height[:, 1::2].mean(1)) / TRACK_WIDTH
    assert np.arctan(np.hypot(pitch, roll)).max() <= able.max_slope


@settings(max_examples=20, deadline=None)
@given(SEEDS, CONTROLLER)
def test_level_5_has_one_element_beyond_the_capabilities_across_every_way(seed, controller) -> None:
    one = lane(seed, level=5, controller=controller)
    assert one.beyond is not None
    x0, x1, y0, y1 = one.beyond
    inside = (poses(one)[:, 0] > x0) & (poses(one)[:, 0] < x1)
    inside &= (poses(one)[:, 1] > y0) & (poses(one)[:, 1] < y1)
    assert inside.any(), "on the way"
    ends = [(x, y0, x, y1, 0.02) for x in (x0, x1)]
    closed = np.vstack([one.walls, ends])
    assert not np.isfinite(shortest(closed, one.scene.start[:2], one.scene.goals["end"][:2], BODY[1]))
    able = describe().capabilities(controller)
    points = np.stack(np.meshgrid(np.arange(x0 - 0.3, x1 + 0.3, 0.02), [0.5 * (y0 + y1)]), axis=-1)[0]
    profile = z(one, points)
    step = np.abs(np.diff(profile)).max()
    slope = np.abs(profile[20:] - profile[:-20]).max() / 0.4
    gap = 0.02 * (profile < 0.5 * PIT_DEPTH).sum()
    beyond = [step / able.max_step, slope / np.tan(able.max_slope), gap / able.max_gap]
    assert max(beyond) > 1.4


def test_forty_seeds_hold_every_layout_with_every_kind() -> None:
    for first in (0, 160):
        pairs = {(one.layout, one.map) for one in (lane(seed) for seed in range(first, first + 40))}
        assert pairs == {(layout, kind) for layout in LAYOUTS for kind in KINDS}


@pytest.mark.parametrize("controller", ["vmc", "policy"])
def test_no_level_asks_for_more_than_the_capabilities_and_the_fifth_for_much_more(controller) -> None:
    able, asked, beyond = (
        describe().capabilities(controller),
        describe().lanes(controller).within,
        describe().lanes(controller).beyond,
    )
    assert max(asked[k] for k in ("step", "bar", "rail", "posts")) <= able.max_step
    assert asked["posts"] <= able.max_posts
    assert asked["gap"] <= able.max_gap
    assert asked["slope"] <= degrees(able.max_slope)
    assert beyond["gap"][0] > 1.4 * able.max_gap
    assert min(beyond["step"][0], beyond["bar"][0]) > 1.4 * able.max_step
    assert beyond["slope"][0] > 1.3 * degrees(able.max_slope)


def test_a_harder_level_has_higher_bars() -> None:
    tops = []
    for level in (1, 2, 3, 4):
        one = lane(8, level=level, map="bars")
        inside = distance_to_walls(one, poses(one)[:, :2]) > 0.1
        tops.append(float(z(one, poses(one)[inside][:, :2]).max()))
    assert tops == sorted(tops)
    assert 0.02 < tops[0] < 0.06
    assert 0.08 < tops[3] < 0.11
    assert BAR_WIDTH == 0.10


def test_lanes_have_names_with_options() -> None:
    plain, graded = load_scene("lanes:17"), load_scene("lanes:17,level=4,controller=policy,map=bars")
    assert plain.height.tobytes() == lane(17).scene.height.tobytes()
    assert (
        graded.height.tobytes() == lane(17, level=4, controller="policy", map="bars").scene.height.tobytes()
    )
    assert load_scene("lanes", seed=17).height.tobytes() == plain.height.tobytes()
    assert set(plain.goals) == {"end", "home"}
    for wrong in ("lanes:x", "lanes:1,level=9", "lanes:1,level=a", "lanes:1,map=sea", "lanes:1,colour=red"):
        with pytest.raises(SceneError):
            load_scene(wrong)
    assert named("lanes:3,level=5").beyond


def test_the_shortest_way_goes_round_the_end_of_a_wall() -> None:
    walls = np.array([[0.0, -5.0, 0.0, 1.0, 0.0]])
    r, far = 0.2, 2.0
    tangent = np.sqrt(far**2 - r**2)
    arc = np.pi - 2.0 * np.arccos(r / far)
    found = shortest(walls, (-far, 1.0), (far, 1.0), r)
    assert found == pytest.approx(2.0 * tangent + r * arc, rel=0.002)
    assert shortest(walls, (1.0, 0.0), (2.0, 0.0), r) == pytest.approx(1.0)
    box = np.array([[1, -1, 1, 1, 0], [1, 1, -1, 1, 0], [-1, 1, -1, -1, 0], [-1, -1, 1, -1, 0]], float)
    assert shortest(box, (0.0, 0.0), (3.0, 0.0), r) == np.inf


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 5))
def test_the_known_way_is_hardly_longer_than_the_shortest(seed, level) -> None:
    one = lane(seed, level=level)
    length = shortest(one.walls, one.scene.start[:2], one.scene.goals["end"][:2], BODY[1])
    known = float(np.hypot(*np.diff(one.line, axis=0).T).sum())
    assert 2.5 < length <= known + 1e-6
    assert known < 1.5 * length
