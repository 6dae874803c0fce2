"""Walls that the body touches: what of it is in none, against a plain oracle, and where the robot may go beside
them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hal.safety.contact import DEEPEST_WALL, NEAR_WALL, WALL_REACH, contact_at
from hal.safety.swept import (
    CLEAR,
    DROP,
    FACE,
    FACE_NOISE,
    SWEEP,
    TRACK_SPACING,
    Body,
    Stand,
    Surroundings,
    stand_of,
)
from tests.hal.safety.ground import BODY, FRONT, HIGH, KERB, RES, ROBOT, SIDE, WAYS, X, Y, ground, look


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("deep", [0.03, 0.09])
def test_a_robot_that_leans_at_a_wall_may_drive_along_it_and_no_further(side: float, deep: float) -> None:
    beside = np.where(side * Y > SIDE - deep, HIGH, 0.0)
    found = look(ground(beside))
    assert found["ahead"].free == found["behind"].free == pytest.approx(WALL_REACH - FRONT, abs=2 * RES)
    assert max(found["left"].free, found["right"].free) < 0.1, (
        "a corner of its tail or nose would go in deeper"
    )
    # The wall comes in front of the robot, or ends at a pit.
    corner = np.where((side * Y > SIDE - deep) | ((X > 0.7) & (side * Y > SIDE - 0.25)), HIGH, 0.0)
    assert look(ground(corner))["ahead"].free == pytest.approx(0.7 - FRONT, abs=2 * RES)
    pit = np.where((X > 0.7) & (side * Y > 0.0), -HIGH, beside)
    assert look(ground(pit))["ahead"].kind == DROP
    outside = np.where((X > 0.7) & (side * Y > SIDE - deep), -HIGH, beside)
    assert look(ground(outside))["ahead"].kind == DROP, "under the outer wheel, where the wall has ended"
    # What stands apart from the wall, or what the newest sweep has there, is no part of it.
    post = np.where((np.abs(X - 0.8) < 0.05) & (side * Y > SIDE - deep), HIGH, np.where(X > 0.5, 0.0, beside))
    assert look(ground(post))["ahead"].free == pytest.approx(0.75 - FRONT, abs=2 * RES)
    there = (np.abs(X - 0.7) < 0.05) & (np.abs(side * Y - SIDE + deep) < 0.05)
    assert look(ground(beside, occupied=there))["ahead"].kind == SWEEP
    # Deeper in, something is wrong: it does not move.
    within = look(ground(np.where(side * Y > SIDE - DEEPEST_WALL - 2.0 * RES, HIGH, 0.0)))
    assert within["ahead"].free == within["behind"].free == 0.0
    apart = ground(np.where(side * Y > SIDE + NEAR_WALL + RES, HIGH, 0.0))
    assert contact_at(apart, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ROBOT) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_far_side_of_a_thin_wall_is_not_the_robots_business(side: float) -> None:
    """It leans over a parapet; behind it, as a prior map shows it, there is nothing."""
    wall = np.abs(side * Y - SIDE + 0.08) < 0.5 * RES
    for behind in (-2.0, np.nan):
        found = look(ground(np.where(wall, HIGH, np.where(side * Y > SIDE - 0.08, behind, 0.0))))
        assert found["ahead"].free == found["behind"].free == pytest.approx(WALL_REACH - FRONT, abs=2 * RES)
    ends = np.where(wall & (X > -0.6), HIGH, np.where(side * Y > SIDE - 0.08, -2.0, 0.0))
    found = look(ground(ends))["behind"]
    assert (found.kind, found.free) == (DROP, pytest.approx(0.6 - FRONT, abs=2 * RES))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_askew_at_a_wall_may_leave_it(side: float) -> None:
    """Its nose is in the wall: it may back off, and turn its nose away; its tail is free."""
    for degrees in (8.0, 15.0, 25.0):
        lean = math.radians(degrees)
        found = look(ground(np.where(across(lean, side) > reach(lean) - 0.04, HIGH, 0.0)))
        away, into = ("right", "left") if side > 0.0 else ("left", "right")
        assert found["behind"].kind == CLEAR
        assert found[away].free > 0.1
        assert found["ahead"].free * math.sin(lean) < 2.0 * RES
        assert found[into].free < 0.1
    # Its front is at a wall, a little askew: it turns on the side that touches.
    lean = math.radians(84.0)
    found = look(ground(np.where(across(lean, side) > reach(lean) - 0.04, HIGH, 0.0)))
    assert (found["behind"].kind, found["ahead"].free) == (CLEAR, pytest.approx(0.0, abs=RES))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beside_a_robot_that_leans_a_kerb_is_no_wall(side: float) -> None:
    """Leaning by 25 deg it has the kerb's top 0.19 m above its plane; what slows it down there lets it slide."""
    kerb = np.where(side * Y > SIDE - 0.06, KERB, 0.0)
    assert (
        contact_at(ground(kerb), (0.0, 0.0, 0.0), (0.0, 0.0, -side * math.tan(math.radians(25.0))), ROBOT)
        is None
    )


def across(lean: float, side: float) -> NDArray[Any]:
    """Distance [m] of the cells towards a wall that the heading meets at `lean` [rad], on the left (1.0) or on the
    right."""
    return np.sin(lean) * X + side * np.cos(lean) * Y


def reach(lean: float) -> float:
    """Of the body towards it [m]."""
    return FRONT * math.sin(lean) + SIDE * math.cos(lean)


@pytest.mark.parametrize("seed", range(6))
def test_no_way_that_is_free_leads_deeper_into_a_wall(seed: int) -> None:
    """Bodies at walls at all angles, by the true wall: what is allowed with the guard's margin brings it in deeper by
    two cells of the map at most."""
    rng = np.random.default_rng(seed)
    free = 0
    for _ in range(60):
        lean, now = rng.uniform(-math.pi, math.pi), rng.uniform(-0.02, 0.10)
        toward = np.array([math.cos(lean), math.sin(lean)])
        off = FRONT * abs(toward[0]) + SIDE * abs(toward[1]) - now
        yaw = rng.uniform(-math.pi, math.pi)
        c, s = math.cos(yaw), math.sin(yaw)
        u, v = c * X + s * Y, c * Y - s * X
        height = np.where(toward[0] * u + toward[1] * v > off, HIGH, rng.uniform(0.0, 0.02, X.shape))
        for name, found in look(ground(height), (0.0, 0.0, yaw)).items():
            step = WAYS[name][1]
            ways = np.arange(0.0, max(0.0, found.free - 0.03 * step / TRACK_SPACING) + 1e-9, step)
            if len(ways) > 1:
                deepest = max(depth(name, way, toward, off) for way in ways)
                assert deepest < max(now, 0.0) + 2.0 * RES
                free += 1
    assert free > 100


def depth(name: str, way: float, toward: NDArray[Any], off: float) -> float:
    """How deep [m] the body is in a wall behind `off` [m] along `toward` when it has gone so far [m or rad]."""
    corners = np.array([(x, y) for x in (FRONT, -FRONT) for y in (SIDE, -SIDE)])
    if name in ("left", "right"):
        c, s = math.cos(way), math.sin(way) * (1.0 if name == "left" else -1.0)
        corners = corners @ np.array([[c, s], [-s, c]])
    else:
        corners[:, 0] += way if name == "ahead" else -way
    return float((corners @ toward).max() - off)


@pytest.mark.parametrize("seed", range(6))
def test_what_stands_in_the_way_is_seen_beside_a_wall_as_well(seed: int) -> None:
    """A box of 0.3 m anywhere on the way of a robot that touches a wall, apart from it."""
    rng = np.random.default_rng(seed)
    for _ in range(40):
        deep, side = rng.uniform(0.0, 0.10), rng.choice([-1.0, 1.0])
        beside = np.where(side * Y > SIDE - deep, HIGH, 0.0)
        middle = side * rng.uniform(-SIDE - 0.1, SIDE - deep - 0.15 - 3 * RES)
        x = rng.choice([-1.0, 1.0]) * rng.uniform(FRONT + 0.25, WALL_REACH)
        box = (np.abs(X - x) < 0.15) & (np.abs(Y - middle) < 0.15)
        found = look(ground(np.where(box, HIGH, beside)))["ahead" if x > 0.0 else "behind"]
        assert found.kind == FACE
        assert found.free == pytest.approx(abs(x) - 0.15 - FRONT, abs=1.5 * RES)
        found = look(ground(beside, occupied=box))["ahead" if x > 0.0 else "behind"]
        assert (found.kind, found.free) == (SWEEP, pytest.approx(abs(x) - 0.15 - FRONT, abs=1.5 * RES))


@pytest.mark.parametrize("seed", range(6))
def test_the_part_of_the_body_that_is_in_no_wall_is_what_the_oracle_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    none = 0
    for _ in range(10):
        height = np.where(rng.random(X.shape) < 0.02, np.nan, rng.uniform(0.0, 0.2, X.shape))
        for _ in range(rng.integers(0, 3)):
            lean, off = rng.uniform(-math.pi, math.pi), rng.uniform(0.1, 0.5)
            ahead = math.cos(lean) * X + math.sin(lean) * Y
            height = np.where((ahead > off) & (ahead < off + rng.uniform(0.05, 0.3)), HIGH, height)
        around, pose = ground(height), (*rng.uniform(-0.1, 0.1, 2).tolist(), float(rng.uniform(-3.0, 3.0)))
        stand = stand_of(around, pose, np.array([0.1, 0.05, 1.0]) / math.sqrt(1.0125), BODY)
        contact = contact_at(around, pose, stand, ROBOT)
        body, flat, wall = contact_oracle(around, pose, stand)
        if contact is None:
            assert not wall.any()
            none += 1
            continue
        assert contact.clear == pytest.approx(body, abs=1e-6)
        assert contact.flat == flat
        np.testing.assert_array_equal(contact.wall, wall)
    assert none < 10


def contact_oracle(
    around: Surroundings, pose: tuple[float, float, float], stand: Stand
) -> tuple[Body, tuple[bool, bool], NDArray[np.bool_]]:
    """What of the body is in no wall, whether walls are along its sides, and the cells of those walls: the same rules,
    written for reading."""
    limit = ROBOT.max_step + FACE_NOISE
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = X - pose[0], Y - pose[1]
    u, v = c * dx + s * dy, c * dy - s * dx
    half = 0.5 * RES * (abs(c) + abs(s))
    above = around.height - (stand[0] + stand[1] * u + stand[2] * v)
    long, wide = FRONT - np.abs(u) + half, SIDE - np.abs(v) + half
    shifts = [(a, b) for a in range(-2, 3) for b in range(-2, 3)]
    lowest = np.nanmin([np.roll(around.height, shift, (0, 1)) for shift in shifts], axis=0)
    face = around.height - lowest > limit + 2.0 * RES * math.tan(ROBOT.max_slope)
    inside = (
        (above > limit)
        & face
        & (np.minimum(long, wide) > -NEAR_WALL)
        & (np.minimum(long, wide) <= DEEPEST_WALL)
    )
    corner = np.maximum(long, wide) <= DEEPEST_WALL
    ends = dict(zip(Body._fields, BODY.grown(NEAR_WALL), strict=True))
    for now in (inside & ~corner, inside & corner):
        for r, k in np.argwhere(now):
            end, edge = ("front" if u[r, k] > 0.0 else "back"), ("left" if v[r, k] > 0.0 else "right")
            more = ends[end] - (abs(u[r, k]) - half), ends[edge] - (abs(v[r, k]) - half)
            if min(more) <= 0.0:
                continue
            at_end = more[0] < more[1] if corner[r, k] else long[r, k] < wide[r, k]
            ends[end if at_end else edge] -= more[0] if at_end else more[1]
    shifts = [(a, b) for a, b in shifts if max(abs(a), abs(b)) < 2]
    highest = np.nanmax([np.roll(around.height, shift, (0, 1)) for shift in shifts], axis=0)
    walls = (
        (above > 0.5 * limit) & (highest - around.height + above > limit) & (np.hypot(dx, dy) <= WALL_REACH)
    )
    wall, size = inside, -1
    while size != wall.sum():
        size = wall.sum()
        grown = np.any([np.roll(wall, (a, b), (0, 1)) for a in range(-2, 3) for b in range(-2, 3)], axis=0)
        wall = wall | (grown & walls)
    sides = [u[inside & (wide <= DEEPEST_WALL) & (edge * v > 0.0)] for edge in (1.0, -1.0)]
    left, right = (min(at.max(initial=0.0), -at.min(initial=0.0)) > FRONT / 2 for at in sides)
    return Body(**ends), (left, right), wall
