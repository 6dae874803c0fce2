"""How far the body can go: against a plain oracle, and on ground whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hal.robots.go2w.facts import BODY_LENGTH, BODY_WIDTH
from hal.safety.swept import (
    CLEAR,
    DROP,
    FACE,
    FACE_NOISE,
    FACE_SAMPLES,
    GAP,
    HOLE,
    LIDAR,
    PLANTS,
    SAMPLES_BEFORE,
    SWEEP,
    TRACK_SPACING,
    UNSEEN,
    WHEELS,
    Body,
    Stand,
    Surroundings,
    height_under,
    leaves_on,
    nearest_obstacle,
    occupy,
    shells,
    stand_of,
    straight_tracks,
    turn_tracks,
    under,
)
from tests.hal.safety.ground import BODY, CORNER, FRONT, HIGH, KERB, RES, ROBOT, SIDE, N, X, Y, ground, look
from tests.places import cases


def test_tracks_begin_under_the_body_and_lead_away_from_it() -> None:
    for tracks in (
        straight_tracks(1.0, 1.0, BODY),
        straight_tracks(1.0, -1.0, BODY),
        turn_tracks(0.6, 1.0, BODY),
        turn_tracks(0.6, -1.0, BODY),
    ):
        inside = (np.abs(tracks[:, :, 0]) < FRONT - 1e-9) & (np.abs(tracks[:, :, 1]) < SIDE + 1e-9)
        assert inside[:, :SAMPLES_BEFORE].all()
        rim = np.isclose(np.abs(tracks[:, SAMPLES_BEFORE, 0]), FRONT) | np.isclose(
            np.abs(tracks[:, SAMPLES_BEFORE, 1]), SIDE
        )
        assert rim.all()
        assert (
            np.hypot(*np.diff(tracks[:, SAMPLES_BEFORE:], axis=1).transpose(2, 0, 1)) < TRACK_SPACING + 1e-9
        ).all()


@pytest.mark.parametrize("turn", [-1.0, 1.0])
def test_the_tracks_of_a_turn_cover_what_the_body_sweeps(turn: float) -> None:
    tracks = turn_tracks(0.6, turn, BODY)[:, SAMPLES_BEFORE:].reshape(-1, 2)
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.5, 0.5, (4000, 2))

    def within(angle: float) -> NDArray[np.bool_]:
        c, s = math.cos(angle), math.sin(angle)
        u, v = points[:, 0] * c + points[:, 1] * s, points[:, 1] * c - points[:, 0] * s
        return (np.abs(u) <= FRONT) & (np.abs(v) <= SIDE)

    swept = np.any([within(turn * a) for a in np.linspace(0.0, 0.6, 61)], axis=0) & ~within(0.0)
    near = np.hypot(*(points[swept, None] - tracks[None]).transpose(2, 0, 1)).min(axis=1)
    assert near.max() < TRACK_SPACING


@pytest.mark.parametrize("rise", [HIGH, -HIGH, 0.16, -0.16])
def test_a_face_and_a_drop_beyond_the_robots_step_end_the_way(rise: float) -> None:
    found = look(ground(np.where(X > 0.70, rise, 0.0)))["ahead"]
    assert found.kind == (FACE if rise > 0.0 else DROP)
    assert found.free == pytest.approx(0.70 - FRONT, abs=RES)
    assert found.height == pytest.approx(abs(rise), abs=0.04)
    behind = look(ground(np.where(X < -0.70, rise, 0.0)))["behind"]
    assert (behind.kind, behind.free) == (found.kind, pytest.approx(found.free, abs=RES))


@pytest.mark.parametrize(
    "height",
    [
        np.where(X > 0.70, KERB, 0.0),
        np.where(X > 0.70, -KERB, 0.0),
        np.clip(X - 0.4, 0.0, None) * math.tan(math.radians(25.0)),
        np.where(np.abs(X) < 0.1, KERB, 0.0),  # astride a bar
        np.where(X > 0.0, KERB, 0.0),  # half up a kerb
        np.where(np.abs(X - 0.74) < 0.06, -0.6, 0.0),  # a crack no wider than a wheel crosses
        np.where(np.abs(Y) > SIDE + RES, HIGH, 0.0),  # between two walls
        np.where(np.abs(X - 0.74) < 0.06, np.nan, 0.0),  # a slit no wider than that which nobody saw
    ],
)
def test_what_the_controller_drives_over_is_no_obstacle(height: NDArray[Any]) -> None:
    found = look(ground(height))
    assert (found["ahead"].kind, found["behind"].kind) == (CLEAR, CLEAR)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_drives_on_ground_that_the_map_knows_alone(side: float) -> None:
    name, other = ("ahead", "behind") if side > 0.0 else ("behind", "ahead")
    found = look(ground(np.where(side * X > 0.70, np.nan, 0.0)))
    assert (found[name].kind, found[other].kind) == (UNSEEN, CLEAR)
    assert found[name].free == pytest.approx(0.70 - FRONT, abs=RES)
    nothing = look(ground(np.where((np.abs(X) > FRONT) | (np.abs(Y) > SIDE), np.nan, 0.0)))
    assert [reach.kind for reach in nothing.values()] == [UNSEEN, UNSEEN, CLEAR, CLEAR]
    assert nothing[name].free < RES


def test_a_drop_begins_behind_the_last_ground_that_the_map_knows() -> None:
    height = np.where(X > 1.0, -0.5, np.where(X > 0.65, np.nan, 0.0))
    found = look(ground(height))["ahead"]
    assert found.kind == DROP
    assert found.free == pytest.approx(0.65 - FRONT, abs=RES)


def test_what_a_lifted_wheel_felt_is_neither_face_nor_drop() -> None:
    for wrong in (0.22, -0.22):
        spot = (np.hypot(X - 0.40, Y - 0.15) < 0.10) | (np.hypot(X + 0.30, Y + 0.15) < 0.10)
        found = look(ground(np.where(spot, wrong, 0.0), source=np.where(spot, WHEELS, LIDAR)))
        assert {reach.kind for reach in found.values()} == {CLEAR}


def test_the_robot_stands_on_the_median_of_what_lies_under_it() -> None:
    rng = np.random.default_rng(2)
    height = (0.3 * X - 0.2 * Y + np.where(rng.random(X.shape) < 0.2, 0.5, 0.0)).astype(np.float32)
    height[rng.random(X.shape) < 0.3] = np.nan
    for x, y, yaw in rng.uniform(-1.0, 1.0, (8, 3)):
        up = np.array([-0.3, 0.2, 1.0]) / math.sqrt(1.13)
        stand = stand_of(ground(height), (x, y, yaw), up, BODY)
        c, s = math.cos(yaw), math.sin(yaw)
        assert stand[1:] == pytest.approx((0.3 * c - 0.2 * s, -0.2 * c - 0.3 * s))
        u, v = c * (X - x) + s * (Y - y), c * (Y - y) - s * (X - x)
        under = (np.abs(u) <= FRONT) & (np.abs(v) <= SIDE) & np.isfinite(height)
        want = np.median(height[under] - stand[1] * u[under] - stand[2] * v[under])
        assert stand[0] == pytest.approx(want, abs=1e-6)
        assert stand[0] == pytest.approx(0.3 * x - 0.2 * y, abs=0.01)
    nothing = np.full((3, 3), np.nan, np.float32)
    assert math.isnan(height_under(nothing, 0.0, 0.0, RES, 0.0, 0.0, 0.0, 0.0, 0.0, FRONT, SIDE))


def test_a_trench_wider_than_a_wheel_crosses_is_a_drop() -> None:
    assert look(ground(np.where(np.abs(X - 0.85) < 0.16, -0.6, 0.0)))["ahead"].kind == DROP


def test_a_drop_behind_ground_that_is_hidden_is_seen() -> None:
    hidden = np.where(X > 0.70, np.nan, 0.0)
    assert look(ground(np.where(X > 1.0, -0.5, hidden)))["ahead"].kind == DROP
    found = look(ground(hidden, bound=np.where(X > 0.70, -0.3, np.nan)))["ahead"]
    assert found.kind == DROP
    assert found.free == pytest.approx(0.70 - FRONT, abs=RES)
    assert look(ground(hidden, bound=np.where(X > 0.70, -0.05, np.nan)))["ahead"].kind == UNSEEN


def test_a_wall_beside_the_body_stops_the_turn_and_not_the_drive() -> None:
    found = look(ground(np.where(Y > 0.30, HIGH, 0.0)))
    assert (found["ahead"].kind, found["behind"].kind) == (CLEAR, CLEAR)
    # The front left corner reaches y = 0.30 when it has turned by this.
    angle = math.asin(0.30 / math.hypot(FRONT, SIDE)) - math.atan2(SIDE, FRONT)
    assert found["left"].kind == FACE
    assert found["left"].free == pytest.approx(angle, abs=0.1)
    assert found["right"].free == pytest.approx(found["left"].free, abs=0.1)


def test_what_the_newest_sweep_shows_ends_the_way() -> None:
    there = (np.abs(X + 0.60) < 0.05) & (np.abs(Y) < 0.1)
    found = look(ground(np.zeros_like(X), occupied=there))
    assert (found["behind"].kind, found["ahead"].kind) == (SWEEP, CLEAR)
    assert found["behind"].free == pytest.approx(0.55 - FRONT, abs=RES)


@pytest.mark.parametrize("front", np.arange(0.0, 0.5, 0.02))
@pytest.mark.parametrize(
    "floor", [(-0.4, -0.4, -0.16), (-0.4, -0.05, -0.16), (-0.4, -0.16, -0.05), (-0.16, -0.4, -0.4)]
)
def test_a_gap_whose_rim_the_map_shows_half_as_deep_is_crossed(
    front: float, floor: tuple[float, ...]
) -> None:
    """As a gap of 10 cm was mapped: three cells, the last ones mixed of floor and rim."""
    height, col = np.zeros_like(X), round(0.6 / RES) + N // 2
    height[:, col : col + 3] = floor
    found = look(ground(height), (front, 0.0, 0.0))["ahead"]
    assert found.kind == CLEAR, (found.kind, found.height, found.free)


@pytest.mark.parametrize("front", np.arange(0.0, 0.5, 0.02))
@pytest.mark.parametrize("floor", [(-0.22, -0.4, -0.4), (-0.4, -0.4, -0.22), (-0.2, -0.4, -0.2)])
def test_a_robot_that_climbs_half_the_depth_of_a_gap_crosses_it_too(
    front: float, floor: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells half over the gap are a step for it: it must not be taken to stand on the floor when the near rim is out of
    sight under its body."""
    monkeypatch.setitem(globals(), "ROBOT", replace(ROBOT, max_step=0.20))
    height, col = np.zeros_like(X), round(0.6 / RES) + N // 2
    height[:, col : col + 3] = floor
    found = look(ground(height), (front, 0.0, 0.0))["ahead"]
    assert found.kind == CLEAR, (found.kind, found.height, found.free)


@pytest.mark.parametrize("floor", [math.nan, -0.05, -0.4])
def test_a_hole_that_the_map_tells_to_be_wide_ends_the_way_however_few_cells_it_has(floor: float) -> None:
    """What the guard would cross by its cells, three of them or one, and however little of its depth is known."""
    height, col = np.zeros_like(X), round(0.8 / RES) + N // 2
    height[:, col : col + 3] = math.nan
    source = np.where(np.isnan(height), 0, LIDAR)
    bound = np.where(np.isnan(height), floor, math.nan)
    assert look(ground(height, bound=bound, source=source))["ahead"].kind == CLEAR
    source[N // 2, col + 1] = HOLE
    found = look(ground(height, bound=bound, source=source))["ahead"]
    assert found.kind in (GAP, DROP)
    assert 0.8 - FRONT - 2 * RES < found.free < 0.8 - FRONT + RES
    beside = np.roll(source, 12, axis=0)
    assert look(ground(height, bound=bound, source=beside))["ahead"].kind == CLEAR, "the body passes it"
    under = look(ground(height, bound=bound, source=source), (0.8 - FRONT + 0.08, 0.0, 0.0))["ahead"]
    assert under.kind == CLEAR, "what lies under the body is crossed"


@pytest.mark.parametrize("front", np.arange(0.0, 0.4, 0.04))
def test_a_face_behind_a_gap_or_a_wide_pit_still_ends_the_way(front: float) -> None:
    col = round(0.8 / RES) + N // 2
    higher = np.where(X > 0.9, 0.2, 0.0)
    higher[:, col : col + 2] = -0.4
    assert look(ground(higher), (front, 0.0, 0.0))["ahead"].kind == FACE
    pit = np.where((X > 0.78) & (X < 1.1), -0.16, 0.0)
    assert look(ground(pit), (front, 0.0, 0.0))["ahead"].kind == DROP
    shallow = np.where((X > 0.78) & (X < 1.1), -0.13, 0.03)
    assert look(ground(shallow), (front, 0.0, 0.0))["ahead"].kind in (DROP, FACE)


@pytest.mark.parametrize("yaw", np.linspace(-3.0, 3.0, 7))
def test_the_answer_turns_and_moves_with_the_robot(yaw: float) -> None:
    x, y = 0.3, -0.2
    ahead = (X - x) * math.cos(yaw) + (Y - y) * math.sin(yaw)
    found = look(ground(np.where(ahead > 0.75, HIGH, 0.0)), (x, y, yaw))
    assert found["ahead"].kind == FACE
    assert found["ahead"].free == pytest.approx(0.75 - FRONT, abs=RES * 1.5)
    assert found["behind"].kind == CLEAR


def oracle(
    tracks: NDArray[Any],
    around: Surroundings,
    pose: tuple[float, float, float],
    stand: Stand,
    wall: NDArray[Any],
    *edges: int,
) -> tuple[int, int]:
    """The same rules, written for reading: (sample, kind) of the first obstacle on any track. `edges`: gap and
    blind."""
    limit, rise = ROBOT.max_step + FACE_NOISE, math.tan(ROBOT.max_slope) * TRACK_SPACING
    x, y, yaw = pose
    rows, cols = around.height.shape
    best = (tracks.shape[2], CLEAR)
    walled = np.zeros(tracks.shape[1:3], bool)
    for layer, k in np.ndindex(*tracks.shape[:2]):
        u, v = tracks[layer, k].T
        col = np.floor((x + math.cos(yaw) * u - math.sin(yaw) * v - around.origin[0]) / RES + 0.5).astype(int)
        row = np.floor((y + math.sin(yaw) * u + math.cos(yaw) * v - around.origin[1]) / RES + 0.5).astype(int)
        on = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        row, col = np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)
        known = np.where(on, around.height[row, col], np.nan).astype(float)
        bound = np.where(on, around.bound[row, col], np.nan).astype(float)
        source = np.where(on, around.source[row, col], 0)
        busy = on & (around.occupied[row, col] > 0)
        plane = stand[0] + stand[1] * u + stand[2] * v
        if layer > 0:
            walled[k] |= on & (wall[row, col] > 0)
        spread = np.where(on, around.variance[row, col], 0.0).astype(float)
        found = _walk(known, bound, source, busy, spread, plane, limit, rise, walled[k], *edges)
        best = min(best, *found, key=lambda end: end[0])
    return best


def _walk(
    known: NDArray[Any],
    bound: NDArray[Any],
    source: NDArray[Any],
    busy: NDArray[Any],
    spread: NDArray[Any],
    plane: NDArray[Any],
    limit: float,
    rise: float,
    walled: NDArray[Any],
    gap: int,
    blind: int,
) -> list[tuple[int, int]]:
    stood: list[tuple[int, float]] = []  # samples the robot would stand on, with their heights
    sure = [SAMPLES_BEFORE]  # samples that the map knows
    ends = [(len(known), CLEAR)]
    last, i, level = 0, 0, float(plane[0])
    rim, over = math.nan, -1
    while i < len(known):
        if busy[i] and i > SAMPLES_BEFORE:
            return [*ends, (i, SWEEP)]
        if source[i] == HOLE and i > SAMPLES_BEFORE and not walled[i]:
            return [(min(i, max(sure) + 1), GAP), *ends]
        if walled[i]:
            sure.append(i)
            i += 1
            continue
        if i - max(sure) > blind:
            ends.append((max(sure) + 1, UNSEEN))
        below = math.isnan(known[i]) and bound[i] < level - limit
        if math.isnan(known[i]) and not below:
            i += 1
            continue
        height = bound[i] if below else known[i]
        changes = [0.0]
        if not math.isnan(level):
            change = told(height - level, spread[i] + spread[last], limit)
            far = rise * max(0, i - last - FACE_SAMPLES // 2)
            changes.append(max(0.0, change - far) if change > 0.0 and source[i] != WHEELS else change)
            changes += [
                told(shrunk(height - h, rise * FACE_SAMPLES / 2), spread[i] + spread[j], limit)
                for j, h in stood
                if i - FACE_SAMPLES <= j and j < last
            ]
        worst = max(changes, key=abs)
        far_rim = i <= over and abs(height - rim) <= limit
        far_rim |= i <= SAMPLES_BEFORE and abs(height - plane[i]) <= limit
        if worst > limit and far_rim:
            last, level = i, height
            stood = [(last, level)]
            sure.append(i)
            i += 1
            continue
        if worst < -limit and source[i] != WHEELS and not math.isnan(level):
            rim, over = level, last + gap + 1
        if abs(worst) > limit:
            if i <= SAMPLES_BEFORE or source[i] == WHEELS:
                sure.append(i)
                i += 1
                continue
            if worst > 0.0:
                return [*ends, (i, FACE)]
            landing = [
                j
                for j in range(i + 1, min(len(known), last + gap + 2))
                if source[j] != WHEELS
                and not walled[j]
                and not any(
                    source[m] == HOLE and m > SAMPLES_BEFORE and not walled[m] for m in range(i + 1, j + 1)
                )
                and not math.isnan(known[j])
                and abs(known[j] - level) <= limit
            ]
            if not landing:
                return [(min(i, max(sure) + 1), DROP), *ends]
            last, level = landing[0], known[landing[0]]
            stood = [(last, level)]
            sure.append(last)
            i = last
        elif not below:
            stood.append((i, height))
            sure.append(i)
            last, level = i, height
        i += 1
    return ends


def shrunk(value: float, by: float) -> float:
    """Nearer to zero by as much."""
    return math.copysign(max(0.0, abs(value) - by), value)


def told(apart: float, variance: float, limit: float) -> float:
    """Nothing of what is above the limit and may all be noise."""
    noise = min(3.0 * variance**0.5, 0.08)
    return 0.0 if limit < abs(apart) <= noise else apart


@pytest.mark.parametrize(
    ("max_step", "high", "sigma", "seen"),
    [
        (0.02, 0.07, 0.025, False),
        (0.02, 0.07, 0.005, True),
        (0.02, 0.10, 1.0, True),
        (0.10, 0.16, 0.02, True),
        (0.10, 0.16, 1.0, True),
    ],
)
def test_a_face_that_may_be_noise_alone_holds_no_robot_of_small_steps(
    monkeypatch: pytest.MonkeyPatch, max_step: float, high: float, sigma: float, seen: bool
) -> None:
    """One point of a LiDAR of 2 cm may be off by 6 cm. What is higher than any noise holds every robot."""
    monkeypatch.setattr("tests.hal.safety.ground.ROBOT", replace(ROBOT, max_step=max_step))
    height = np.where((X > 0.7) & (X < 0.8), high, 0.0)
    around = ground(height, variance=np.where(height > 0.0, sigma**2, 0.01**2))
    assert (look(around)["ahead"].kind == FACE) is seen


@pytest.mark.parametrize("seed", cases(12, 2))
def test_the_kernel_does_what_the_oracle_says_on_random_ground(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = set()
    for _ in range(12):
        height = rng.choice([0.0, 0.02, 0.05], X.shape) * rng.random() + X * rng.uniform(-0.4, 0.4)
        for _ in range(rng.integers(0, 5)):
            cx, cy = rng.uniform(-1.0, 1.0, 2)
            wide, deep = rng.uniform(0.02, 0.4, 2)
            height += np.where((np.abs(X - cx) < wide) & (np.abs(Y - cy) < deep), rng.uniform(-0.5, 0.5), 0.0)
        height = np.where(rng.random(X.shape) < rng.choice([0.0, 0.3]), np.nan, height)
        bound = np.where(
            np.isnan(height) & (rng.random(X.shape) < 0.3), rng.uniform(-0.4, 0.2, X.shape), np.nan
        )
        source = np.where(np.isnan(height), 0, rng.choice([WHEELS, LIDAR, 3], X.shape, p=[0.05, 0.9, 0.05]))
        source = np.where(rng.random(X.shape) < rng.choice([0.0, 0.002]), HOLE, source)
        occupied = rng.random(X.shape) < rng.choice([0.0, 0.001])
        variance = rng.choice([0.0, 1e-4, 4e-4, 1e-2], X.shape)
        around = ground(height, bound=bound, source=source, occupied=occupied, variance=variance)
        pose = (float(rng.uniform(-1.5, 1.5)), float(rng.uniform(-1.5, 1.5)), float(rng.uniform(-3.0, 3.0)))
        tilt = rng.uniform(-0.3, 0.3, 2)
        stand = stand_of(around, pose, np.array([*tilt, math.sqrt(1.0 - tilt @ tilt)]), BODY)
        gap = math.ceil((ROBOT.max_gap + RES) / TRACK_SPACING)
        wall = (rng.random(X.shape) < rng.choice([0.0, 0.1])).astype(np.uint8)
        body = Body(*(BODY - rng.choice([0.0, 0.05], 4)))
        for tracks, blind in (
            (straight_tracks(0.7, 1.0, BODY)[None], gap),
            (shells(partial(straight_tracks, 0.7, -1.0), BODY, body), gap),
            (shells(partial(turn_tracks, 0.6, -1.0), BODY, body), 1000),
        ):
            sample, kind, _ = nearest_obstacle(
                *(tracks, around.height, around.bound, around.source, around.occupied, around.variance, wall),
                *(*around.origin, RES, *pose, stand),
                *(ROBOT.max_step + FACE_NOISE, math.tan(ROBOT.max_slope) * TRACK_SPACING, gap, blind),
            )
            assert (sample, kind) == oracle(tracks, around, pose, stand, wall, gap, blind)
            kinds.add(kind)
    assert len(kinds) > 2


def test_a_cell_is_occupied_by_enough_points_that_stand_on_its_ground() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform((-0.2, -0.2, -0.2), (0.6, 0.6, 1.0), (3000, 3))
    heights = rng.uniform(0.0, 0.2, (10, 12)).astype(np.float32)
    lowest = rng.uniform(0.1, 0.4, heights.shape).astype(np.float32)
    out = np.zeros((10, 12), np.uint8)
    occupy(points, heights, 0.02, -0.02, RES, lowest, 0.55, 3, out)
    want = np.zeros((10, 12), int)
    for x, y, z in points:
        c, r = round((x - 0.02) / RES), round((y + 0.02) / RES)
        if 0 <= r < 10 and 0 <= c < 12 and lowest[r, c] < z - heights[r, c] < 0.55:
            want[r, c] += 1
    np.testing.assert_array_equal(out, want >= 3)
    assert 0 < out.sum() < out.size


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_the_way_to_leaves_is_that_of_the_first_sample_over_them(yaw: float) -> None:
    rng = np.random.default_rng(3)
    for tracks, step in (
        (straight_tracks(1.0, 1.0, BODY), TRACK_SPACING),
        (straight_tracks(1.0, -1.0, BODY), TRACK_SPACING),
        (turn_tracks(0.6, 1.0, BODY), 0.05),
    ):
        for share in (0.0, 0.002, 0.02):
            source = np.where(rng.random((N, N)) < share, PLANTS, LIDAR).astype(np.uint8)
            around = ground(np.zeros((N, N)), source=source)
            pose = (*rng.uniform(-0.3, 0.3, 2), yaw)
            first = tracks.shape[1]
            for k, i in np.ndindex(*tracks.shape[:2]):
                if leaves_at(source, pose, *tracks[k, i]):
                    first = min(first, i)
            want = max(0.0, (first - SAMPLES_BEFORE) * step) if first < tracks.shape[1] else math.inf
            if any(leaves_at(source, pose, u, v) for u, v in under(BODY)[:, 0]):
                want = 0.0
            assert leaves_on(tracks, step, around, pose, BODY) == pytest.approx(want)


def leaves_at(source: np.ndarray, pose: tuple[float, float, float], u: float, v: float) -> bool:
    """Whether there are leaves at a place ahead and to the left of a robot [m]."""
    x = pose[0] + math.cos(pose[2]) * u - math.sin(pose[2]) * v - CORNER[0]
    y = pose[1] + math.sin(pose[2]) * u + math.cos(pose[2]) * v - CORNER[1]
    r, c = math.floor(y / RES + 0.5), math.floor(x / RES + 0.5)
    return 0 <= r < N and 0 <= c < N and source[r, c] == PLANTS


def test_a_robot_with_its_rear_in_leaves_goes_no_faster_than_one_with_its_front_in_them() -> None:
    np.testing.assert_allclose(under(BODY)[:, 0].max(axis=0), (FRONT, SIDE))
    np.testing.assert_allclose(under(BODY)[:, 0].min(axis=0), (-FRONT, -SIDE))
    assert len(under(BODY)) > BODY_LENGTH * BODY_WIDTH / TRACK_SPACING**2
    source = np.full((N, N), LIDAR, np.uint8)
    _, x = np.mgrid[0:N, 0:N] * RES
    source[x + CORNER[0] < -0.2] = PLANTS
    around = ground(np.zeros((N, N)), source=source)
    assert leaves_on(straight_tracks(1.0, 1.0, BODY), TRACK_SPACING, around, (0.0, 0.0, 0.0), BODY) == 0.0
    assert (
        leaves_on(straight_tracks(1.0, 1.0, BODY), TRACK_SPACING, around, (0.25, 0.0, 0.0), BODY) == math.inf
    )
