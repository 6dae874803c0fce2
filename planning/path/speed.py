"""The speed at each point of a path: less in bends, on slopes and where the body's risk is high, with room to brake."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from planning.braking import bend_speed, brake
from planning.graph.faces import FACE_NOISE
from planning.graph.prices import MEASURED_SPEED
from planning.path.types import PathLimits
from planning.risk.body import BodyModel

Array = NDArray[np.float64]


def speeds(
    s: Array,
    yaw: Array,
    s_features: Array,
    features: Array,
    faces: Array,
    body: BodyModel,
    limits: PathLimits,
) -> tuple[Array, Array]:
    """(n,) [m/s] at arc length `s` (n,) [m] with heading `yaw` (n,) [rad], 0 at the end; and (n,) the least that passes
    there.

    `features` (m, 4) of the body (eq. 1 and 2) and the highest face under it, `faces` (m,) [m], at arc length
    `s_features` (m,) [m]. Where a face has to be climbed the speed is `PathLimits.step_speed` at least, whatever the
    risk: a wheel that comes slower stalls.
    """
    ds = np.maximum(np.diff(s), 1e-9)
    bend = np.abs(wrap(np.diff(yaw))) / ds
    curvature = np.zeros(len(s))
    curvature[:-1] = bend
    curvature[1:] = np.maximum(curvature[1:], bend)
    scaled = np.minimum(features[:, :3] / body.scales[:3], body.clip)
    risk, along = scaled[:, 1:].sum(axis=1) + features[:, 3], scaled[:, 0]
    # The corner bands' centres are three quarters of the body apart.
    pitch = np.arctan(features[:, 0] / (0.75 * body.length))
    share = np.clip(pitch / limits.max_slope, 0.0, 1.0)
    careful = limits.max_speed * np.minimum(1.0 / (1.0 + risk + along), 1.0 - 0.5 * share)
    careful = np.maximum(careful, np.minimum(limits.max_speed / (1.0 + risk), MEASURED_SPEED))
    climb = np.where((faces > FACE_NOISE) & (faces <= limits.max_step + FACE_NOISE), limits.step_speed, 0.0)
    careful = np.maximum(careful, climb)
    speed = bend_speed(curvature, limits.lateral_accel, limits.max_yaw_rate)
    speed = np.minimum(speed, np.interp(s, s_features, careful))
    speed = np.clip(speed, limits.min_speed, limits.max_speed)
    speed[-1] = 0.0
    brake(speed, ds, limits.max_accel)
    # It starts from rest and speeds up no faster than it brakes.
    brake(speed[::-1], ds[::-1], limits.max_accel)
    return speed, np.minimum(np.interp(s, s_features, climb), speed)
