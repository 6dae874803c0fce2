"""What the wheels feel: one that turns on the spot climbs no face, whatever the guard lets the body turn through, and
one that is driven backward climbs less."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.raster import cell_of
from hal.safety.planned import Pose
from hal.safety.swept import Body, Surroundings, turn_step
from planning.graph.params import GraphParams

TURN_FACE = 0.09
"""[m] Of turns on the spot with a bar of 6 cm and more under the robot half ended with a wheel at the bar
(`docs/design/robot.md`); 3 cm are the noise of the map."""


def wheels_turn(around: Surroundings, pose: Pose, turn: float, body: Body, params: GraphParams) -> float:
    """How far [rad], at most the size of `turn`, a `body` at `pose` turns on the spot, to the left where `turn` is
    positive, before one of its wheels comes to a face above `TURN_FACE`. Ground may rise as steeply as
    `params.max_slope` besides.
    """
    each = turn_step(body)
    steps = math.ceil(abs(turn) / each)
    at = wheel_face(
        around.height,
        around.origin[0],
        around.origin[1],
        around.resolution,
        float(pose[0]),
        float(pose[1]),
        float(pose[2]),
        math.copysign(each, turn),
        steps,
        TURN_FACE,
        math.tan(params.max_slope),
        params.axle,
        params.tread,
        params.tread_width,
    )
    return min(at * each, abs(turn))


@njit(cache=True)
def wheel_face(
    height, x0, y0, resolution, x, y, yaw, step, steps, limit, grade, axle, tread, width
):  # pragma: no cover - compiled
    """Number of steps of `step` [rad] after which a wheel meets a face of more than `limit` [m] within two cells, less
    what the ground rises by `grade`; `steps` where none does."""
    rows, cols = height.shape
    first = steps
    for wheel in range(12):
        u = axle if wheel % 2 == 0 else -axle
        v = tread * (1.0 if wheel % 4 < 2 else -1.0) + 0.5 * width * (wheel // 4 - 1)
        radius, angle = math.hypot(u, v), yaw + math.atan2(v, u)
        back = math.ceil(2.0 * resolution / (radius * abs(step)))
        ground = np.full(steps + 1, np.nan)
        for i in range(first + 1):
            a = angle + i * step
            col = cell_of(x + radius * math.cos(a), x0, resolution)
            row = cell_of(y + radius * math.sin(a), y0, resolution)
            if 0 <= row < rows and 0 <= col < cols:
                ground[i] = height[row, col]
            met = False
            for j in range(max(0, i - back), i):
                met |= ground[i] - ground[j] - grade * (i - j) * radius * abs(step) > limit
            if met:
                first = min(first, i)
                break
    return first
