"""A run from above."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hal.scenes.picture import ORANGE
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.log.picture import TRACK_COLOUR, picture


def test_the_way_that_was_driven_is_drawn_on_the_map(tmp_path: Path) -> None:
    config = load(None, ["recorder.profile=full"], scene="flat")
    log = tmp_path / "log.mcap"
    with Lockstep(config, Lockstep.open_log(config, log)) as stack:
        stack.wait_ready()
        before = stack.newest[t.TRUTH].pose.pose.position
        stack.send_goal(before.x + 1.5, before.y)
        stack.run(3.0)
        after = stack.newest[t.TRUTH].pose.pose.position
    driven = picture(log, tmp_path / "run.png")
    assert driven == pytest.approx(math.hypot(after.x - before.x, after.y - before.y), abs=0.15)
    pixels = np.asarray(Image.open(tmp_path / "run.png").convert("RGB"), int)
    assert max(pixels.shape[:2]) == 900
    assert (np.abs(pixels - TRACK_COLOUR).sum(axis=2) < 30).sum() > 50
    # The robot stands: between the rings of its main LiDAR lies ground that is assumed.
    assert (np.abs(pixels - ORANGE).sum(axis=2) < 10).sum() > 500


def test_a_log_without_a_map_is_refused(tmp_path: Path) -> None:
    config = load(None, [], scene="flat")
    with Lockstep(config, Lockstep.open_log(config, tmp_path / "log.mcap")):
        pass
    with pytest.raises(ConfigError, match="no elevation map"):
        picture(tmp_path / "log.mcap", tmp_path / "run.png")
