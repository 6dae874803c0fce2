"""The elevation stage: the uncertainty of the odometry reaches the map."""

from __future__ import annotations

import numpy as np
import pytest

from hal.lidar import LidarConfig
from hal.robots.go2w.facts import MOTORS
from hal.types import JointSample
from mapping.elevation.map import ElevationMap
from mapping.elevation.tiles import LIDAR
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stage_config import ElevationStageConfig
from rbtrg_robot.stages.elevation import ElevationStage
from rbtrg_robot.wire.convert import BASE, MAP, ODOM, cloud_msg, joint_msg, odometry_msg, transform_msg

LEVEL = (0.0, 0.0, 0.0, 1.0)
FAR = 4.0
"""Distance of the ground that is seen [m]."""


def mapped_sigma(height: float, tilt: float) -> float:
    """Standard deviation [m] of ground at `FAR` after one scan whose pose has these standard deviations [m], [rad]."""
    stage = ElevationStage(ElevationMap(), ElevationStageConfig(), (LidarConfig().mounted(),))
    still = np.zeros(len(MOTORS))
    points = np.stack(
        np.meshgrid(np.linspace(FAR, FAR + 0.2, 11), np.linspace(-0.1, 0.1, 11), [-0.4]), -1
    ).reshape(-1, 3)
    covariance = np.diag([1e-6, 1e-6, height**2, tilt**2, tilt**2, 1e-6])
    stage.on(t.TF_STATIC, msg.TFMessage(transforms=[transform_msg(0, MAP, ODOM, (0.0, 0.0, 0.4), LEVEL)]))
    stage.on(t.JOINTS, joint_msg(JointSample(1, still, still, still)))
    stage.on(t.CLOUDS["main"], cloud_msg(1, BASE, points.astype(np.float32)))
    stage.on(t.ODOM, odometry_msg(1, np.zeros(3), LEVEL, np.zeros(3), np.zeros(3), covariance))
    cells = stage.map.store.cells
    seen = cells["variance"][cells["source"] == LIDAR]
    assert len(seen) > 20
    return float(np.sqrt(np.median(seen)))


@pytest.mark.parametrize(
    ("height", "tilt", "least"), [(0.0, 0.0, 0.01), (0.05, 0.0, 0.05), (0.0, 0.02, 0.02 * FAR)]
)
def test_ground_seen_from_an_unsure_pose_is_unsure(height: float, tilt: float, least: float) -> None:
    sigma = mapped_sigma(height, tilt)
    assert least <= sigma < least + 0.03
