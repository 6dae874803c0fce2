"""A wheel that turns on the spot stops at faces that the guard lets the body drive over."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.safety.planned import free_turn, mapped
from hal.safety.swept import turn_step
from hal.types import Capabilities
from planning.graph.params import GraphParams
from planning.search.turn_clearance import TURN_FACE, wheels_turn
from tests.hal.safety.ground import BODY, CORNER, RES, N, X, Y

PARAMS, FLAT = GraphParams(max_slope=0.44), GraphParams(max_slope=1e-9)
AXLE, TREAD, TREAD_WIDTH = PARAMS.axle, PARAMS.tread, PARAMS.tread_width


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_wheel_that_comes_to_a_bar_ends_a_turn_on_the_spot_though_the_guard_lets_it(way: float) -> None:
    height = np.where(np.abs(X - 0.45) < 0.05, 0.15, 0.0).astype(np.float32)  # driven over straight ahead
    around, robot = mapped(height, CORNER, RES), Capabilities("", max_step=0.20, max_slope=0.44, max_gap=0.10)
    for x in (0.20, 0.45):  # the bar lies ahead of the front wheels, and between the axles
        assert free_turn(around, (x, 0.0, 0.0), way * 1.5, robot) == 1.5
        assert 0.0 < wheels_turn(around, (x, 0.0, 0.0), way * 1.5, BODY, PARAMS) < 1.2
    assert wheels_turn(around, (0.0, 0.0, 0.0), way * 1.5, BODY, PARAMS) == 1.5, "out of reach"
    low = mapped(0.4 * height, CORNER, RES)
    assert wheels_turn(low, (0.45, 0.0, 0.0), way * 1.5, BODY, PARAMS) == 1.5
    ramp = mapped((np.tan(0.4) * X).astype(np.float32), CORNER, RES)
    assert wheels_turn(ramp, (0.0, 0.0, 0.3), way * 1.5, BODY, PARAMS) == 1.5, "a ramp has no face"


def test_of_wheels_that_turn() -> None:
    rng = np.random.default_rng(6)
    met = 0
    for _ in range(40):
        height = np.where(rng.random((N, N)) < 0.1, np.nan, 0.0).astype(np.float32)
        for _ in range(3):
            x, y = rng.uniform(-0.5, 0.5, 2)
            height[(np.abs(X - x) < 0.06) & (np.abs(Y - y) < 0.06)] = rng.choice([0.05, 0.1, 0.2])
        x, y, yaw = *rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi)
        turn = rng.uniform(-np.pi, np.pi)
        told = wheels_turn(mapped(height, CORNER, RES), (x, y, yaw), turn, BODY, FLAT)
        angles = math.copysign(turn_step(BODY), turn) * np.arange(math.ceil(abs(turn) / turn_step(BODY)) + 1)
        first = len(angles) - 1
        for u in (AXLE, -AXLE):
            for v in (
                side * TREAD + edge for side in (1, -1) for edge in (-TREAD_WIDTH / 2, 0.0, TREAD_WIDTH / 2)
            ):
                radius, at = math.hypot(u, v), yaw + math.atan2(v, u) + angles
                col = np.floor((x + radius * np.cos(at) - CORNER[0]) / RES + 0.5).astype(int)
                row = np.floor((y + radius * np.sin(at) - CORNER[1]) / RES + 0.5).astype(int)
                ground, back = height[row, col], math.ceil(2 * RES / (radius * turn_step(BODY)))
                for i in range(first + 1):
                    if (ground[i] - ground[max(0, i - back) : i] > TURN_FACE).any():
                        first = min(first, i)
        assert told == pytest.approx(min(first * turn_step(BODY), abs(turn)))
        met += told < abs(turn)
    assert 5 < met < 35
