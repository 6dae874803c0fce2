"""Ground around the origin as the guard sees it, and the robot on it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.safety.swept import LIDAR, Surroundings
from hal.types import Capabilities

ROBOT = Capabilities("test", max_step=0.10, max_slope=math.radians(25.0), max_gap=0.10)
RES = 0.04
N = 101
X, Y = np.meshgrid(*(2 * [(np.arange(N) - N // 2) * RES]))
CORNER = (float(X[0, 0]), float(Y[0, 0]))


def ground(height: NDArray[Any], **layers: Any) -> Surroundings:
    """As the guard makes them of a map window; what is not given is unknown or free."""
    height = np.ascontiguousarray(height, np.float32)
    bound = np.asarray(layers.get("bound", np.full_like(height, np.nan)), np.float32)
    source = np.asarray(layers.get("source", np.where(np.isnan(height), 0, LIDAR)), np.uint8)
    occupied = np.asarray(layers.get("occupied", np.zeros_like(height)), np.uint8)
    return Surroundings(height, bound, source, occupied, CORNER, RES)
