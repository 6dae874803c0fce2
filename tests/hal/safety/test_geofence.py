"""Polygons that the robot stays in and keeps out of: its whole body, whichever way it moves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.robots.go2w.facts import BODY_LENGTH, BODY_WIDTH
from hal.safety.gate import SafetyGate
from hal.safety.geofence import Fence
from hal.types import VelocityCommand
from tests.hal.safety.test_gate import CAPS, TICK, well

FAR = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)]
AREAS = {
    "a room": ([(-1.2, -1.0), (1.2, -1.0), (1.2, 1.0), (-1.2, 1.0)], {}),
    "a corner that points inwards": (
        [(-1.5, -1.5), (1.5, -1.5), (1.5, 1.5), (0.6, 1.5), (0.5, 0.4), (0.4, 1.5), (-1.5, 1.5)],
        {},
    ),
    "a pond": (None, {"pond": [(0.5, -0.5), (1.5, -0.5), (1.5, 0.5), (0.5, 0.5)]}),
    "a thin line": (None, {"line": [(0.6, -2.0), (0.62, -2.0), (0.62, 2.0), (0.6, 2.0)]}),
    "posts": (
        FAR,
        {
            f"{k}": [(x, y), (x + 0.05, y), (x, y + 0.05)]
            for k, (x, y) in enumerate([(0.6, 0.1), (-0.5, 0.4), (0.1, -0.6), (-0.7, -0.3)])
        },
    ),
}


def rim(fence: Fence) -> np.ndarray:
    """(n, 2) places every cm along all sides."""
    sides = [
        a + np.linspace(0.0, 1.0, round(100 * math.dist(a, b)) + 2)[:, None] * np.subtract(b, a)
        for p in fence.polygons
        for a, b in zip(np.array(p.corners), np.roll(p.corners, -1, axis=0), strict=True)
    ]
    return np.vstack(sides)


def deepest(places: np.ndarray, x: float, y: float, yaw: float) -> float:
    """How far the deepest of the places is inside the body [m]; negative where none is."""
    c, s = math.cos(yaw), math.sin(yaw)
    dx, dy = places[:, 0] - x, places[:, 1] - y
    inside = np.minimum(
        0.5 * BODY_LENGTH - np.abs(c * dx + s * dy), 0.5 * BODY_WIDTH - np.abs(c * dy - s * dx)
    )
    return float(inside.max())


@pytest.mark.parametrize("name", AREAS)
def test_no_motion_takes_any_of_the_body_over_a_side(name: str) -> None:
    rng = np.random.default_rng(7)
    fence = Fence.of(*AREAS[name])
    places = rim(fence)
    gate = SafetyGate(CAPS, geofence=fence)
    x, y, yaw, near = 0.0, 0.0, float(rng.uniform(-math.pi, math.pi)), -math.inf
    while deepest(places, x, y, yaw) > -0.02:
        yaw = float(rng.uniform(-math.pi, math.pi))
    for k in range(1, 3000):
        if k % 40 == 1:
            vx, wz = float(rng.choice([-0.4, 0.0, 0.4])), float(rng.choice([-0.8, 0.0, 0.8]))
        gate.command(VelocityCommand(k * TICK, vx=vx, wz=wz), k * TICK)
        out = gate.output(k * TICK, well(k * TICK, pose=(x, y, yaw)))
        yaw += 0.02 * out.wz
        x, y = x + 0.02 * out.vx * math.cos(yaw), y + 0.02 * out.vx * math.sin(yaw)
        near = max(near, deepest(places, x, y, yaw))
        assert deepest(places, x, y, yaw) < 0.01, (k, x, y, yaw)
        assert all(p.breach(x, y) < 0.0 for p in fence.polygons)
    assert near > -0.08  # it did come to them


def test_a_robot_in_a_keep_out_area_comes_out_of_it_and_no_deeper() -> None:
    gate = SafetyGate(CAPS, geofence=Fence.of(None, {"pond": [(0, -2), (4, -2), (4, 2), (0, 2)]}))
    for yaw, vx, wanted in ((0.0, 0.4, 0.0), (0.0, -0.4, -0.4), (math.pi, 0.4, 0.4)):
        gate.forget()
        for k in range(1, 60):
            gate.command(VelocityCommand(k * TICK, vx=vx), k * TICK)
            out = gate.output(k * TICK, well(k * TICK, pose=(0.5, 0.0, yaw)))
        assert out.vx == wanted
        assert gate.status().hold == ("" if wanted else "geofence: the keep-out area pond")
