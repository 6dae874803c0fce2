"""The LiDAR study measures what it says."""

from dataclasses import replace

import numpy as np

from hal.lidar.spec import LIDARS
from tools.lidar_study import BIN_EDGES, LEVEL, heights, study
from tools.synthetic import SyntheticRun
from tools.synthetic_scenes import corridor


def test_heights_are_those_of_the_nearest_cell() -> None:
    scene = corridor(3.0)
    x, y = np.array([0.0, -5.98, 99.0]), np.array([0.0, 0.0, 0.0])
    assert heights(scene, x, y).tolist() == [scene.z(0.0, 0.0), scene.z(-6.0, 0.0), scene.z(9.0, 0.0)]


def test_the_strip_ahead_of_an_xt16_is_trusted_and_right() -> None:
    motion = replace(LEVEL, speed=0.4)
    run = SyntheticRun(corridor(6.0, 3), motion, LIDARS["xt16"].decimated(2), duration=6.6, seed=1)
    score = study(run)
    assert score.trusted.shape == score.rmse.shape == (len(BIN_EDGES) - 1,)
    assert (score.trusted[:4] > 0.95).all()
    assert (score.rmse[:4] < 0.03).all()
    assert 0.0 < score.odometry < 0.02
