"""What the planner is told is what the guard does on the same ground."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.robots.go2w.facts import BODY_LENGTH, BODY_WIDTH
from hal.safety.planned import free_turn, known_behind, mapped
from hal.safety.swept import (
    CLEAR,
    FLAT,
    TRACK_SPACING,
    UNSEEN,
    reach_of,
    straight_tracks,
    turn_step,
    turn_tracks,
)
from tests.hal.safety.ground import BODY, CORNER, RES, ROBOT, N, X, Y, ground


def test_of_ground_behind() -> None:
    rng = np.random.default_rng(4)
    for _ in range(60):
        height = np.where(rng.random((N, N)) < rng.uniform(0.0, 0.8), np.nan, 0.0).astype(np.float32)
        pose = (*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi))
        tracks = straight_tracks(1.0, -1.0, BODY)
        found = reach_of(tracks, TRACK_SPACING, ground(height), pose, FLAT, ROBOT, seen=True)
        told = known_behind(mapped(height, CORNER, RES), pose, BODY, ROBOT.max_gap, 0.4)
        assert found.kind in (UNSEEN, CLEAR)
        assert told == pytest.approx(min(found.free, 0.4))


def test_of_turns() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(60):
        height = np.zeros((N, N), np.float32)
        for _ in range(3):
            x, y = rng.uniform(-0.7, 0.7, 2)
            height[(np.abs(X - x) < 0.06) & (np.abs(Y - y) < 0.06)] = rng.choice([-0.5, 0.1, 0.5])
        pose = (*rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi))
        turn = rng.uniform(-np.pi, np.pi)
        tracks = turn_tracks(3.2, math.copysign(1.0, turn), BODY)
        found = reach_of(tracks, turn_step(BODY), ground(height), pose, FLAT, ROBOT, seen=False)
        told = free_turn(mapped(height, CORNER, RES), pose, turn, ROBOT)
        assert told == pytest.approx(min(found.free, abs(turn)))
        held += told < abs(turn)
    assert 10 < held < 50


def test_with_something_to_spare_a_turn_keeps_farther_from_a_wall() -> None:
    height = np.where(np.abs(Y) > 0.44, 1.0, 0.0).astype(np.float32)  # a passage as wide as the body turns in
    assert 0.5 * math.hypot(BODY_LENGTH, BODY_WIDTH) < 0.44
    around = mapped(height, CORNER, RES)
    assert free_turn(around, (0.0, 0.0, 0.0), math.pi, ROBOT) == math.pi
    assert free_turn(around, (0.0, 0.0, 0.0), math.pi, ROBOT, 0.06) < 1.0
