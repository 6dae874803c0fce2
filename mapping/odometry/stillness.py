"""Whether the robot stands: its wheels and its gyro both say so. Then no scan moves it, whoever walks past."""

from __future__ import annotations

import numpy as np

from hal.types import Array

ROLLING_SPEED = 0.2
"""Largest speed of a standing wheel, noise included [rad/s]: 17 mm/s at the tread. Standing wheels showed 0.14 at
most, at 50 Hz."""
DRIVING_SPEED = 0.02
"""Largest mean velocity by the wheels and legs over a sweep [m/s]; of a robot that stands 0.014."""
TURNING_RATE = 0.01
"""Largest mean turn rate over a sweep, beside the known bias [rad/s]; 0.009 while the trunk sways after the start,
0.003 later."""
LEAST_SAMPLES = 10
"""Fewer inertial samples say nothing about that mean."""


def still(imu: Array, bias: Array, joints: Array, velocity: Array) -> bool:
    """Whether the robot stood over one sweep: inertial samples (n, 6) with the `bias` (3,) of the gyro, joint samples
    (m, 48), and the velocities (m, 3) that these tell, of wheels on the ground."""
    if len(imu) < LEAST_SAMPLES or len(joints) < 2:
        return False
    turning = np.abs(imu[:, :3].mean(axis=0) - bias).max()
    rolling = np.abs(joints[:, 28:32]).max()
    return bool(
        turning < TURNING_RATE
        and rolling < ROLLING_SPEED
        and np.linalg.norm(velocity.mean(axis=0)) < DRIVING_SPEED
    )
